"""What can be wrong with a recording, done to scans that are right."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dynmap_cli.arrays import F32, F64
from dynmap_cli.domain.poses import between, wrap_angle
from dynmap_cli.domain.scans import ScanLog

_LAG_S, _TURN_SCALE, _BIAS_DEG_M = 0.2, 1.05, 2.0
_FREEZE_S = 5.0
_NOISE_M, _NOISE_SEED = 0.02, 1
_TRACE_M = 0.001


def every_second_beam(log: ScanLog) -> ScanLog:
    """Half the beams."""
    return replace(
        log,
        ranges_m=np.ascontiguousarray(log.ranges_m[:, ::2]),
        bearings_rad=np.ascontiguousarray(log.bearings_rad[:, ::2]),
        beam_interval_s=2.0 * log.beam_interval_s,
    )


def noisier_ranges(log: ScanLog) -> ScanLog:
    """Further noise of 2 cm on every range."""
    return _noisier(log, _NOISE_M, _NOISE_SEED)


def redrawn(log: ScanLog, seed: int) -> ScanLog:
    """Further noise of 1 mm, a tenth of what lasers have: it tells what of a result is chance."""
    return _noisier(log, _TRACE_M, seed)


def _noisier(log: ScanLog, sigma_m: float, seed: int) -> ScanLog:
    noise = np.random.default_rng(seed).normal(0.0, sigma_m, log.ranges_m.shape)
    ranges: F32 = np.asarray(log.ranges_m + noise.astype(np.float32))
    return replace(log, ranges_m=np.maximum(ranges, 0.001))


def late_odometry(log: ScanLog) -> ScanLog:
    """Each scan gets the odometry of 0.2 s before."""
    order, times_s = _in_order(log)
    poses = np.array(log.odometry[order])
    poses[:, 2] = np.unwrap(poses[:, 2])
    late = np.column_stack([np.interp(times_s - _LAG_S, times_s, column) for column in poses.T])
    return _with_odometry(log, late)


def wrong_turns(log: ScanLog) -> ScanLog:
    """Turns counted 5 % too large."""
    steps = _steps(log)
    steps[:, 2] *= _TURN_SCALE
    return _driven(log, steps)


def biased_turns(log: ScanLog) -> ScanLog:
    """Two degrees of turn more for each metre."""
    steps = _steps(log)
    steps[:, 2] += np.radians(_BIAS_DEG_M) * np.linalg.norm(steps[:, :2], axis=1)
    return _driven(log, steps)


def lost_sign(log: ScanLog) -> ScanLog:
    """Driving backwards is counted as driving forwards."""
    steps = _steps(log)
    steps[:, 0] = np.abs(steps[:, 0])
    return _driven(log, steps)


def frozen_odometry(log: ScanLog) -> ScanLog:
    """The odometry stands still for the 5 s in which the robot drives most; motion meanwhile is not counted."""
    steps = _steps(log)
    _, times_s = _in_order(log)
    way = np.cumsum(np.linalg.norm(steps[:, :2], axis=1) + np.abs(steps[:, 2]))
    end = np.minimum(np.searchsorted(times_s, times_s + _FREEZE_S), times_s.size - 1)
    begin = int(np.argmax(way[end] - way))
    steps[begin + 1 : end[begin] + 1] = 0.0
    return _driven(log, steps)


def no_odometry(log: ScanLog) -> ScanLog:
    """No odometry at all."""
    return replace(log, odometry=np.full_like(log.odometry, np.nan))


PERTURBATIONS: dict[str, Callable[[ScanLog], ScanLog]] = {
    "as recorded": lambda log: log,
    "every second beam": every_second_beam,
    "2 cm more range noise": noisier_ranges,
    "odometry 0.2 s late": late_odometry,
    "turns 5 % too large": wrong_turns,
    "2 deg/m bias": biased_turns,
    "no sign": lost_sign,
    "frozen for 5 s": frozen_odometry,
    "no odometry": no_odometry,
}


def _in_order(log: ScanLog) -> tuple[np.ndarray, F64]:
    """Scan numbers in the order in which the sweeps were made, and their times in seconds, never descending."""
    order = np.argsort(log.arrival_index, kind="stable")
    return order, np.maximum.accumulate((log.stamps_ns[order] - log.stamps_ns[0]) / 1e9)


def _steps(log: ScanLog) -> F64:
    """(n_scans, 3) motion since the sweep before, in its frame; row 0 is zero."""
    order, _ = _in_order(log)
    poses = log.odometry[order]
    return np.concatenate([np.zeros((1, 3)), between(poses[:-1], poses[1:])])


def _driven(log: ScanLog, steps: F64) -> ScanLog:
    """The log with an odometry that sums up these steps."""
    yaw = np.cumsum(steps[:, 2])
    before = np.concatenate([[0.0], yaw[:-1]])
    x = np.cumsum(np.cos(before) * steps[:, 0] - np.sin(before) * steps[:, 1])
    y = np.cumsum(np.sin(before) * steps[:, 0] + np.cos(before) * steps[:, 1])
    return _with_odometry(log, np.column_stack([x, y, yaw]))


def _with_odometry(log: ScanLog, in_order: F64) -> ScanLog:
    """Put an odometry back from the order of the sweeps into that of the log."""
    order, _ = _in_order(log)
    odometry = np.empty_like(in_order)
    odometry[order] = in_order
    odometry[:, 2] = wrap_angle(odometry[:, 2])
    return replace(log, odometry=odometry)
