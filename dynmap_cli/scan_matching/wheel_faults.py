"""Where the wheels are not to be believed: odometry that stands still or slips while the scans say otherwise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import B1, F64
from dynmap_cli.domain.poses import between, wrap_angle

_STILL_M, _STILL_RAD = 2e-4, 2e-4
_FROZEN_S, _FROZEN_STEPS, _WORSE_SHARE = 0.6, 3, 0.08
_MOVED_M, _MOVED_RAD = 0.3, 0.35
_BEGUN_M, _BEGUN_RAD = 0.05, 0.05
_WINDOW_S = 1.0
_SLIP_M, _SLIP_SHARE = 0.2, 0.35
_SLIP_RAD, _SLIP_TURN_SHARE = 0.17, 0.2
_STEP_M, _STEP_RAD = 0.03, 0.03
_MARGIN = 2


@dataclass(frozen=True, slots=True)
class WheelFault:
    """A stretch of the recording in which odometry and scans do not agree.

    Attributes
    ----------
    is_frozen : bool
        The odometry stood still while the robot moved; False = it counted motion that was not, or missed some.
    steps : tuple of int
        Rows of the odometry's motion that are not to be believed.
    start_s, end_s : float
        When it was seen to be wrong, seconds since the first sweep.
    odometry_m, odometry_rad, scans_m, scans_rad : float
        Distance and turn between these times, by calibrated odometry and by the scans.
    """

    is_frozen: bool
    steps: tuple[int, ...]
    start_s: float
    end_s: float
    odometry_m: float
    odometry_rad: float
    scans_m: float
    scans_rad: float


def find_wheel_faults(
    motion: F64, times_s: F64, poses: F64, is_lost: B1, *, reversible: bool
) -> list[WheelFault]:
    """Compare calibrated odometry with the registered path; faults in the order of time.

    Parameters
    ----------
    motion : (n_scans, 3) float64
        Corrected odometry steps, as of `corrected_motion`; NaN where there is no odometry.
    times_s : (n_scans,) float64
        Ascending.
    poses : (n_scans, 3) float64
        The registered path.
    is_lost : (n_scans,) bool
        Scans that fitted nowhere; their poses say nothing.
    reversible : bool
        The odometry has no sign, only lengths can be compared.
    """
    if times_s.size < _FROZEN_STEPS + 1:
        return []
    reckoned = _dead_reckoned(motion)
    frozen = list(_frozen(motion, times_s, poses, is_lost))
    slipped = _slipped(motion, times_s, reckoned, poses, is_lost, reversible=reversible)
    slipped = [span for span in slipped if not any(_overlap(span, still) for still, _ in frozen)]
    faults = []
    for (first, last), moved in frozen:
        steps = _steps_of_freeze(first, last, times_s.size)
        faults.append(_fault(steps, moved, times_s, reckoned, poses, is_frozen=True))
    disagrees = _disagrees(motion, poses)
    for first, last in slipped:
        near = range(max(first - _MARGIN, 0) + 1, min(last + _MARGIN, times_s.size - 1) + 1)
        wrong = tuple(step for step in near if disagrees[step])
        fault = _fault(wrong, (first, last), times_s, reckoned, poses, is_frozen=False)
        wrong_turn = abs(float(wrap_angle(np.array(fault.odometry_rad - fault.scans_rad))))
        if abs(fault.odometry_m - fault.scans_m) > _SLIP_M / 2 or wrong_turn > _SLIP_RAD / 2:
            faults.append(fault)
    return sorted(faults, key=lambda fault: fault.start_s)


def suspicious_stops(motion: F64, times_s: F64, shares: F64) -> list[tuple[int, ...]]:
    """Steps of stretches in which the odometry stands still and the scans fit worse than usual.

    Where hardly anything is seen ahead, odometry that stands still can hold the path with it.

    Parameters
    ----------
    motion : (n_scans, 3) float64
    times_s : (n_scans,) float64
    shares : (n_scans,) float64
        Matched share of each scan.
    """
    usual = float(np.median(shares))
    return [
        _steps_of_freeze(first, last, times_s.size)
        for first, last in _long_stops(motion, times_s)
        if float(shares[first + 1 : last + 1].mean()) < usual - _WORSE_SHARE
    ]


def jumps_while_lost(motion: F64, is_lost: B1) -> list[tuple[int, ...]]:
    """Steps of each run of lost scans whose odometry is far from the step before: a wheel may have slipped there.

    Where little is seen, a scan that does not fit because of a slip is taken to be where the odometry says, and those
    after it fit on it: path and odometry agree, and nothing but the lost scan tells.

    Parameters
    ----------
    motion : (n_scans, 3) float64
    is_lost : (n_scans,) bool
    """
    change = np.diff(motion, axis=0, prepend=motion[:1])
    far = np.linalg.norm(motion[:, :2], axis=1)
    jumps = np.linalg.norm(change[:, :2], axis=1) > _STEP_M + _SLIP_SHARE * far
    jumps |= np.abs(change[:, 2]) > _STEP_RAD
    found = [tuple((first + np.flatnonzero(jumps[first:last])).tolist()) for first, last in runs(is_lost)]
    return [steps for steps in found if steps]


def stops(motion: F64, times_s: F64) -> list[tuple[int, ...]]:
    """Steps of stretches in which the odometry stands still: the robot does, or the odometry is frozen."""
    return [_steps_of_freeze(first, last, times_s.size) for first, last in _long_stops(motion, times_s)]


def without_steps(motion: F64, unsure: Sequence[tuple[int, ...]]) -> F64:
    """The same steps, NaN (unknown) where the wheels are not to be believed."""
    trusted = np.array(motion)  # in its order in memory: another one would compile the kernel again
    for steps in unsure:
        trusted[list(steps)] = np.nan
    return trusted


def _long_stops(motion: F64, times_s: F64) -> list[tuple[int, int]]:
    """First and last row of each stretch in which the odometry stands still for long."""
    return [
        (first, last)
        for first, last in runs(_is_still(motion)[1:])
        if last - first >= _FROZEN_STEPS and times_s[last] - times_s[first] >= _FROZEN_S
    ]


def _is_still(motion: F64) -> B1:
    """(n,) whether the odometry says that nothing moved."""
    far = np.linalg.norm(motion[:, :2], axis=1)
    return np.asarray((far < _STILL_M) & (np.abs(motion[:, 2]) < _STILL_RAD))


def _steps_of_freeze(first: int, last: int, n_scans: int) -> tuple[int, ...]:
    """Steps from one sweep to another, and one on either side: partly still, or catching up with all of it."""
    return tuple(range(max(first, 1), min(last + 2, n_scans)))


def _dead_reckoned(motion: F64) -> F64:
    """(n, 3) poses that the steps lead to; unknown steps count as none."""
    steps = np.where(np.isfinite(motion), motion, 0.0)
    yaw = np.cumsum(steps[:, 2])
    before = np.concatenate([[0.0], yaw[:-1]])
    cos, sin = np.cos(before), np.sin(before)
    x = np.cumsum(cos * steps[:, 0] - sin * steps[:, 1])
    y = np.cumsum(sin * steps[:, 0] + cos * steps[:, 1])
    return np.column_stack([x, y, wrap_angle(yaw)])


def _frozen(
    motion: F64, times_s: F64, poses: F64, is_lost: B1
) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """Stretches in which the odometry says nothing moves and the path does, and where in them it does."""
    for first, last in runs(_is_still(motion)[1:]):
        rows = np.arange(first, last + 1)
        rows = rows[~is_lost[rows]]
        if last - first < _FROZEN_STEPS or rows.size < _FROZEN_STEPS:
            continue
        shift, turn = _away(poses[rows])
        if shift.max() < _MOVED_M and turn.max() < _MOVED_RAD:
            continue
        # Only the part in which the robot moved: it may have stood before and after.
        begin = rows[int(np.argmax((shift > _BEGUN_M) | (turn > _BEGUN_RAD)))] - 1
        shift, turn = _away(poses[rows[::-1]])
        end = rows[::-1][int(np.argmax((shift > _BEGUN_M) | (turn > _BEGUN_RAD)))] + 1
        begin, end = max(int(begin), first), min(int(end), last)
        if times_s[end] - times_s[begin] >= _FROZEN_S:
            yield (first, last), (begin, end)


def _away(poses: F64) -> tuple[F64, F64]:
    """Distance and turn of each pose from the first."""
    shift = np.linalg.norm(poses[:, :2] - poses[0, :2], axis=1)
    return shift, np.abs(np.unwrap(poses[:, 2]) - poses[0, 2])


def _slipped(
    motion: F64, times_s: F64, reckoned: F64, poses: F64, is_lost: B1, *, reversible: bool
) -> list[tuple[int, int]]:
    """Stretches in which distance or turn within a second differ by far more than wheels are unsure."""
    typical_s = float(np.median(np.diff(times_s)))
    width = int(np.clip(round(_WINDOW_S / max(typical_s, 1e-3)), 1, times_s.size - 1))
    by_wheels, by_scans = between(reckoned[:-width], reckoned[width:]), between(poses[:-width], poses[width:])
    if reversible:
        far_wheels, far_scans = _travelled(reckoned, width), _travelled(poses, width)
    else:
        far_wheels = np.linalg.norm(by_wheels[:, :2], axis=1)
        far_scans = np.linalg.norm(by_scans[:, :2], axis=1)
    wrong_turn = np.abs(wrap_angle(by_wheels[:, 2] - by_scans[:, 2]))
    differs = np.abs(far_wheels - far_scans) > _SLIP_M + _SLIP_SHARE * np.minimum(far_wheels, far_scans)
    differs |= wrong_turn > _SLIP_RAD + _SLIP_TURN_SHARE * np.abs(by_scans[:, 2])
    unknown = np.concatenate([[0], np.cumsum(is_lost | ~np.isfinite(motion).all(axis=1))])
    differs &= unknown[width + 1 :] == unknown[: -width - 1]
    spans = []
    for first, last in runs(differs):
        # A window differs as soon as a long slip enters it and until it leaves it; a short one is in all of them.
        entered, left = first + width - 1, last
        spans.append((entered, left) if entered < left else (last - 1, first + width))
    return spans


def _disagrees(motion: F64, poses: F64) -> B1:
    """(n,) whether a single step is another one by the scans; lengths only, as odometry may lack the sign."""
    by_scans = np.zeros_like(poses)
    by_scans[1:] = between(poses[:-1], poses[1:])
    far_wheels, far_scans = np.linalg.norm(motion[:, :2], axis=1), np.linalg.norm(by_scans[:, :2], axis=1)
    wrong_turn = np.abs(wrap_angle(motion[:, 2] - by_scans[:, 2]))
    return np.asarray(
        (np.abs(far_wheels - far_scans) > _STEP_M + _SLIP_SHARE * np.minimum(far_wheels, far_scans))
        | (wrong_turn > _STEP_RAD + _SLIP_TURN_SHARE * np.abs(by_scans[:, 2]))
    )


def _travelled(poses: F64, width: int) -> F64:
    """Length of the way within each window."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1))])
    return np.asarray(way[width:] - way[:-width])


def runs(flags: B1) -> list[tuple[int, int]]:
    """First and one past the last of each run of true flags."""
    edges = np.diff(np.concatenate([[0], flags.astype(np.int8), [0]]))
    return list(zip(np.nonzero(edges == 1)[0].tolist(), np.nonzero(edges == -1)[0].tolist(), strict=True))


def _overlap(one: tuple[int, int], other: tuple[int, int]) -> bool:
    return one[0] <= other[1] + _MARGIN and other[0] <= one[1] + _MARGIN


def _fault(
    steps: tuple[int, ...],
    seen: tuple[int, int],
    times_s: F64,
    reckoned: F64,
    poses: F64,
    *,
    is_frozen: bool,
) -> WheelFault:
    """Describe a stretch."""
    first, last = seen
    by_wheels, by_scans = between(reckoned[first], reckoned[last]), between(poses[first], poses[last])
    return WheelFault(
        is_frozen,
        steps,
        float(times_s[first]),
        float(times_s[last]),
        float(np.hypot(by_wheels[0], by_wheels[1])),
        float(by_wheels[2]),
        float(np.hypot(by_scans[0], by_scans[1])),
        float(by_scans[2]),
    )
