"""How a laser turned between its sweeps, by these alone: what tells an odometry, a clock or a mounting that is wrong.

When a laser turns by d, what was at the bearing b + d is at b: the turn is the shift of the readings under which two
sweeps are most alike. That is coarse, and right often enough for a median over many pairs of sweeps.

A robot mostly drives straight on, which says nothing of its turns. So half of the pairs are those in which an odometry,
if there is one, turns most; the others are spread evenly, as odometry may be wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from dynmap_cli.arrays import B1, F32, F64, I64
from dynmap_cli.domain.poses import wrap_angle
from dynmap_cli.ingest.raw.laser import RawLaser, ScanShape
from dynmap_cli.ingest.seen_motion.pairs import SweepPairs, rows_at

_SPAN_S, _LEAST_STEP_S = 0.5, 1e-3
_MOST_PAIRS, _BEAMS_COMPARED = 200, 90
_STEP_RAD, _FARTHEST_RAD = np.radians(1.0), np.radians(60.0)
_WITHIN_REACH_RAD = np.radians(45.0)
_CAP_M = 0.5
_ALIKE = 0.5
_LEAST_OVERLAP = 0.3
TURNING_RAD = np.radians(6.0)
"""From there on a turn between two sweeps is one, and not noise or swaying."""


@dataclass(frozen=True, slots=True)
class Headings:
    """Odometries that may be used, at the sweeps.

    Attributes
    ----------
    stamps_ns : (n,) int64
        Ascending.
    tracks : sequence of (n, 3) float64
        Poses of each; NaN = none.
    """

    stamps_ns: I64
    tracks: Sequence[F64]

    def turned_rad(self, first_ns: I64, second_ns: I64) -> F64:
        """(m,) how far that odometry turned which turned most; 0 where nobody knows."""
        most = np.zeros(first_ns.size)
        for poses in self.tracks:
            yaws = [poses[rows_at(self.stamps_ns, at_ns), 2] for at_ns in (first_ns, second_ns)]
            most = np.fmax(most, np.abs(wrap_angle(yaws[1] - yaws[0])))
        return most


@dataclass(frozen=True, slots=True)
class ScanTurns:
    """Turns of a laser between pairs of its sweeps, of those turns that can be told.

    Attributes
    ----------
    first_ns, second_ns : (n,) int64
        Stamps of the sweeps, about half a second apart, less where the robot turns too far in that time.
    turns_rad : (n,) float64
        Counter-clockwise in the frame of the laser, as its bearings run.
    pairs : SweepPairs
        These sweeps, of every so many beams.
    robot_from_sensor : (3,) float64
        Where the laser sits, as far as is known.
    """

    first_ns: I64
    second_ns: I64
    turns_rad: F64
    pairs: SweepPairs
    robot_from_sensor: F64 = field(default_factory=lambda: np.zeros(3))


def turns_of(laser: RawLaser, headings: Headings | None = None, part: slice | None = None) -> ScanTurns:
    """Find how a laser turned, by pairs of its sweeps of the usual shape, many of them where odometries turn.

    Of a part only, if one is given, in the order of recording.
    """
    usual = int(np.argmax(np.bincount(laser.shape_index)))
    rows = np.flatnonzero(laser.shape_index == usual)
    if part is not None:
        rows = rows[(rows >= part.start) & (rows < part.stop)]
    stamps_ns = laser.stamps_ns[rows]
    order = np.argsort(stamps_ns, kind="stable")
    rows, stamps_ns = rows[order], stamps_ns[order]
    shape = laser.shape_table[usual]
    every = max(1, round(_STEP_RAD / max(abs(shape.increment_rad), 1e-9)))
    n_kept = -(-shape.n_beams // every)
    starts, apart = _pairs_of(stamps_ns, headings) if n_kept > 1 else (rows[:0], 1)
    if not starts.size:
        return _no_turns(shape)
    step_rad = every * shape.increment_rad
    n_shifts = min(int(_FARTHEST_RAD / abs(step_rad)), int((1.0 - _LEAST_OVERLAP) * n_kept))
    before, after = (
        _values(laser, rows[numbers], shape.range_max_m)[:, ::every] for numbers in (starts, starts + apart)
    )
    shift, is_told = _best_shifts(before, after, n_shifts)
    first_ns, second_ns = stamps_ns[starts], stamps_ns[starts + apart]
    is_told &= second_ns - first_ns < 4 * _SPAN_S * 1e9
    return ScanTurns(
        first_ns[is_told],
        second_ns[is_told],
        shift[is_told] * step_rad,
        SweepPairs(before[is_told], after[is_told], shape.bearings_rad[::every]),
    )


def _no_turns(shape: ScanShape) -> ScanTurns:
    """Of a laser with too few sweeps or beams."""
    stamps_ns, ranges_m = np.zeros(0, dtype=np.int64), np.zeros((0, shape.n_beams), dtype=np.float32)
    return ScanTurns(stamps_ns, stamps_ns, np.zeros(0), SweepPairs(ranges_m, ranges_m, shape.bearings_rad))


def _pairs_of(stamps_ns: I64, headings: Headings | None) -> tuple[I64, int]:
    """First sweeps (n,) of the pairs, and after how many comes the second, so that the turn can be told."""
    steps_s = np.diff(stamps_ns) * 1e-9
    if not steps_s.size:
        return np.zeros(0, dtype=np.int64), 1
    apart = max(1, round(_SPAN_S / max(float(np.median(steps_s)), _LEAST_STEP_S)))
    turning, turned_rad = _turning(stamps_ns, headings, apart)
    while apart > 1 and turning.size and np.median(turned_rad) > _WITHIN_REACH_RAD:
        apart = -(-apart // 2)
        turning, turned_rad = _turning(stamps_ns, headings, apart)
    most = np.argsort(-turned_rad, kind="stable")[: _MOST_PAIRS // 2]
    n_even = min(_MOST_PAIRS - most.size, max(stamps_ns.size - apart, 0))
    even = np.linspace(0, stamps_ns.size - apart - 1, n_even).astype(np.int64)
    return np.union1d(even, turning[most]), apart


def _turning(stamps_ns: I64, headings: Headings | None, apart: int) -> tuple[I64, F64]:
    """Sweeps (m,) after which an odometry turns, each span after the one before, and how far (m,)."""
    starts = np.arange(0, stamps_ns.size - apart, apart)
    if headings is None:
        return starts[:0], np.zeros(0)
    turned_rad = headings.turned_rad(stamps_ns[starts], stamps_ns[starts + apart])
    is_turning = turned_rad > TURNING_RAD
    return starts[is_turning], turned_rad[is_turning]


class ReferenceLaser:
    """The laser with most sweeps of a recording, by which clocks and odometry are judged before one is chosen.

    Its own stamps stay as they are, so its turns are found once, when they are first asked for.
    """

    def __init__(self, laser: RawLaser) -> None:
        self.laser = laser

    @cached_property
    def turns(self) -> ScanTurns:
        """See `turns_of`."""
        return turns_of(self.laser)


def _values(laser: RawLaser, rows: I64, range_max_m: float) -> F32:
    """Ranges (n, n_beams) of sweeps, NaN where they are no returns."""
    values = np.full((rows.size, int(laser.n_beams[rows].max())), np.nan, dtype=np.float32)
    laser.fill(values, rows)
    values[~((values > 0.0) & (values < np.float32(range_max_m)))] = np.nan
    return values


def _best_shifts(before: F32, after: F32, n_shifts: int) -> tuple[I64, B1]:
    """Shift (n,) under which sweeps (n, n_beams) are most alike, and whether (n,) it stands out among the others.

    The cost of a shift is the mean difference, capped, of the beams that both have, of which some, evenly spread,
    are compared; inf where these are few.
    """
    # Beams first, so that each shift is one piece of memory; what is unknown weighs nothing.
    before, after = np.ascontiguousarray(before.T), np.ascontiguousarray(after.T)
    known = [np.isfinite(sweeps).astype(np.float32) for sweeps in (before, after)]
    before, after = (np.nan_to_num(sweeps, nan=0.0) for sweeps in (before, after))
    is_whole = all(weights.all() for weights in known)
    n_beams, n_pairs = before.shape
    every = max(1, n_beams // _BEAMS_COMPARED)
    costs = np.full((2 * n_shifts + 1, n_pairs), np.inf)
    scratch = np.empty((n_beams, n_pairs), dtype=np.float32)
    for row, shift in enumerate(range(-n_shifts, n_shifts + 1)):
        left = slice(max(shift, 0), n_beams + min(shift, 0), every)
        right = slice(max(-shift, 0), n_beams - max(shift, 0), every)
        off_m = scratch[: -(-(n_beams - abs(shift)) // every)]
        np.subtract(before[left], after[right], out=off_m)
        np.abs(off_m, out=off_m)
        np.minimum(off_m, np.float32(_CAP_M), out=off_m)
        counts = np.full(n_pairs, off_m.shape[0], dtype=np.float32)
        if not is_whole:
            both = known[0][left] * known[1][right]
            off_m *= both
            counts = both.sum(axis=0)
        enough = counts >= _LEAST_OVERLAP * n_beams / every
        costs[row, enough] = off_m.sum(axis=0)[enough] / counts[enough]
    best = np.argmin(costs, axis=0)
    is_told = (best > 0) & (best < 2 * n_shifts)
    is_told &= costs.min(axis=0) < _ALIKE * np.median(np.minimum(costs, _CAP_M), axis=0)
    return best - n_shifts, is_told
