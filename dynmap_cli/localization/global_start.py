"""Where on earth: an exhaustive lattice of poses under the first scans, and particles drawn from it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import F64
from dynmap_cli.domain.poses import between, compose, wrap_angle
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.errors import ArtifactError
from dynmap_cli.localization.health import Novelties, lost_measure, scan_health
from dynmap_cli.localization.map_pool import MapPool
from dynmap_cli.localization.modes import Look, judge_modes, judged_look, look_scores, refined_pose
from dynmap_cli.localization.particle_filter import Particles, make_particles
from dynmap_cli.localization.sensor import sweep_of
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.localization.states import place_sweep

LEAST_RETURNS = 10
CANDIDATES = 200_000
CLEARLY_BETTER = 30.0
"""Tempered log-likelihood by which another place must beat the current one: in offices whose map was out of date or
full of people it beat a right pose by up to 21, and a wrong one by 36 and more.
In places that look alike, new things make it more: see `_contradiction`."""
APART_M, APART_RAD = 0.5, math.radians(20.0)
"""Scans closer together than this say the same thing twice."""


@dataclass(frozen=True, slots=True)
class Candidates:
    """Poses of the lattice that the first scan leaves possible.

    Attributes
    ----------
    poses : (n, 3) float64
        map_from_robot at the first scan.
    scores : (n,) float64
        Tempered log-likelihood.
    """

    poses: F64
    scores: F64


@dataclass(frozen=True, slots=True)
class Elsewhere:
    """A place that explains the scans clearly better than where a robot was believed to be.

    Attributes
    ----------
    particles : Particles
        Drawn there.
    times_clearly : float
        By how many times `CLEARLY_BETTER` it is better.
    """

    particles: Particles
    times_clearly: float


def is_usable(log: ScanLog, scan: int, settings: LocalizationSettings) -> bool:
    """Whether a scan has enough returns to say where it was made."""
    return sweep_of(log, scan, settings.laser_max_range).n_returns >= LEAST_RETURNS


def global_start(
    log: ScanLog,
    scan: int,
    pool: MapPool,
    settings: LocalizationSettings,
    random: np.random.Generator,
    executor: ThreadPoolExecutor,
) -> Particles:
    """Particles at the pose of a scan, drawn from a lattice over all free cells and all yaws.

    The lattice sees the union of all states. Later scans are put in by odometry.
    """
    candidates = lattice_candidates(log, scan, pool, settings, executor)
    looks = [_look(log, scan, scan, settings)]
    for later in _later_scans(log, scan, settings):
        looks.append(_look(log, scan, later, settings))
        candidates = _with_look(candidates, looks[-1], pool, settings)
    return draw_start(_judged(candidates, looks, pool, settings), settings, random)


def search_again(
    log: ScanLog,
    scan: int,
    current: F64,
    pool: MapPool,
    settings: LocalizationSettings,
    random: np.random.Generator,
    executor: ThreadPoolExecutor,
) -> Elsewhere | None:
    """Look for a lost robot in the whole map, under this scan and the next ones.

    Returns
    -------
    Elsewhere or None
        None where nothing explains the scans clearly better than the *current* poses (n, 3), all beams and
        those alone that the map can judge from there: then the world has changed, or the robot is where the
        map knows little, and stays where it is believed to be.
    """
    candidates = lattice_candidates(log, scan, pool, settings, executor)
    looks = [_look(log, scan, scan, settings)]
    rivals = Candidates(current, look_scores(looks[0], current, pool, settings))
    for later in _later_scans(log, scan, settings):
        looks.append(_look(log, scan, later, settings))
        candidates = _with_look(candidates, looks[-1], pool, settings)
        rivals = _with_look(rivals, looks[-1], pool, settings)
    candidates = _judged(candidates, looks, pool, settings)
    here = rivals.poses[int(np.argmax(rivals.scores))]
    judged = [judged_look(look, here, pool) for look in looks]
    better_by = math.inf
    for ways in (looks, judged):
        best, known = (_best_score(poses, ways, pool, settings) for poses in (candidates.poses, rivals.poses))
        better_by = min(better_by, best - known)
        if better_by <= CLEARLY_BETTER:
            return None
    there = candidates.poses[int(np.argmax(candidates.scores))]
    if _contradiction(there, looks, pool, settings) >= _contradiction(here, looks, pool, settings):
        return None
    return Elsewhere(draw_start(candidates, settings, random), better_by / CLEARLY_BETTER)


def lattice_candidates(
    log: ScanLog, scan: int, pool: MapPool, settings: LocalizationSettings, executor: ThreadPoolExecutor
) -> Candidates:
    """Weigh every pose of the lattice under one scan and keep the best."""
    look = _look(log, scan, scan, settings)
    points = lattice_points(pool, settings.start_pitch_m)
    n_yaws = max(round(360.0 / settings.start_pitch_deg), 1)
    yaws = wrap_angle(2.0 * np.pi / n_yaws * np.arange(n_yaws, dtype=np.float64))

    def weigh(yaw: float) -> F64:
        poses = np.column_stack([points, np.full(points.shape[0], yaw)])
        return look_scores(look, poses, pool, settings)

    scores = np.stack(list(executor.map(weigh, yaws.tolist())))
    flat = scores.ravel()
    kept = np.arange(flat.size)
    if flat.size > CANDIDATES:
        kept = np.sort(np.argpartition(flat, flat.size - CANDIDATES)[-CANDIDATES:])
    yaw_index, point_index = np.divmod(kept, points.shape[0])
    return Candidates(np.column_stack([points[point_index], yaws[yaw_index]]), flat[kept])


def lattice_points(pool: MapPool, pitch_m: float) -> F64:
    """(n, 2) free points of a square lattice over the map.

    Raises
    ------
    ArtifactError
        If the map has no free cell.
    """
    frame = pool.frame
    cells = max(round(pitch_m / frame.resolution_m), 1)
    free = pool.free[cells // 2 :: cells, cells // 2 :: cells]
    if not bool(free.any()):
        if bool(pool.free.any()):
            return frame.to_points(np.argwhere(pool.free))
        msg = "the map has no free cell, so there is nowhere to look for the robot. Check its thresholds."
        raise ArtifactError(msg)
    return frame.to_points(np.argwhere(free) * cells + cells // 2)


def draw_start(
    candidates: Candidates, settings: LocalizationSettings, random: np.random.Generator
) -> Particles:
    """Draw `max_particles` from the lattice by likelihood, each somewhere in its cell of the lattice."""
    weights = np.exp(candidates.scores - candidates.scores.max())
    sums = np.cumsum(weights)
    count = settings.max_particles
    teeth = (np.arange(count) + random.random()) / count * sums[-1]
    drawn = np.minimum(np.searchsorted(sums, teeth, side="right"), weights.size - 1)
    size = np.array([settings.start_pitch_m, settings.start_pitch_m, math.radians(settings.start_pitch_deg)])
    poses = candidates.poses[drawn] + (random.random((count, 3)) - 0.5) * size
    poses[:, 2] = wrap_angle(poses[:, 2])
    return make_particles(poses)


def given_start(pose: F64, settings: LocalizationSettings, random: np.random.Generator) -> Particles:
    """Particles around a pose that somebody gave."""
    sigma = np.array([settings.start_sigma_m, settings.start_sigma_m, settings.start_sigma_rad])
    poses = pose + sigma * random.standard_normal((settings.max_particles, 3))
    poses[:, 2] = wrap_angle(poses[:, 2])
    return make_particles(poses)


def _look(log: ScanLog, scan: int, later: int, settings: LocalizationSettings) -> Look:
    """A later scan, seen from the pose of the first."""
    step = np.zeros(3) if later == scan else between(log.odometry[scan], log.odometry[later])
    return Look(sweep_of(log, later, settings.laser_max_range), step)


def _with_look(
    candidates: Candidates, look: Look, pool: MapPool, settings: LocalizationSettings
) -> Candidates:
    """Weigh candidates by one more scan."""
    scores = look_scores(look, candidates.poses, pool, settings)
    return Candidates(candidates.poses, candidates.scores + scores)


def _judged(
    candidates: Candidates, looks: list[Look], pool: MapPool, settings: LocalizationSettings
) -> Candidates:
    """The candidates in the best places, less what the walls cost that their beams would go through."""
    kept, scores = judge_modes(candidates.poses, candidates.scores, looks, pool, settings)
    return Candidates(candidates.poses[kept], scores)


def _best_score(poses: F64, looks: list[Look], pool: MapPool, settings: LocalizationSettings) -> float:
    """Of the best place among poses (n, 3), less what the walls cost."""
    total = sum((look_scores(look, poses, pool, settings) for look in looks), np.zeros(len(poses)))
    return float(judge_modes(poses, total, looks, pool, settings)[1].max())


def _contradiction(pose: F64, looks: list[Look], pool: MapPool, settings: LocalizationSettings) -> float:
    """How much the scans speak for a wrong pose, on average, at the best pose around one.

    A new thing in view of many scans makes a likelihood field prefer a place that looks alike but has it not, though
    beams go through walls there; the lost measure knows that things shorten beams.
    """
    pose, _ = refined_pose(pose, looks, pool, settings)
    states = dict.fromkeys(range(len(pool.submaps)), 0)
    placed = [place_sweep(look.sweep, compose(pose, look.step)) for look in looks]
    return sum(lost_measure(scan_health(one, pool, states, Novelties(pool), 0.0)) for one in placed) / len(
        looks
    )


def _later_scans(log: ScanLog, scan: int, settings: LocalizationSettings) -> Iterator[int]:
    """Usable scans of the same recording, apart from each other, that odometry links to a scan."""
    linked = log.has_odometry & (log.recording_index == log.recording_index[scan])
    if not linked[scan]:
        return
    previous, found = scan, 1
    for later in range(scan + 1, log.n_scans):
        if found >= settings.start_scans:
            return
        if not linked[later]:
            continue
        step = between(log.odometry[previous], log.odometry[later])
        is_apart = math.hypot(step[0], step[1]) >= APART_M or abs(step[2]) >= APART_RAD
        if is_apart and is_usable(log, later, settings):
            previous, found = later, found + 1
            yield later
