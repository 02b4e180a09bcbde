"""Whether beams without return pass through what other beams hit: then they did not find free space, they failed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import B1, F32, F64, I32, I64

_WINDOWS, _SCANS, _BEAMS = 8, 60, 90
_STEP_M, _FARTHEST_M = 0.2, 10.0
_BEFORE_END_M = 0.5
_LEAST_HITS, _SOLID = 3, 0.5
_LEAST_BEAMS = 50
_WIDEST_M = 500.0


@dataclass(frozen=True, slots=True)
class Sweeps:
    """Sweeps of one laser with the places of their beams.

    Attributes
    ----------
    ranges_m : (n, n_beams) float32
        As recorded; NaN also where a geometry has fewer beams.
    bearings_rad : (n_geometries, n_beams) float64
    geometry_index : (n,) int32
    odom_from_sensor : (n, 3) float64
        NaN where unknown.
    """

    ranges_m: F32
    bearings_rad: F64
    geometry_index: I32
    odom_from_sensor: F64


@dataclass(frozen=True, slots=True)
class Contradiction:
    """How many beams cross cells that are solid for the others.

    Attributes
    ----------
    of_no_returns : float
        Share of the beams without return that cross one within the reach, or 10 m.
    of_returns : float
        The same for beams with a return, up to 0.5 m before their end: what errors of the poses explain.
    """

    of_no_returns: float
    of_returns: float


def kinds_of(ranges_m: F32, range_min_m: float, reach_m: float) -> tuple[B1, B1]:
    """Which values are returns, and which say that there was none, each of the shape of the ranges."""
    is_return = (ranges_m >= np.float32(range_min_m)) & (ranges_m < np.float32(reach_m)) & (ranges_m > 0.0)
    return is_return, ranges_m >= np.float32(reach_m)


def find_contradiction(sweeps: Sweeps, range_min_m: float, reach_m: float) -> Contradiction | None:
    """Trace beams through grids of 20 cm drawn from 60 scans each, short enough for odometry to hold.

    Where the odometry leaves 500 m within these it does not hold, and they are passed over. A cell is solid where at
    least three beams end, and no fewer than pass.

    Parameters
    ----------
    sweeps : Sweeps
    range_min_m, reach_m : float
        Returns lie between them.

    Returns
    -------
    Contradiction or None
        None where too few beams have no return, or too few scans a pose.
    """
    ranges_m, origins = sweeps.ranges_m, sweeps.odom_from_sensor
    windows, counted = [], np.zeros(2)
    farthest_m = min(reach_m, _FARTHEST_M)
    picked = slice(None, None, max(1, ranges_m.shape[1] // _BEAMS))
    for start in np.unique(np.linspace(0, max(ranges_m.shape[0] - _SCANS, 0), _WINDOWS).astype(np.int64)):
        scans = np.arange(start, min(start + _SCANS, ranges_m.shape[0]))
        scans = scans[np.isfinite(origins[scans]).all(axis=1)]
        if scans.size < _LEAST_HITS or np.ptp(origins[scans, :2], axis=0).max() > _WIDEST_M:
            continue
        is_return, is_no_return = kinds_of(np.array(ranges_m[scans])[:, picked], range_min_m, reach_m)
        counted += np.count_nonzero(is_no_return), np.count_nonzero(is_return)
        windows.append(scans)
    if counted.min() < _LEAST_BEAMS:
        return None
    crossing = np.zeros(2)
    for scans in windows:
        values = np.array(ranges_m[scans])[:, picked]
        is_return, is_no_return = kinds_of(values, range_min_m, reach_m)
        bearings_rad = sweeps.bearings_rad[sweeps.geometry_index[scans], picked]
        angle_rad = origins[scans, 2, None] + bearings_rad
        crosses = _crosses_solid(
            np.where(is_return, values, np.inf), angle_rad, origins[scans, :2], farthest_m
        )
        crossing += np.count_nonzero(crosses & is_no_return), np.count_nonzero(crosses & is_return)
    shares = crossing / counted
    return Contradiction(float(shares[0]), float(shares[1]))


def _crosses_solid(length_m: F64, angle_rad: F64, origins_m: F64, farthest_m: float) -> B1:
    """(n, n_beams) whether a beam crosses a solid cell; beams of infinite length are traced up to *farthest_m*."""
    lengths_m = length_m.ravel()
    angle_rad = np.where(np.isfinite(angle_rad), angle_rad, 0.0).ravel()
    # In cells from here on, and short numbers: this is most of what is done to tell what no return says.
    direction = [part(angle_rad).astype(np.float32) for part in (np.cos, np.sin)]
    origins = (origins_m - origins_m.min(axis=0) + farthest_m) / _STEP_M + 1.0
    n_cells = int(np.ceil(origins.max() + farthest_m / _STEP_M)) + 2
    starts = [np.repeat(column.astype(np.float32), length_m.shape[1]) for column in origins.T]

    def cells(counts: I64, along: F32) -> I32:
        """Flat cell numbers of points, so many on each beam; all beyond zero, where cutting off is rounding down."""
        x, y = (
            (np.repeat(start, counts) + along * np.repeat(part, counts)).astype(np.int32)
            for start, part in zip(starts, direction, strict=True)
        )
        return np.asarray(x * np.int32(n_cells) + y)

    ends = lengths_m < farthest_m
    ends_at = (lengths_m[ends] / _STEP_M).astype(np.float32)
    hits = np.bincount(cells(ends.astype(np.int64), ends_at), minlength=n_cells**2)
    # Points at fixed steps before the end of each beam, those of one beam after those of another.
    counts = np.searchsorted(np.arange(_STEP_M, farthest_m, _STEP_M), lengths_m - _BEFORE_END_M)
    first = (np.cumsum(counts) - counts).astype(np.int32)
    steps = np.arange(1, counts.sum() + 1, dtype=np.int32) - np.repeat(first, counts)
    samples = cells(counts, steps.astype(np.float32))
    of_endless = samples[np.repeat(np.isinf(lengths_m), counts)]
    passes = np.bincount(samples, minlength=n_cells**2) - np.bincount(of_endless, minlength=n_cells**2)
    is_solid = (hits >= _LEAST_HITS) & (hits >= _SOLID * (hits + passes))
    crosses = np.zeros(lengths_m.size, dtype=bool)
    crosses[np.repeat(np.arange(counts.size), counts)[is_solid[samples]]] = True
    return crosses.reshape(length_m.shape)
