"""What the drive from a place says of it: scan by scan at the best pose near the last, until one place is left."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynmap_cli.arrays import F64, I64
from dynmap_cli.domain.poses import between, compose
from dynmap_cli.localization.beliefs.states import place_sweep
from dynmap_cli.localization.sensing.map_pool import MapPool
from dynmap_cli.localization.sensing.sensor import Sweep, evenly, scan_log_likelihoods, temper
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.localization.starting.modes import (
    LOG_LIKELIHOOD_OFF_MAP,
    START_BEAMS,
    Look,
    Mode,
    finer_lattices,
)
from dynmap_cli.localization.watching.health import count_places_through, ends_off_map

DRIVES = 30
"""Places that are driven from."""
START_LOOKS, SEARCH_LOOKS = 200, 24
"""Scans after which several places stay possible. A search can be made again, and where the map knows little a drive
drifts."""
LEAST_SHARE = 1e-3
"""Places that weigh less against the best are out of the question."""
FOUND_M, FOUND_RAD = 0.1, math.radians(2.0)
"""How exactly the blunt field finds a place."""
SLIP_M, SLIP_RAD, SLIP, SLIP_RAD_PER_M = 0.02, math.radians(1.0), 0.1, math.radians(3.0)
"""How far odometry may be off from look to look: at least, as a share of way and turn, and in yaw per metre. Without
it a drive along bare walls slides to where a wrong place fits."""
SAME_M, SAME_RAD = 0.3, math.radians(5.0)
"""Drives that come closer together than this have found each other."""
LOG_LIKELIHOOD_PER_PLACE = -1.0
"""Of a scan that goes through walls in one more place: a likelihood field does not see it, and it happens where a
door was opened, but not in many places."""


@dataclass(frozen=True, slots=True)
class _Drive:
    """A robot that started at one place.

    Attributes
    ----------
    mode : Mode
        The place; its score is that of the looks so far.
    pose : (3,) float64
        Where the robot has come to.
    step : (3,) float64
        Of the last look, from the pose of the first.
    """

    mode: Mode
    pose: F64
    step: F64


def drive_from(
    modes: Sequence[Mode],
    looks: Iterable[Look],
    most_looks: int,
    pool: MapPool,
    settings: LocalizationSettings,
) -> list[Mode]:
    """Weigh places by the drives from them, over `start_scans` looks or until only one is possible.

    The lattice of a start is coarse, and odometry drifts from look to look, so the blunt field tells only roughly how
    well a place fits: two ends of a building that look alike may differ less than the lattice happens to lie.

    Parameters
    ----------
    modes : sequence of Mode
        Best first.
    looks : iterable of Look
        As far as they are needed.
    most_looks : int
        After which several places stay possible.

    Returns
    -------
    list of Mode
        Those that are left, best first, with the tempered log-likelihood of the drive.
    """
    drives = [_Drive(replace(mode, score=0.0, n_looks=0), mode.pose, np.zeros(3)) for mode in modes[:DRIVES]]
    for number, look in enumerate(looks):
        if number >= settings.start_scans:
            drives = _possible(drives)
            if len(drives) == 1 or number >= most_looks:
                break
        drives = [_driven(drive, look, pool, settings) for drive in drives]
    return [drive.mode for drive in _possible(drives)]


def _possible(drives: Sequence[_Drive]) -> list[_Drive]:
    """Those that weigh enough, best first; of some that have come to the same place, the best."""
    best_first = sorted(drives, key=lambda drive: -drive.mode.log_weight)
    least = best_first[0].mode.log_weight + math.log(LEAST_SHARE)
    kept: list[_Drive] = []
    for drive in best_first:
        if drive.mode.log_weight >= least and not any(_is_same(drive.pose, one.pose) for one in kept):
            kept.append(drive)
    return kept


def _is_same(pose: F64, other: F64) -> bool:
    """Whether two poses (3,) are one."""
    away = between(pose, other)
    return math.hypot(away[0], away[1]) <= SAME_M and abs(float(away[2])) <= SAME_RAD


def _driven(drive: _Drive, look: Look, pool: MapPool, settings: LocalizationSettings) -> _Drive:
    """Go on to the next look: to the best pose near that which odometry predicts, in the sharp field.

    The field shows the mixture of all states. Ends where the map knows nothing speak neither for nor against a place,
    walls that beams go through speak against it.
    """
    step = between(drive.step, look.step)
    predicted = compose(drive.pose, step)
    hits = np.flatnonzero(np.isfinite(look.sweep.ranges_m))
    if hits.size > START_BEAMS:
        hits = hits[evenly(hits.size, START_BEAMS)]
    beams, exponent = _beams_of(look.sweep, hits), temper(hits.size, settings)
    judged = ~ends_off_map(place_sweep(beams, predicted), pool)
    ends, sigmas = beams.ends_m(np.flatnonzero(judged)), _sigmas(step, is_first=drive.mode.n_looks == 0)
    pose, score = predicted, 0.0
    for steps in finer_lattices(settings):
        poses = pose + steps
        slips = ((poses - predicted) / sigmas) ** 2
        scores = exponent * scan_log_likelihoods(pool.pool, pool.frame, poses, ends) - 0.5 * slips.sum(axis=1)
        best = int(np.argmax(scores))
        pose, score = poses[best], float(scores[best])
    score += exponent * LOG_LIKELIHOOD_OFF_MAP * int((~judged).sum())
    score += LOG_LIKELIHOOD_PER_PLACE * count_places_through(place_sweep(look.sweep, pose), pool)
    mode = replace(drive.mode, score=drive.mode.score + score, n_looks=drive.mode.n_looks + 1)
    return _Drive(mode, pose, look.step)


def _sigmas(step: F64, *, is_first: bool) -> F64:
    """How far odometry may be off after a step, x and y in metres and yaw in radians; before the first, the lattice."""
    if is_first:
        return np.array([FOUND_M, FOUND_M, FOUND_RAD])
    way = float(np.hypot(step[0], step[1]))
    slip_m, slip_rad = SLIP_M + SLIP * way, SLIP_RAD + SLIP * abs(float(step[2])) + SLIP_RAD_PER_M * way
    return np.array([slip_m, slip_m, slip_rad])


def _beams_of(sweep: Sweep, beams: I64) -> Sweep:
    """Some beams of a scan."""
    return replace(sweep, directions_rad=sweep.directions_rad[beams], ranges_m=sweep.ranges_m[beams])
