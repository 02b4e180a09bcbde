"""When sweeps were made, and how the robot moved during them."""

from __future__ import annotations

import numpy as np

from dynmap_cli.arrays import F64, I32, I64
from dynmap_cli.domain.scans import ScanLog

_LONGEST_STEP_S = 2.0
_HALF_WINDOW, _LEAST_SWEEPS = 7, 30
_JITTER_PERIODS, _JITTER_CORRELATION, _PAUSE_PERIODS = 0.1, -0.4, 3.0


def steady_times_s(times_s: F64) -> F64:
    """Times of the sweeps of one laser, without the jitter of their stamps.

    A laser turns steadily, but some drivers stamp its sweeps when they come to hand. A sweep that is stamped late
    then seems to follow late on the one before and to be followed early by the next: times between sweeps vary, and
    neighbouring ones correlate by -1/2, as differences of independent errors do. Only then is each time replaced by
    the line through those of 15 sweeps around; pauses divide them.

    Parameters
    ----------
    times_s : (n,) float64
        Ascending.

    Returns
    -------
    (n,) float64
        Ascending.
    """
    steps = np.diff(times_s)
    if times_s.size < _LEAST_SWEEPS or not (steps > 0.0).any():
        return times_s
    period = float(np.median(steps[steps > 0.0]))
    off = np.minimum(steps, _PAUSE_PERIODS * period)
    off = off - off.mean()
    varies = float(off.std()) > _JITTER_PERIODS * period
    if not varies or float((off[1:] * off[:-1]).mean()) > _JITTER_CORRELATION * float((off * off).mean()):
        return times_s
    parts = np.split(times_s, np.flatnonzero(steps > _PAUSE_PERIODS * period) + 1)
    return np.maximum.accumulate(np.concatenate([_smoothed(part) for part in parts]))


def _smoothed(times_s: F64) -> F64:
    """Each time by the line through those around it; at both ends, by the line through the outermost."""
    n = times_s.size
    width = min(2 * _HALF_WINDOW + 1, n - 1 + n % 2)
    half = width // 2
    if half == 0:
        return times_s
    since = times_s - times_s[0]
    middle = np.convolve(since, np.full(width, 1.0 / width), mode="valid")
    offsets = np.arange(-half, half + 1, dtype=np.float64)
    slopes = [float(offsets @ ends) / float(offsets @ offsets) for ends in (since[:width], since[-width:])]
    before = middle[0] + slopes[0] * offsets[:half]
    after = middle[-1] + slopes[1] * offsets[half + 1 :]
    return np.asarray(times_s[0] + np.concatenate([before, middle, after]))


def series_of(sensor_poses: F64, geometry_index: I32, drive_index: I32) -> I64:
    """(n_scans,) equal numbers for the sweeps of one laser in one drive; those at one place on the robot are one.

    Parameters
    ----------
    sensor_poses : (n_geometries, 3) float64
    geometry_index, drive_index : (n_scans,) int32
    """
    _, laser = np.unique(sensor_poses, axis=0, return_inverse=True)
    first = drive_index.astype(np.int64) * sensor_poses.shape[0]
    return np.asarray(first + laser.reshape(-1)[geometry_index], dtype=np.int64)


def sweep_times_s(log: ScanLog) -> F64:
    """(n_scans,) seconds from the first stamp to each sweep, in the order of the log; see `steady_times_s`."""
    times_s = np.asarray((log.stamps_ns - log.stamps_ns[:1]) * 1e-9)
    series = series_of(log.sensor_poses, log.geometry_index, log.drive_index)
    for one in np.unique(series):
        times_s[series == one] = steady_times_s(times_s[series == one])
    return times_s


def sweep_durations_s(beam_interval_s: F64, bearings_rad: F64) -> F64:
    """(n_geometries,) seconds that a sweep lasts.

    Parameters
    ----------
    beam_interval_s : (n_geometries,) float64
    bearings_rad : (n_geometries, n_beams) float64
        NaN where a geometry has fewer beams.
    """
    return np.asarray(np.abs(beam_interval_s) * np.isfinite(bearings_rad).sum(axis=1))


def sweep_twists(times_s: F64, poses: F64, durations_s: F64, series: I64) -> F64:
    """Velocity during each sweep, robot frame, by the path from half a sweep before to half a sweep after it.

    A single step of the path from sweep to sweep has the errors of both poses; this mean over the time of two
    sweeps has half their variance, and is centred on the sweep all the same.

    Parameters
    ----------
    times_s : (n,) float64
        Of the first beams.
    poses : (n, 3) float64
        map_from_robot; NaN = not known.
    durations_s : (n,) float64
        Of each sweep; 0 = all beams at once.
    series : (n,) int64
        See `series_of`: steps from one laser to another show how well their poses agree, not how the robot moved.

    Returns
    -------
    (n, 3) float64
        Zero where sweeps take no time, where the next one comes more than two seconds later, and without a pose.
    """
    twists = np.zeros((times_s.size, 3))
    for one in np.unique(series):
        rows = np.flatnonzero((series == one) & np.isfinite(poses).all(axis=1))
        rows = rows[np.argsort(times_s[rows], kind="stable")]
        if rows.size < 2:
            continue
        at_s, path = times_s[rows], poses[rows].copy()
        path[:, 2] = np.unwrap(path[:, 2])
        from_s = np.maximum(at_s - 0.5 * durations_s[rows], at_s[0])
        to_s = np.minimum(at_s + 1.5 * durations_s[rows], at_s[-1])
        moved = np.stack(
            [np.interp(to_s, at_s, each) - np.interp(from_s, at_s, each) for each in path.T], axis=1
        )
        cos, sin = np.cos(path[:, 2]), np.sin(path[:, 2])
        usable = (to_s > from_s) & (durations_s[rows] > 0.0)
        usable[:-1] &= np.diff(at_s) < _LONGEST_STEP_S
        elapsed_s = np.where(usable, to_s - from_s, 1.0)[:, None]
        in_robot = np.stack(
            [cos * moved[:, 0] + sin * moved[:, 1], cos * moved[:, 1] - sin * moved[:, 0], moved[:, 2]],
            axis=1,
        )
        twists[rows] = np.where(usable[:, None], in_robot / elapsed_s, 0.0)
    return twists
