"""What a recording holds before anything is decided: sweeps, odometry and transforms as they were written."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import compress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dynmap_cli.arrays import F32, F64, I64


class ScanShape(NamedTuple):
    """How the beams of a sweep lie; sweeps of one shape share a row of the geometry table.

    A tuple, as it is compared and looked up once per sweep and more.

    Attributes
    ----------
    first_bearing_rad, increment_rad : float
        In the sensor frame; the increment may be negative.
    n_beams : int
    range_min_m : float
    range_max_m : float
        What the recording says the sensor reaches; +inf where it does not say.
    """

    first_bearing_rad: float
    increment_rad: float
    n_beams: int
    range_min_m: float
    range_max_m: float

    @property
    def bearings_rad(self) -> F64:
        """(n_beams,) directions in the sensor frame."""
        return np.asarray(self.first_bearing_rad + self.increment_rad * np.arange(self.n_beams))


@dataclass(slots=True)
class RawLaser:
    """All sweeps of one laser, in the order in which they were recorded.

    Attributes
    ----------
    name : str
        Topic, or the first word of the lines of a text log.
    frame : str
        Sensor frame; "" in text logs.
    stamps_ns, logged_ns : list of int
        Header stamp, and when the message was recorded (the same where only one is known).
    ranges_m : list of (n_beams,) float32
        As recorded, metres.
    shapes : list of ScanShape
    beam_interval_s : list of float
        As recorded; NaN where that is no duration.
    recording : list of int
        Which recording a sweep came from.
    robot_from_sensor : (3,) float64 or None
        Where the log itself states how the laser is mounted.
    """

    name: str
    frame: str = ""
    stamps_ns: list[int] = field(default_factory=list)
    logged_ns: list[int] = field(default_factory=list)
    ranges_m: list[F32] = field(default_factory=list)
    shapes: list[ScanShape] = field(default_factory=list)
    beam_interval_s: list[float] = field(default_factory=list)
    recording: list[int] = field(default_factory=list)
    robot_from_sensor: F64 | None = None

    def add(
        self, stamp_ns: int, logged_ns: int, ranges_m: F32, shape: ScanShape, beam_interval_s: float = 0.0
    ) -> None:
        """Append one sweep."""
        self.stamps_ns.append(stamp_ns)
        self.logged_ns.append(logged_ns)
        self.ranges_m.append(ranges_m)
        self.shapes.append(shape)
        self.beam_interval_s.append(beam_interval_s)
        self.recording.append(0)

    def keep(self, wanted: Sequence[bool]) -> None:
        """Forget all other sweeps."""
        for name in ("stamps_ns", "logged_ns", "ranges_m", "shapes", "beam_interval_s", "recording"):
            setattr(self, name, list(compress(getattr(self, name), wanted)))

    @property
    def n_scans(self) -> int:
        """Number of sweeps."""
        return len(self.stamps_ns)

    @property
    def usual_shape(self) -> ScanShape:
        """The shape of most sweeps; single damaged ones must not decide for the others."""
        return Counter(self.shapes).most_common(1)[0][0]


@dataclass(slots=True)
class RawOdometry:
    """One source of odometry poses.

    Attributes
    ----------
    name : str
        Topic, or the first word of the lines of a text log.
    frame, child : str
        The poses are frame_from_child; "" in text logs.
    stamps_ns : list of int
    poses : list of (x, y, yaw)
        Metres, radians.
    """

    name: str
    frame: str = ""
    child: str = ""
    stamps_ns: list[int] = field(default_factory=list)
    poses: list[tuple[float, float, float]] = field(default_factory=list)

    def as_arrays(self) -> tuple[I64, F64]:
        """Stamps (n,) ascending, and poses (n, 3)."""
        return sorted_by_stamp(self.stamps_ns, self.poses, 3)


@dataclass(slots=True)
class RawTransform:
    """All transforms published for one pair of frames.

    Attributes
    ----------
    is_static : bool
        Published as latched, valid for all times.
    stamps_ns : list of int
    values : list of (x, y, z, qx, qy, qz, qw)
        parent_from_child.
    """

    is_static: bool
    stamps_ns: list[int] = field(default_factory=list)
    values: list[tuple[float, ...]] = field(default_factory=list)


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
    dropped : Counter
        How many messages or lines were left out, by reason.
    damage : list of str
        What is broken in the file itself, without repetition; nothing else makes it a damaged one.
    warnings : list of str
    n_read : int
        Messages or lines that were read and understood.
    """

    name: str
    kind: str
    topics: list[Topic] = field(default_factory=list)
    lasers: dict[str, RawLaser] = field(default_factory=dict)
    odometry: dict[str, RawOdometry] = field(default_factory=dict)
    transforms: dict[tuple[str, str], RawTransform] = field(default_factory=dict)
    dropped: Counter[str] = field(default_factory=Counter)
    damage: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    n_read: int = 0

    @property
    def span_ns(self) -> tuple[int, int]:
        """Earliest and latest stamp of any sweep."""
        stamps = [stamp for laser in self.lasers.values() for stamp in laser.stamps_ns]
        return min(stamps), max(stamps)

    def drop_broken(self, what: str) -> None:
        """Count a message or line that is broken."""
        self.dropped[what] += 1
        if what not in self.damage:
            self.damage.append(what)


def file_name(name: str) -> str:
    """Last part of a recording's path: what is written into results, which do not depend on where it lies."""
    path = Path(name)
    return path.name if path.name not in {"", ".."} else path.resolve().name


def sorted_by_stamp(
    stamps_ns: Sequence[int], rows: Sequence[tuple[float, ...]], width: int
) -> tuple[I64, F64]:
    """Return stamps (n,) in ascending order with their rows (n, width); of equal stamps the first counts."""
    stamps = np.array(stamps_ns, dtype=np.int64)
    values = np.array(rows, dtype=np.float64).reshape(-1, width)
    unique, first = np.unique(stamps, return_index=True)
    return unique, values[first]
