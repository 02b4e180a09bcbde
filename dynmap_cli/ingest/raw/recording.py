"""What a recording holds before anything is decided: sweeps, odometry and transforms as they were written."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dynmap_cli.arrays import F64, I64
from dynmap_cli.ingest.raw.columns import Growing, steps_in
from dynmap_cli.ingest.raw.laser import RawLaser
from dynmap_cli.ingest.raw.stamped import Stamped

_MOST_FRAMES = 4
"""Further frames of one topic that are taken for lasers."""


class StampedRows(Stamped):
    """Stamps, times of recording, and a row of numbers at each, in the order of recording.

    Parameters
    ----------
    width : int
        Numbers in a row.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self._rows = Growing(np.float64, width)

    def add(self, stamp_ns: int, logged_ns: int, row: tuple[float, ...]) -> None:
        """Append one row."""
        self._stamps_ns.add(stamp_ns)
        self._logged_ns.add(logged_ns)
        self._rows.add(row)

    def add_many(self, stamps_ns: I64, logged_ns: I64, rows: F64) -> None:
        """Append rows (n, width)."""
        self._stamps_ns.extend(stamps_ns)
        self._logged_ns.extend(logged_ns)
        self._rows.extend(rows)

    @property
    def _columns(self) -> tuple[Growing, ...]:
        return (*super()._columns, self._rows)


class RawOdometry(StampedRows):
    """One source of odometry poses: x, y in metres, yaw in radians.

    Parameters
    ----------
    name : str
        Topic, or the first word of the lines of a text log.
    frame, child : str
        The poses are frame_from_child; "" in text logs.
    """

    def __init__(self, name: str, frame: str = "", child: str = "") -> None:
        super().__init__(3)
        self.name, self.frame, self.child = name, frame, child

    @property
    def poses(self) -> F64:
        """(n, 3) in the order of recording."""
        return self._rows.rows

    @poses.setter
    def poses(self, poses: F64) -> None:
        self._rows.rows = poses

    def as_arrays(self) -> tuple[I64, F64]:
        """Stamps (n,) ascending, and poses (n, 3)."""
        return sorted_by_stamp(self.stamps_ns, self.poses)


class RawTransform(StampedRows):
    """All transforms published for one pair of frames: parent_from_child as x, y, z, qx, qy, qz, qw.

    Parameters
    ----------
    is_static : bool
        Published as latched, valid for all times.
    """

    def __init__(self, is_static: bool) -> None:
        super().__init__(7)
        self.is_static = is_static

    @property
    def values(self) -> F64:
        """(n, 7) in the order of recording."""
        return self._rows.rows

    @values.setter
    def values(self, values: F64) -> None:
        self._rows.rows = values


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic, or a kind of line of a text log.

    Attributes
    ----------
    name, kind : str
    count : int
    """

    name: str
    kind: str
    count: int


@dataclass(slots=True)
class RawRecording:
    """Everything dynmap can use in one recording.

    Attributes
    ----------
    name : str
        The path as the operator gave it, for messages.
    kind : str
        Format, in words.
    topics : list of Topic
    lasers : dict of str to RawLaser
    odometry : dict of str to RawOdometry
    transforms : dict of (parent, child) to RawTransform
    transforms_read : dict of (namespace, parent, child) to RawTransform
        By the namespace of their topic, with frames as written; empty when all messages are read.
    dropped : Counter
        How many messages or lines were left out, by reason.
    damage : list of str
        What is broken in the file itself, without repetition; nothing else makes it a damaged one.
    warnings : list of str
    notes : list of str
        What was decided while reading, where nothing is wrong.
    n_read : int
        Messages or lines that were read and understood.
    folder : Path or None
        On which disk ranges lie that do not fit into memory; None = where temporary files are put.
    """

    name: str
    kind: str
    topics: list[Topic] = field(default_factory=list)
    lasers: dict[str, RawLaser] = field(default_factory=dict)
    odometry: dict[str, RawOdometry] = field(default_factory=dict)
    transforms: dict[tuple[str, str], RawTransform] = field(default_factory=dict)
    transforms_read: dict[tuple[str, str, str], RawTransform] = field(default_factory=dict)
    dropped: Counter[str] = field(default_factory=Counter)
    damage: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    n_read: int = 0
    folder: Path | None = None

    def laser(self, name: str, frame: str = "") -> RawLaser:
        """The laser of a topic and frame, a new one where there is none yet.

        Two lasers may publish on one topic; the second is named after topic and frame. Beyond a few frames they are
        damage, and their sweeps those of the first.
        """
        found = self.lasers.get(name)
        if found is None:
            found = self.lasers[name] = RawLaser(name, frame, folder=self.folder)
        if found.frame == frame:
            return found
        other = f"{name} ({frame})"
        if other not in self.lasers:
            if sum(one.startswith(f"{name} (") for one in self.lasers) >= _MOST_FRAMES:
                return found
            self.lasers[other] = RawLaser(other, frame, folder=self.folder)
        return self.lasers[other]

    def give_back(self) -> None:
        """Take what is in files out of memory; it is read again where it is used."""
        for laser in self.lasers.values():
            laser.give_back()
        for track in self.odometry.values():
            track.give_back()
        for transform in (*self.transforms.values(), *self.transforms_read.values()):
            transform.give_back()

    @property
    def span_ns(self) -> tuple[int, int]:
        """Earliest and latest stamp of any sweep."""
        stamps = [laser.stamps_ns for laser in self.lasers.values()]
        return int(min(part.min() for part in stamps)), int(max(part.max() for part in stamps))

    def say_degrees(self, name: str) -> None:
        """Say once that the angles of a laser's sweeps were taken to be in degrees."""
        told = f"{name}: its angles are no sweep in radians: taken to be in degrees"
        if told not in self.warnings:
            self.warnings.append(told)

    def drop_broken(self, what: str, count: int = 1) -> None:
        """Count messages or lines that are broken."""
        self.dropped[what] += count
        if what not in self.damage:
            self.damage.append(what)


def topic_of(laser_name: str) -> str:
    """Topic of a laser, whose name may have its frame behind it."""
    return laser_name.partition(" (")[0]


def file_name(name: str) -> str:
    """Last part of a recording's path: what is written into results, which do not depend on where it lies."""
    path = Path(name)
    return path.name if path.name not in {"", ".."} else path.resolve().name


def sorted_by_stamp(stamps_ns: I64, rows: F64) -> tuple[I64, F64]:
    """Return stamps (n,) in ascending order with their rows (n, width); of equal stamps the first counts."""
    if all((steps > 0).all() for steps in steps_in(stamps_ns)):
        return stamps_ns, rows
    unique, first = np.unique(stamps_ns, return_index=True)
    return unique, rows[first]
