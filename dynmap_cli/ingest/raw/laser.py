"""The sweeps of one laser as they were written, before anything is decided."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dynmap_cli.arrays import F32, F64, I32, I64
from dynmap_cli.ingest.raw.columns import Growing, RangeStore, counts_of, steps_in
from dynmap_cli.ingest.raw.stamped import Stamped

LONGEST_REACH_M = 120.0
"""No laser that sweeps a plane reaches farther."""


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

    def scaled(self, metres: float) -> ScanShape:
        """The same where limits are in a unit of so many metres, unless the reach is one in metres already."""
        if self.range_max_m <= LONGEST_REACH_M:
            return self
        return self._replace(range_min_m=self.range_min_m * metres, range_max_m=self.range_max_m * metres)


class RawLaser(Stamped):
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
        super().__init__(folder)
        self.name, self.frame, self.robot_from_sensor = name, frame, robot_from_sensor
        self.shape_table: list[ScanShape] = []
        """Shapes by number, in the order in which they came first."""
        self._numbers: dict[ScanShape, int] = {}
        self._ranges = RangeStore(folder)
        self._places = Growing(np.int64, folder=folder)
        self._shape_index = Growing(np.int32, folder=folder)
        self._beam_interval_s = Growing(np.float64, folder=folder)
        self._recording = Growing(np.int32, folder=folder)

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

    def append(self, other: RawLaser, recording: int | None = None) -> None:
        """Put the sweeps of the same laser in another recording, the number of which is given, behind these."""
        numbers = np.array([self.number_of(shape) for shape in other.shape_table], dtype=np.int32)
        self._places.extend(other._places.rows + self._ranges.take_over(other._ranges))
        self._stamps_ns.extend(other.stamps_ns)
        self._logged_ns.extend(other.logged_ns)
        self._shape_index.extend(numbers[other.shape_index])
        self._beam_interval_s.extend(other.beam_interval_s)
        number = other.recording if recording is None else np.full(other.n_scans, recording, dtype=np.int32)
        self._recording.extend(number)

    @property
    def _columns(self) -> tuple[Growing, ...]:
        return (
            *super()._columns,
            self._places,
            self._shape_index,
            self._beam_interval_s,
            self._recording,
        )

    def ranges_of(self, number: int) -> F32:
        """Ranges (n_beams,) of one sweep as recorded, metres."""
        place = int(self._places.rows[number])
        return self._ranges.read(place, place + self.shape_of(number).n_beams)

    def fill(self, into: F32, numbers: I64) -> None:
        """Write the ranges of sweeps into the rows of a table (n, widest); the rest of a row stays as it is."""
        lengths = self._lengths[self.shape_index[numbers]]
        self._ranges.fill(into, self._places.rows[numbers], lengths)

    def sample(self, most: int) -> F32:
        """Ranges (n, widest) of so many sweeps at most, evenly spread; missing beams are NaN."""
        picked = np.linspace(0, self.n_scans - 1, min(most, self.n_scans)).astype(np.int64)
        values = np.full((picked.size, int(self.lengths_counted[0][-1])), np.nan, dtype=np.float32)
        self.fill(values, picked)
        return values

    def scale_ranges(self, metres: float) -> None:
        """Bring ranges to metres that are in a unit of so many, and limits that are too large for metres."""
        self._ranges = self._ranges.scaled(metres)
        self.shape_table = [shape.scaled(metres) for shape in self.shape_table]
        self._numbers = {shape: number for number, shape in enumerate(self.shape_table)}

    def taken_ranges(self) -> F32 | None:
        """The ranges (n, n_beams) themselves, to be rewritten, if all have one length and lie in one piece in order."""
        places, widths = self._places.rows, self.lengths_counted[0]
        width = int(widths[0])
        if widths.size > 1 or int(places[0]) or any((steps != width).any() for steps in steps_in(places)):
            return None
        return self._ranges.as_table(places.size, width)

    def shape_of(self, number: int) -> ScanShape:
        """Shape of one sweep."""
        return self.shape_table[int(self._shape_index.rows[number])]

    @property
    def shape_index(self) -> I32:
        """(n,) number of the shape of each sweep."""
        return self._shape_index.rows

    @property
    def n_beams(self) -> I64:
        """(n,) beams of each sweep."""
        return np.asarray(self._lengths[self.shape_index])

    @property
    def lengths_counted(self) -> tuple[I64, I64]:
        """Numbers of beams (k,) that occur, ascending, and how many sweeps have each."""
        lengths, number = np.unique(self._lengths, return_inverse=True)
        counts = np.zeros(lengths.size, dtype=np.int64)
        np.add.at(counts, number, self._shape_counts)
        return lengths[counts > 0], counts[counts > 0]

    @property
    def _shape_counts(self) -> I64:
        """How many sweeps have each shape of the table."""
        return counts_of(self.shape_index, len(self.shape_table))

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
        counts = self._shape_counts
        most = np.flatnonzero(counts == counts.max())
        first = 0 if most.size == 1 else int(np.argmax(np.isin(self.shape_index, most)))
        return self.shape_table[int(most[0])] if most.size == 1 else self.shape_of(first)


def most_used(lasers: Iterable[RawLaser]) -> RawLaser | None:
    """The laser with most sweeps; of equal ones the last by name."""
    return max(lasers, key=lambda one: (one.n_scans, one.name), default=None)
