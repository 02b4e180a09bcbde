"""How well an odometry lays sweeps on one another: what speaks for it where sweeps alone seem to turn otherwise.

Sweeps may be most alike under a turn that the laser did not make: on the way around a round hall each looks like the
one before, and people who go with the robot turn with it. There the motion of a good odometry still lays the later
sweep on the earlier one, or at least the walls between the people, which turns of other moments do not.
"""

from __future__ import annotations

import numpy as np

from dynmap_cli.arrays import B1, F64, I64
from dynmap_cli.domain.poses import between, compose, wrap_angle
from dynmap_cli.ingest.seen_motion.agreement import chance_of
from dynmap_cli.ingest.seen_motion.pairs import SweepPairs, rows_at
from dynmap_cli.ingest.seen_motion.turns import TURNING_RAD, ScanTurns

_CAP_M = 0.2
"""Lasers are surer than that: what is farther off is something else, as people who went on."""
_ELSEWHERE_RAD = np.radians([-60.0, -45.0, -30.0, -15.0, 15.0, 30.0, 45.0, 60.0])
_AS_GOOD = 0.5
_OTHER_MOMENTS = 16
_CHANCE = 1e-3
_NEARER_M = 0.05
"""More than the noise of most lasers and the distance of neighbouring beams, less than what a robot drives."""


def speak_for(turns: ScanTurns, stamps_ns: I64, poses: F64) -> bool:
    """Whether the pairs of sweeps speak for an odometry, poses (n, 3) at the stamps (n,), ascending, of all sweeps.

    They do where its motions leave less than half of what a turn at random leaves, above that which the turns of the
    sweeps leave; or where its turns lay them better than those of other pairs do, more often than by chance.
    """
    laser_poses = [
        compose(poses[rows_at(stamps_ns, at_ns)], turns.robot_from_sensor)
        for at_ns in (turns.first_ns, turns.second_ns)
    ]
    motions = between(*laser_poses)
    is_turning = np.isfinite(motions).all(axis=1) & (
        (np.abs(motions[:, 2]) > TURNING_RAD) | (np.abs(turns.turns_rad) > TURNING_RAD)
    )
    rows = np.flatnonzero(is_turning)
    if not rows.size:
        return False
    motions = motions[rows]
    own_m = _left_m(turns.pairs, rows, motions)
    return _lay_as_well(turns, rows, motions, own_m) or _lay_better_than_others(turns, rows, motions, own_m)


def _lay_as_well(turns: ScanTurns, rows: I64, motions: F64, own_m: F64) -> bool:
    """Whether motions (n, 3) lay pairs about as well as the turns that the sweeps tell, against turns at random."""
    told = turns.turns_rad[rows]
    seen_m = np.fmin(
        _left_m(turns.pairs, rows, _turned(motions, told)),
        _left_m(turns.pairs, rows, _turned(0.0 * motions, told)),
    )
    elsewhere_m = [
        _left_m(turns.pairs, rows, _turned(0.0 * motions, told + off_rad)) for off_rad in _ELSEWHERE_RAD
    ]
    # Where a turn leaves no beam that both sweeps have, nothing fits.
    random_m = np.median(np.nan_to_num(elsewhere_m, nan=_CAP_M), axis=0)
    is_known = np.isfinite(own_m) & (random_m > seen_m)
    if not is_known.any():
        return True
    share = (own_m[is_known] - seen_m[is_known]) / (random_m[is_known] - seen_m[is_known])
    return float(np.median(share)) < _AS_GOOD


def _lay_better_than_others(turns: ScanTurns, rows: I64, motions: F64, own_m: F64) -> bool:
    """Whether the turns of motions (n, 3) lay their own pairs better than turns of other pairs do: a sign test."""
    others_m = np.full((_OTHER_MOMENTS, rows.size), np.nan)
    for number, ahead in enumerate(np.linspace(1, rows.size - 1, _OTHER_MOMENTS).astype(np.int64)):
        others = np.roll(motions[:, 2], ahead)
        is_other: B1 = np.abs(wrap_angle(others - motions[:, 2])) > TURNING_RAD
        left_m = _left_m(turns.pairs, rows, _turned(motions, others))
        others_m[number, is_other] = left_m[is_other]
    is_known = np.isfinite(own_m) & np.isfinite(others_m).any(axis=0)
    if not is_known.any():
        return False
    is_better = own_m[is_known] < np.nanmedian(others_m[:, is_known], axis=0)
    return chance_of(int(np.count_nonzero(is_better)), is_better.size) < _CHANCE


def share_nearer(pairs: SweepPairs, motions: F64, others: F64) -> float:
    """Share of the beams that motions (n, 3) of the laser lay nearer than others do, less that of which it is not so.

    It does not matter by how much: people who walk along are few beams far off, and along a bare corridor nothing but
    them tells one motion from another.
    """
    rows = np.arange(pairs.before_m.shape[0])
    gain_m = _apart_m(pairs, rows, others) - _apart_m(pairs, rows, motions)
    gain_m = gain_m[np.isfinite(gain_m)]
    if not gain_m.size:
        return 0.0
    return float(np.mean(gain_m > _NEARER_M) - np.mean(gain_m < -_NEARER_M))


def _turned(motions: F64, turns_rad: F64) -> F64:
    """Motions (n, 3) with other turns (n,)."""
    return np.column_stack([motions[:, :2], turns_rad])


def _left_m(pairs: SweepPairs, rows: I64, motions: F64) -> F64:
    """Mean of `_apart_m` over the beams (n,), NaN where there are none."""
    left_m = _apart_m(pairs, rows, motions)
    n_both = np.count_nonzero(np.isfinite(left_m), axis=0)
    return np.where(n_both > 0, np.nansum(left_m, axis=0) / np.maximum(n_both, 1), np.nan)


def _apart_m(pairs: SweepPairs, rows: I64, motions: F64) -> F64:
    """Difference (n_beams, n), capped, between the first sweep of a pair and the second laid on it by a motion (n, 3).

    Each return of the second is compared with the range of the first along the beam that is nearest to its direction;
    NaN where there is none.
    """
    step_rad = float(pairs.bearings_rad[1] - pairs.bearings_rad[0])
    ranges_m = pairs.after_m[rows].T
    angles = pairs.bearings_rad[:, None] + motions[:, 2]
    x = motions[:, 0] + ranges_m * np.cos(angles)
    y = motions[:, 1] + ranges_m * np.sin(angles)
    off_rad = (np.arctan2(y, x) - pairs.bearings_rad[0]) * np.sign(step_rad) + 0.5 * abs(step_rad)
    beams = np.floor(np.mod(off_rad, 2.0 * np.pi) / abs(step_rad))
    beams = np.nan_to_num(beams, nan=np.inf)
    is_seen = beams < pairs.bearings_rad.size
    seen_m = pairs.before_m[rows, np.where(is_seen, beams, 0).astype(np.int64)]
    left_m = np.minimum(np.abs(np.hypot(x, y) - seen_m), _CAP_M)
    left_m[~is_seen] = np.nan
    return left_m
