"""Columns that grow at their end, and the ranges of sweeps, which go to a file when there are many of them."""

from __future__ import annotations

import os
import tempfile
from bisect import bisect_right
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from dynmap_cli.arrays import B1, F32, F64, I32, I64
from dynmap_cli.domain.mapped import give_back, mapping_of
from dynmap_cli.files.tables import new_table

Values = NDArray[Any]

_MOST_IN_MEMORY_BYTES, _MOST_OF_COLUMN_BYTES = 1 << 25, 1 << 20
_MOST_PARTS = 4096
_MOST_AT_ONCE_BYTES = 1 << 24
_BLOCK_BYTES, _ROWS_AT_ONCE, _LEAST_ROWS = 1 << 22, 1 << 15, 64


class Growing:
    """Rows of numbers to which more are added one by one or many at a time; in a nameless file when they are many.

    Parameters
    ----------
    dtype : type
    width : int
        Numbers in a row; 0 = each row is a single number.
    folder : Path or None
        On which disk the file lies; None = where temporary files are put.
    """

    def __init__(self, dtype: Any, width: int = 0, folder: Path | None = None) -> None:
        self._dtype = np.dtype(dtype)
        self._shape = (-1, width) if width else (-1,)
        self._folder = folder
        self._file: IO[bytes] | None = None
        # One piece for what came last: thousands of small ones would keep the memory between them from being used.
        self._recent: Values | None = None
        self._n_recent = 0
        self._single: list[Any] = []
        self._whole: Values | None = None

    def add(self, row: Any) -> None:
        """Add one row."""
        self._single.append(row)
        if len(self._single) >= _MOST_PARTS:
            self._settle()

    def extend(self, rows: Any) -> None:
        """Add rows (n,) or (n, width)."""
        self._settle()
        self._put(np.asarray(rows, dtype=self._dtype).reshape(self._shape))

    def _settle(self) -> None:
        """Make rows that came one by one an array."""
        if self._single:
            single, self._single = self._single, []
            self._put(np.array(single, dtype=self._dtype).reshape(self._shape))

    def _put(self, part: Values) -> None:
        """Keep rows, and write those before them to the file when they take more than a piece."""
        self._whole = None
        while part.shape[0]:
            recent = self._room_for(part.shape[0])
            count = min(part.shape[0], recent.shape[0] - self._n_recent)
            recent[self._n_recent : self._n_recent + count] = part[:count]
            self._n_recent += count
            part = part[count:]

    def _room_for(self, count: int) -> Values:
        """The piece for what comes next, with room for a row at least, for *count* if a piece may have so many."""
        if self._recent is not None and self._n_recent < self._recent.shape[0]:
            return self._recent
        most = max(1, _MOST_OF_COLUMN_BYTES // (self._dtype.itemsize * max(self._shape[1:], default=1)))
        if self._recent is not None and self._n_recent >= most:
            if self._file is None:
                # It lives as long as the column.
                self._file = tempfile.TemporaryFile(dir=self._folder)  # noqa: SIM115
            self._write()
            return self._recent
        size = min(max(self._n_recent + count, 2 * self._n_recent, _LEAST_ROWS), most)
        larger = np.empty((size, *self._shape[1:]), dtype=self._dtype)
        if self._recent is not None:
            larger[: self._n_recent] = self._recent
        self._recent = larger
        return larger

    def _write(self) -> None:
        """Move what came last to the end of the file."""
        if self._file is not None and self._recent is not None:
            self._file.seek(0, os.SEEK_END)
            self._file.write(self._recent[: self._n_recent].data)
            self._file.flush()
            self._n_recent = 0

    @property
    def rows(self) -> Values:
        """All rows, (n,) or (n, width)."""
        self._settle()
        if self._whole is None:
            if self._file is not None:
                self._write()
                mapped = np.memmap(self._file, dtype=self._dtype, mode="r+")
                self._whole = mapped.view(np.ndarray).reshape(self._shape)
            elif self._recent is None:
                self._whole = np.zeros((0, *self._shape[1:]), dtype=self._dtype)
            else:
                self._whole = self._recent[: self._n_recent]
        return self._whole

    @rows.setter
    def rows(self, rows: Any) -> None:
        """Replace all rows."""
        rows = np.array(rows, dtype=self._dtype)
        self._recent, self._n_recent, self._single, self._file = None, 0, [], None
        self.extend(rows)

    def give_back(self) -> None:
        """Take what is in the file out of memory."""
        if self._whole is not None:
            give_back(self._whole)


class RangeStore:
    """Numbers one after another, found by the place of the first; in a nameless file when they are many.

    Parameters
    ----------
    folder : Path or None
        On which disk the file lies; None = where temporary files are put.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder
        self._starts: list[int] = []
        self._parts: list[F32 | _InFile] = []
        self._size = 0
        self._is_shared = False
        # What came last, in one piece with room for all that may lie here: memory that is not written to costs none.
        self._room: F32 = np.zeros(0, dtype=np.float32)
        self._recent_size = 0

    def add(self, values: F32) -> int:
        """Add numbers, of any shape; returns the place of the first."""
        flat = np.ravel(values)
        place = self._size + self._recent_size
        # The first ones may be all there are; later ones need not be held.
        most_bytes = _MOST_IN_MEMORY_BYTES if self._size == 0 else _MOST_OF_COLUMN_BYTES
        most, end = most_bytes // self._room.itemsize, self._recent_size + flat.size
        if end > most:
            self._write(self._taken())
            self._write(flat)
            return place
        if not self._room.size:
            self._room = np.empty(most, dtype=np.float32)
        self._room[self._recent_size : end] = flat
        self._recent_size = end
        return place

    def _taken(self) -> F32:
        """What came last, which is no longer held here."""
        taken, size = self._room, self._recent_size
        self._room, self._recent_size = np.zeros(0, dtype=np.float32), 0
        taken.resize(size, refcheck=False)
        return taken

    def _write(self, values: F32) -> None:
        """Put numbers into the file."""
        last = self._parts[-1] if self._parts else None
        if not isinstance(last, _InFile):
            # The file lives as long as the store.
            stream = tempfile.TemporaryFile(dir=self._folder)  # noqa: SIM115
            last = _InFile(stream)
            self._append(last, 0)
        last.add(values)
        self._size += values.size

    def _settle(self) -> None:
        """Make what came last, and is not in a file, one part."""
        if self._recent_size:
            part = self._taken()
            self._append(part, part.size)

    def _append(self, part: F32 | _InFile, size: int) -> None:
        self._starts.append(self._size)
        self._parts.append(part)
        self._size += size

    def take_over(self, other: RangeStore) -> int:
        """Put what another store holds behind what is here; returns by how much its places move."""
        self._settle()
        other._settle()
        self._is_shared = other._is_shared = True
        moved = self._size
        self._starts += [start + moved for start in other._starts]
        self._parts += other._parts
        self._size += other._size
        return moved

    def read(self, start: int, stop: int) -> F32:
        """Numbers (stop - start,) from one place to another."""
        self._settle()
        found = []
        number = bisect_right(self._starts, start) - 1
        while start < stop:
            first = self._starts[number]
            end = self._starts[number + 1] if number + 1 < len(self._starts) else self._size
            until = min(stop, end)
            part = self._parts[number]
            if isinstance(part, _InFile):
                found.append(part.read(start - first, until - first))
            else:
                found.append(part[start - first : until - first])
            start, number = until, number + 1
        if len(found) == 1:
            return found[0]
        return np.concatenate(found) if found else np.zeros(0, dtype=np.float32)

    def scaled(self, factor: float) -> RangeStore:
        """All numbers multiplied by a factor, at the same places."""
        self._settle()
        result = RangeStore(self._folder)
        for start in range(0, self._size, _MOST_OF_COLUMN_BYTES):
            part = self.read(start, min(start + _MOST_OF_COLUMN_BYTES, self._size))
            result.add(part * np.float32(factor))
        return result

    def fill(self, into: F32, places: I64, n_beams: I64) -> None:
        """Write sweeps into the rows of a table.

        Parameters
        ----------
        into : (n, widest) float32
            Left as it is where a sweep has fewer beams.
        places, n_beams : (n,) int64
            Where sweeps begin, and their lengths.
        """
        if places.size == 0:
            return
        low, high = int(places.min()), int((places + n_beams).max())
        width = int(n_beams[0])
        if 4 * (high - low) <= _MOST_AT_ONCE_BYTES and high - low <= 4 * int(n_beams.sum()):
            values = self.read(low, high)
            if (n_beams == width).all() and (np.diff(places) == width).all():
                into[:, :width] = values.reshape(-1, width)
                return
        else:
            values, low = None, 0
        for row, (place, count) in enumerate(zip((places - low).tolist(), n_beams.tolist(), strict=True)):
            part = self.read(place, place + count) if values is None else values[place : place + count]
            into[row, :count] = part

    def as_table(self, n_rows: int, width: int) -> F32 | None:
        """The numbers themselves as a table that can be written to, if they lie in one piece and fill it."""
        self._settle()
        if not self._parts or self._size != n_rows * width or self._is_shared:
            return None
        file, *rest = self._parts
        if isinstance(file, np.ndarray) and not rest:
            return file.reshape(n_rows, width)
        if not isinstance(file, _InFile) or any(isinstance(part, _InFile) for part in rest):
            return None
        for part in rest:
            file.add(np.asarray(part))
        self._parts, self._starts = [file], [0]
        return file.as_table(n_rows, width)


class _InFile:
    """Numbers in a file."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream

    def add(self, values: F32) -> None:
        self._stream.seek(0, os.SEEK_END)
        self._stream.write(np.ascontiguousarray(values).data)

    def read(self, start: int, stop: int) -> F32:
        self._stream.seek(4 * start)
        return np.frombuffer(self._stream.read(4 * (stop - start)), dtype=np.float32)

    def as_table(self, n_rows: int, width: int) -> F32:
        self._stream.flush()
        return np.memmap(self._stream, dtype=np.float32, mode="r+", shape=(n_rows, width))


def blocks_of(table: F32) -> Iterator[slice]:
    """Yield rows of a table, so many at a time that they take 4 MiB or so."""
    step = max(1, _BLOCK_BYTES // max(table.strides[0], 1))
    for start in range(0, table.shape[0], step):
        yield slice(start, min(start + step, table.shape[0]))


def kept_rows(table: F32, wanted: B1 | slice) -> F32:
    """The table without the other rows; one that is mapped from a file is packed in its place."""
    if isinstance(wanted, slice) or mapping_of(table) is None:
        return np.asarray(table[wanted])
    count = 0
    for rows in blocks_of(table):
        part = table[rows][wanted[rows]]
        table[count : count + part.shape[0]] = part
        count += part.shape[0]
        give_back(table)
    return table[:count]


def picked_rows(table: F32, numbers: I64, folder: Path | None) -> F32:
    """A table of some rows, given by their numbers (n,)."""
    result = new_table(numbers.size, table.shape[1], folder)
    for rows in blocks_of(result):
        result[rows] = table[numbers[rows]]
        give_back(result)
        give_back(table)
    return result


def put_rows(table: F32, numbers: I64, values: F32) -> None:
    """Write rows (n, width) to where their numbers (n,) say."""
    for rows in blocks_of(values):
        table[numbers[rows]] = values[rows]
        give_back(values)
        give_back(table)


def spans(n_rows: int, *columns: Values) -> Iterator[slice]:
    """Yield rows in blocks, for what would take many times the memory of its result if done for all at once.

    After each block the pages of the columns, which are read there, leave the memory.
    """
    for start in range(0, n_rows, _ROWS_AT_ONCE):
        yield slice(start, min(start + _ROWS_AT_ONCE, n_rows))
        for column in columns:
            give_back(column)


def steps_in(values: Values) -> Iterator[Values]:
    """Yield the differences between the numbers (n,) of a column and those before them, block by block."""
    for rows in spans(values.shape[0] - 1, values):
        yield np.diff(values[rows.start : rows.stop + 1])


def ascends(values: Values) -> bool:
    """Whether no number (n,) is smaller than the one before."""
    return all((steps >= 0).all() for steps in steps_in(values))


def counts_of(values: I32, n_values: int) -> I64:
    """(n_values,) how often 0, 1, ... occur in a column (n,)."""
    counts = np.zeros(n_values, dtype=np.int64)
    for rows in spans(values.shape[0], values):
        counts += np.bincount(values[rows], minlength=n_values)
    return counts


def known_rows(poses: F64) -> B1:
    """(n,) which rows (n, 3) are finite."""
    known = np.empty(poses.shape[0], dtype=bool)
    for rows in spans(known.size, poses):
        known[rows] = np.isfinite(poses[rows]).all(axis=1)
    return known


def picked(values: Values, rows: I64) -> Values:
    """Some rows (n,) of an array; the array itself, not a copy, where they are all of them in their order."""
    if rows.size == values.shape[0] and all((steps == 1).all() for steps in steps_in(rows)):
        return values
    return np.asarray(values[rows])
