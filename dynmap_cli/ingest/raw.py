"""What a recording holds before anything is decided: sweeps, odometry and transforms as they were written."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dynmap_cli.arrays import B1, F32, F64, I32, I64
from dynmap_cli.ingest.columns import Growing, RangeStore


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


class RawLaser:
    """All sweeps of one laser, in the order in which they were recorded.

    Parameters
    ----------
    name : str
        Topic, or the first word of the lines of a text log.
    frame : str
        Sensor frame; "" in text logs.
    robot_from_sensor : (3,) float64 or None
        Where the log itself states how the laser is mounted.
    folder : Path or None
        On which disk ranges lie that do not fit into memory; None = where temporary files are put.
    """

    def __init__(
        self, name: str, frame: str = "", robot_from_sensor: F64 | None = None, folder: Path | None = None
    ) -> None:
        self.name, self.frame, self.robot_from_sensor = name, frame, robot_from_sensor
        self.shape_table: list[ScanShape] = []
        """Shapes by number, in the order in which they came first."""
        self._numbers: dict[ScanShape, int] = {}
        self._ranges = RangeStore(folder)
        self._places = Growing(np.int64)
        self._stamps_ns = Growing(np.int64)
        self._logged_ns = Growing(np.int64)
        self._shape_index = Growing(np.int32)
        self._beam_interval_s = Growing(np.float64)
        self._recording = Growing(np.int32)

    def add(
        self, stamp_ns: int, logged_ns: int, ranges_m: F32, shape: ScanShape, beam_interval_s: float = 0.0
    ) -> None:
        """Append one sweep."""
        self._stamps_ns.add(stamp_ns)
        self._logged_ns.add(logged_ns)
        self._places.add(self._ranges.add(ranges_m))
        self._shape_index.add(self.number_of(shape))
        self._beam_interval_s.add(beam_interval_s)
        self._recording.add(0)

    def add_many(
        self, stamps_ns: I64, logged_ns: I64, ranges_m: F32, shape_index: I32, beam_interval_s: F64
    ) -> None:
        """Append sweeps of one number of beams: ranges (n, n_beams), and numbers (n,) of shapes in the table."""
        first = self._ranges.add(ranges_m)
        self._stamps_ns.extend(stamps_ns)
        self._logged_ns.extend(logged_ns)
        self._places.extend(first + ranges_m.shape[1] * np.arange(ranges_m.shape[0]))
        self._shape_index.extend(shape_index)
        self._beam_interval_s.extend(beam_interval_s)
        self._recording.extend(np.zeros(ranges_m.shape[0], dtype=np.int32))

    def number_of(self, shape: ScanShape) -> int:
        """Number of a shape in the table."""
        number = self._numbers.get(shape)
        if number is None:
            number = self._numbers[shape] = len(self.shape_table)
            self.shape_table.append(shape)
        return number

    def append(self, other: RawLaser, recording: int) -> None:
        """Put the sweeps of the same laser in another recording, the number of which is given, behind these."""
        numbers = np.array([self.number_of(shape) for shape in other.shape_table], dtype=np.int32)
        self._places.extend(other._places.rows + self._ranges.take_over(other._ranges))
        self._stamps_ns.extend(other.stamps_ns)
        self._logged_ns.extend(other.logged_ns)
        self._shape_index.extend(numbers[other.shape_index])
        self._beam_interval_s.extend(other.beam_interval_s)
        self._recording.extend(np.full(other.n_scans, recording, dtype=np.int32))

    def keep(self, wanted: B1 | I64) -> None:
        """Forget all other sweeps, or bring them into the order of numbers."""
        for column in (
            self._places,
            self._stamps_ns,
            self._logged_ns,
            self._shape_index,
            self._beam_interval_s,
            self._recording,
        ):
            column.rows = column.rows[wanted]

    def ranges_of(self, number: int) -> F32:
        """Ranges (n_beams,) of one sweep as recorded, metres."""
        place = int(self._places.rows[number])
        return self._ranges.read(place, place + self.shape_of(number).n_beams)

    def fill(self, into: F32, numbers: I64) -> None:
        """Write the ranges of sweeps into the rows of a table (n, widest); the rest of a row stays as it is."""
        lengths = self._lengths[self.shape_index[numbers]]
        self._ranges.fill(into, self._places.rows[numbers], lengths)

    def taken_ranges(self) -> F32 | None:
        """The ranges (n, n_beams) themselves, to be rewritten, if all have one length and lie in one file in order."""
        lengths, places = self.n_beams, self._places.rows
        width = int(lengths[0])
        if (lengths != width).any() or (places != width * np.arange(places.size)).any():
            return None
        return self._ranges.as_table(places.size, width)

    def shape_of(self, number: int) -> ScanShape:
        """Shape of one sweep."""
        return self.shape_table[int(self._shape_index.rows[number])]

    @property
    def stamps_ns(self) -> I64:
        """(n,) header stamps."""
        return self._stamps_ns.rows

    @stamps_ns.setter
    def stamps_ns(self, stamps_ns: I64) -> None:
        self._stamps_ns.rows = stamps_ns

    @property
    def logged_ns(self) -> I64:
        """(n,) when the messages were recorded; the stamps where only these are known."""
        return self._logged_ns.rows

    @logged_ns.setter
    def logged_ns(self, logged_ns: I64) -> None:
        self._logged_ns.rows = logged_ns

    @property
    def shape_index(self) -> I32:
        """(n,) number of the shape of each sweep."""
        return self._shape_index.rows

    @property
    def n_beams(self) -> I64:
        """(n,) beams of each sweep."""
        return np.asarray(self._lengths[self.shape_index])

    @property
    def _lengths(self) -> I64:
        """Beams of each shape in the table."""
        return np.array([shape.n_beams for shape in self.shape_table], dtype=np.int64)

    @property
    def beam_interval_s(self) -> F64:
        """(n,) time between beams as recorded; NaN where that is no duration."""
        return self._beam_interval_s.rows

    @property
    def recording(self) -> I32:
        """(n,) which recording a sweep came from."""
        return self._recording.rows

    @property
    def n_scans(self) -> int:
        """Number of sweeps."""
        return self.stamps_ns.size

    @property
    def usual_shape(self) -> ScanShape:
        """The shape of most sweeps; single damaged ones must not decide for the others."""
        counts = np.bincount(self.shape_index)
        most = np.flatnonzero(counts == counts.max())
        first = 0 if most.size == 1 else int(np.argmax(np.isin(self.shape_index, most)))
        return self.shape_table[int(most[0])] if most.size == 1 else self.shape_of(first)


class RawOdometry:
    """One source of odometry poses.

    Parameters
    ----------
    name : str
        Topic, or the first word of the lines of a text log.
    frame, child : str
        The poses are frame_from_child; "" in text logs.
    """

    def __init__(self, name: str, frame: str = "", child: str = "") -> None:
        self.name, self.frame, self.child = name, frame, child
        self._stamps_ns = Growing(np.int64)
        self._poses = Growing(np.float64, 3)

    def add(self, stamp_ns: int, pose: tuple[float, float, float]) -> None:
        """Append a pose: x, y in metres, yaw in radians."""
        self._stamps_ns.add(stamp_ns)
        self._poses.add(pose)

    def add_many(self, stamps_ns: I64, poses: F64) -> None:
        """Append poses (n, 3)."""
        self._stamps_ns.extend(stamps_ns)
        self._poses.extend(poses)

    @property
    def stamps_ns(self) -> I64:
        """(n,) in the order of recording."""
        return self._stamps_ns.rows

    @stamps_ns.setter
    def stamps_ns(self, stamps_ns: I64) -> None:
        self._stamps_ns.rows = stamps_ns

    @property
    def poses(self) -> F64:
        """(n, 3) in the order of recording."""
        return self._poses.rows

    def as_arrays(self) -> tuple[I64, F64]:
        """Stamps (n,) ascending, and poses (n, 3)."""
        return sorted_by_stamp(self.stamps_ns, self.poses)


class RawTransform:
    """All transforms published for one pair of frames.

    Parameters
    ----------
    is_static : bool
        Published as latched, valid for all times.
    """

    def __init__(self, is_static: bool) -> None:
        self.is_static = is_static
        self._stamps_ns = Growing(np.int64)
        self._values = Growing(np.float64, 7)

    def add(self, stamp_ns: int, values: tuple[float, ...]) -> None:
        """Append parent_from_child as x, y, z, qx, qy, qz, qw."""
        self._stamps_ns.add(stamp_ns)
        self._values.add(values)

    def add_many(self, stamps_ns: I64, values: F64) -> None:
        """Append transforms (n, 7)."""
        self._stamps_ns.extend(stamps_ns)
        self._values.extend(values)

    @property
    def stamps_ns(self) -> I64:
        """(n,) in the order of recording."""
        return self._stamps_ns.rows

    @stamps_ns.setter
    def stamps_ns(self, stamps_ns: I64) -> None:
        self._stamps_ns.rows = stamps_ns

    @property
    def values(self) -> F64:
        """(n, 7) in the order of recording."""
        return self._values.rows


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
    folder : Path or None
        On which disk ranges lie that do not fit into memory; None = where temporary files are put.
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
    folder: Path | None = None

    def laser(self, name: str, frame: str = "") -> RawLaser:
        """The laser of a name, a new one where there is none yet."""
        found = self.lasers.get(name)
        if found is None:
            found = self.lasers[name] = RawLaser(name, frame, folder=self.folder)
        return found

    @property
    def span_ns(self) -> tuple[int, int]:
        """Earliest and latest stamp of any sweep."""
        stamps = [laser.stamps_ns for laser in self.lasers.values()]
        return int(min(part.min() for part in stamps)), int(max(part.max() for part in stamps))

    def drop_broken(self, what: str) -> None:
        """Count a message or line that is broken."""
        self.dropped[what] += 1
        if what not in self.damage:
            self.damage.append(what)


def file_name(name: str) -> str:
    """Last part of a recording's path: what is written into results, which do not depend on where it lies."""
    path = Path(name)
    return path.name if path.name not in {"", ".."} else path.resolve().name


def sorted_by_stamp(stamps_ns: I64, rows: F64) -> tuple[I64, F64]:
    """Return stamps (n,) in ascending order with their rows (n, width); of equal stamps the first counts."""
    if (np.diff(stamps_ns) > 0).all():
        return stamps_ns, rows
    unique, first = np.unique(stamps_ns, return_index=True)
    return unique, rows[first]
