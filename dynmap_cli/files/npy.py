"""Arrays in .npy and .npz files, of the type and shape that are expected, or a `ValueError`."""

from __future__ import annotations

import math
import tokenize
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from dynmap_cli.domain.mapped import give_back
from dynmap_cli.files.zip_archive import ZipArchive

Array = np.ndarray[Any, Any]
_MAX_HEADER_BYTES = 4096
_MAGIC = np.lib.format.magic(1, 0)
_PIECE_BYTES = 1 << 22


@dataclass(frozen=True, slots=True)
class Column:
    """What an array must be.

    Attributes
    ----------
    dtype : str
        For instance "<f4".
    shape : tuple of int or None
        Length of each axis, None = any.
    """

    dtype: str
    shape: tuple[int | None, ...]


def read_npy(path: Path, column: Column, *, in_memory: bool) -> Array:
    """Read a .npy file, or open it memory-mapped.

    Raises
    ------
    OSError, ValueError
        If it is missing, cut off, damaged, or not of that type.
    """
    with path.open("rb") as stream:
        shape = _checked_header(stream, path.stat().st_size, column, path.name)
        offset = stream.tell()
    if in_memory or 0 in shape:
        return np.fromfile(path, dtype=column.dtype, offset=offset).reshape(shape)
    return np.memmap(path, dtype=column.dtype, mode="r", offset=offset, shape=shape)


def write_npy(path: Path, array: Array) -> None:
    """Write an array in rows as np.save does; one that is mapped from a file passes through memory piece by piece."""
    with path.open("wb") as stream:
        _write_array(stream, array)


def write_npz(path: Path, arrays: Iterable[tuple[str, Array]]) -> None:
    """Write named arrays in rows as np.savez_compressed does, one after the other, each piece by piece."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays:
            with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
                _write_array(stream, array)
            del array  # before the next one is made


def _write_array(stream: IO[bytes], array: Array) -> None:
    """Write header and rows."""
    np.lib.format.write_array_header_1_0(stream, np.lib.format.header_data_from_array_1_0(array))
    if array.ndim == 0:
        stream.write(array.tobytes())
        return
    step = max(1, _PIECE_BYTES // max(array.strides[0], 1))
    for start in range(0, array.shape[0], step):
        stream.write(array[start : start + step].tobytes())
        give_back(array)


def read_npz(path: Path, columns: Mapping[str, Column], max_bytes: int) -> dict[str, Array]:
    """Read some of the arrays of a .npz file, none of them larger than *max_bytes*.

    Raises
    ------
    OSError, ValueError
        If it is missing, cut off, damaged, absurdly large, or its arrays are not of those types.
    """
    with closing(ZipArchive(path)) as archive:
        found = {}
        for name, column in columns.items():
            with archive.stream(f"{name}.npy", max_bytes + _MAX_HEADER_BYTES) as (stream, size):
                found[name] = parse_npy(stream, size, column, f"{name}.npy")
        return found


def npz_rows(path: Path, name: str, column: Column, max_bytes: int) -> Iterator[Array]:
    """Read an array of a .npz file, of at most *max_bytes*, some rows at a time.

    Raises
    ------
    OSError, ValueError
        As `read_npz`, also after some rows.
    """
    member = f"{name}.npy"
    with (
        closing(ZipArchive(path)) as archive,
        archive.stream(member, max_bytes + _MAX_HEADER_BYTES) as (stream, size),
    ):
        shape = _checked_header(stream, size, column, member)
        row_bytes = math.prod(shape[1:]) * np.dtype(column.dtype).itemsize
        step = max(1, _PIECE_BYTES // max(row_bytes, 1))
        for start in range(0, shape[0], step):
            count = min(step, shape[0] - start)
            content = stream.read(count * row_bytes)
            if len(content) != count * row_bytes:
                msg = f"{member} ends after {start} of {shape[0]} rows"
                raise ValueError(msg)
            yield np.frombuffer(bytearray(content), dtype=column.dtype).reshape(count, *shape[1:])
        if stream.read(1):  # at its end the checksum is compared
            msg = f"{member} goes on after {shape[0]} rows"
            raise ValueError(msg)


def parse_npy(stream: IO[bytes], size: int, column: Column, name: str) -> Array:
    """Read an array from a stream of *size* bytes; *name* is named in errors."""
    shape = _checked_header(stream, size, column, name)
    wanted = math.prod(shape) * np.dtype(column.dtype).itemsize
    content = stream.read(wanted + 1)
    if len(content) != wanted:
        msg = f"{name} holds {len(content)} bytes of values, not {wanted}"
        raise ValueError(msg)
    return np.frombuffer(bytearray(content), dtype=column.dtype).reshape(shape)


def _checked_header(stream: IO[bytes], size: int, column: Column, name: str) -> tuple[int, ...]:
    """Shape of the array whose header stands at the start of the stream, in rows and as long as the file."""
    if stream.read(len(_MAGIC)) != _MAGIC:
        msg = f"{name} is not a .npy file of version 1.0"
        raise ValueError(msg)
    try:
        shape, is_fortran, dtype = np.lib.format.read_array_header_1_0(stream, _MAX_HEADER_BYTES)
    except (SyntaxError, RecursionError, tokenize.TokenError, ValueError, TypeError) as err:
        msg = f"{name} has a damaged header"
        raise ValueError(msg) from err
    wanted = np.dtype(column.dtype)
    if dtype != wanted or is_fortran or not _fits(shape, column.shape):
        order = " in columns" if is_fortran else ""
        lengths = ", ".join("any" if length is None else str(length) for length in column.shape)
        kind = "Python objects" if dtype.hasobject else dtype
        msg = f"{name} is {kind} {shape}{order}, not {wanted} ({lengths}) in rows"
        raise ValueError(msg)
    if math.prod(shape) * wanted.itemsize != size - stream.tell():
        msg = f"{name} is {shape} by its header, which are not the {size} bytes there are"
        raise ValueError(msg)
    return shape


def _fits(shape: tuple[int, ...], wanted: tuple[int | None, ...]) -> bool:
    """Whether a shape is as wanted."""
    return len(shape) == len(wanted) and all(
        found >= 0 and length in {None, found} for found, length in zip(shape, wanted, strict=True)
    )
