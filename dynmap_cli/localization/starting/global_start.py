"""Where on earth: an exhaustive lattice of poses under the first scans, and particles drawn from it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import islice

import numpy as np

from dynmap_cli.arrays import F64
from dynmap_cli.domain.poses import between, wrap_angle
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.errors import ArtifactError
from dynmap_cli.localization.particles.particle_filter import Particles, make_particles
from dynmap_cli.localization.sensing.map_pool import MapPool
from dynmap_cli.localization.sensing.sensor import pose_ends, scan_log_likelihoods, sweep_of, temper
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.localization.starting.drives import DRIVES, SEARCH_LOOKS, START_LOOKS, drive_from
from dynmap_cli.localization.starting.modes import (
    START_BEAMS,
    Candidates,
    Look,
    Mode,
    all_scores,
    find_modes,
    is_near,
    open_field,
    weigh_on,
)

LEAST_RETURNS = 10
CANDIDATES = 200_000
LOG_PRIOR_CARRIED = -10.0
"""Of a robot that is somewhere else altogether, against that it is where it was believed to be."""
DRIFT_M, DRIFT_RAD = 0.5, math.radians(10.0)
"""How far odometry alone takes a robot astray until it is searched for."""
STAYED_M, STAYED_RAD = 0.3, math.radians(8.0)
"""Within this of where the robot is believed to be its particles find the way on their own."""
LEAST_IN_A_PLACE = 100
"""Particles at least in each place."""
APART_M, APART_RAD = 0.5, math.radians(20.0)
"""Scans closer together than this say the same thing twice."""


def is_usable(log: ScanLog, scan: int, settings: LocalizationSettings) -> bool:
    """Whether a scan has enough returns to say where it was made."""
    return sweep_of(log, scan, settings.laser_max_range).n_returns >= LEAST_RETURNS


def possible_starts(
    log: ScanLog, scan: int, pool: MapPool, settings: LocalizationSettings, executor: ThreadPoolExecutor
) -> list[Mode]:
    """All places at the pose of a scan from which this scan and the next ones can be explained, likeliest first.

    The lattice sees the union of all states. Later scans are put in by odometry.
    """
    looks = list(islice(_looks(log, scan, settings), settings.start_scans))
    modes = _modes_anywhere(log, scan, looks, pool, settings, executor)
    return drive_from(modes, _looks(log, scan, settings), START_LOOKS, pool, settings)


def global_start(
    log: ScanLog,
    scan: int,
    pool: MapPool,
    settings: LocalizationSettings,
    random: np.random.Generator,
    executor: ThreadPoolExecutor,
) -> Particles:
    """Particles at the pose of a scan, in all places that are possible."""
    return draw_start(possible_starts(log, scan, pool, settings, executor), settings, random)


def search_again(
    log: ScanLog,
    scan: int,
    here: F64,
    pool: MapPool,
    settings: LocalizationSettings,
    random: np.random.Generator,
    executor: ThreadPoolExecutor,
    *,
    is_given: bool,
) -> Particles | None:
    """Look for a lost robot around the pose (3,) where it is believed to be, and in the whole map.

    It may have drifted from there, which is likely, or have been carried anywhere, which is not: that is believed only
    where no place around is possible any more. Both are weighed by the drive from each place, so that what lies where
    the map knows nothing speaks against none of them.

    Parameters
    ----------
    is_given : bool
        Whether somebody said that it is here: then it stays as long as that is possible, however well others fit, and
        otherwise it is looked for as if nobody had.

    Returns
    -------
    Particles or None
        None where the drive from here explains the scans best: then the world has changed, or the robot is where the
        map knows little, and stays where it is believed to be.
    """
    looks = list(islice(_looks(log, scan, settings), settings.start_scans))
    field = open_field(pool)
    near = [
        *find_modes(Candidates(here[None, :], np.zeros(1)), looks, pool, field, settings),
        *_modes_around(here, looks, pool, settings)[: DRIVES // 2],
    ]
    anywhere = _modes_anywhere(log, scan, looks, pool, settings, executor)
    far = [
        mode
        for mode in anywhere
        if not any(bool(is_near(mode.pose[None, :], other.pose)[0]) for other in near)
    ]
    modes = [replace(mode, log_prior=_log_prior(mode.pose, here)) for mode in [*near, *far]]
    modes = drive_from(modes, _looks(log, scan, settings), SEARCH_LOOKS, pool, settings)
    modes = [mode for mode in modes if mode.log_prior > LOG_PRIOR_CARRIED] or modes
    if any(_has_stayed(mode.pose, here) for mode in (modes if is_given else modes[:1])):
        return None
    if is_given:
        modes = drive_from(anywhere, _looks(log, scan, settings), START_LOOKS, pool, settings)
    return draw_start(modes, settings, random)


def _has_stayed(pose: F64, here: F64) -> bool:
    """Whether a place is so near that particles find the way on their own."""
    away = pose - here
    return math.hypot(away[0], away[1]) <= STAYED_M and abs(float(wrap_angle(away[2]))) <= STAYED_RAD


def lattice_candidates(
    log: ScanLog, scan: int, pool: MapPool, settings: LocalizationSettings, executor: ThreadPoolExecutor
) -> Candidates:
    """Weigh every pose of the lattice under one scan and keep the best."""
    ends = pose_ends(sweep_of(log, scan, settings.laser_max_range), START_BEAMS)
    exponent = temper(ends.shape[0], settings)
    points = lattice_points(pool, settings.start_pitch_m)
    n_yaws = max(round(360.0 / settings.start_pitch_deg), 1)
    yaws = wrap_angle(2.0 * np.pi / n_yaws * np.arange(n_yaws, dtype=np.float64))

    def weigh(yaw: float) -> F64:
        poses = np.column_stack([points, np.full(points.shape[0], yaw)])
        return exponent * scan_log_likelihoods(pool.start_field, pool.frame, poses, ends)

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
    modes: Sequence[Mode], settings: LocalizationSettings, random: np.random.Generator
) -> Particles:
    """Draw `max_particles` from all places that are possible, each place with enough of them.

    What the scans leave undecided is decided by the filter on the way.
    """
    modes = sorted(modes, key=lambda mode: -mode.log_weight)[: settings.max_particles]
    shares = shares_of(modes)
    enough = np.maximum(shares, LEAST_IN_A_PLACE / settings.max_particles)
    counts = np.maximum((settings.max_particles * enough / enough.sum()).astype(np.int64), 1)
    counts[0] += settings.max_particles - int(counts.sum())
    poses = np.concatenate(
        [_drawn(mode, int(count), settings, random) for mode, count in zip(modes, counts, strict=True)]
    )
    return replace(make_particles(poses), weights=np.repeat(shares / counts, counts))


def shares_of(modes: Sequence[Mode]) -> F64:
    """(n,) probabilities of places, given that the robot is in one of them."""
    logs = np.array([mode.log_weight for mode in modes])
    shares = np.exp(logs - logs.max())
    return np.asarray(shares / shares.sum())


def _drawn(mode: Mode, count: int, settings: LocalizationSettings, random: np.random.Generator) -> F64:
    """Poses (count, 3) of one place by likelihood, each somewhere in its cell of the lattice."""
    sums = np.cumsum(np.exp(mode.scores - mode.scores.max()))
    teeth = (np.arange(count) + random.random()) / count * sums[-1]
    drawn = np.minimum(np.searchsorted(sums, teeth, side="right"), sums.size - 1)
    size = np.array([settings.start_pitch_m, settings.start_pitch_m, math.radians(settings.start_pitch_deg)])
    poses: F64 = mode.poses[drawn] + (random.random((count, 3)) - 0.5) * size
    poses[:, 2] = wrap_angle(poses[:, 2])
    return poses


def given_start(pose: F64, settings: LocalizationSettings, random: np.random.Generator) -> Particles:
    """Particles around a pose that somebody gave."""
    sigma = np.array([settings.start_sigma_m, settings.start_sigma_m, settings.start_sigma_rad])
    poses = pose + sigma * random.standard_normal((settings.max_particles, 3))
    poses[:, 2] = wrap_angle(poses[:, 2])
    return make_particles(poses)


def _modes_anywhere(
    log: ScanLog,
    scan: int,
    looks: Sequence[Look],
    pool: MapPool,
    settings: LocalizationSettings,
    executor: ThreadPoolExecutor,
) -> list[Mode]:
    """The best places in the whole map."""
    candidates, field = lattice_candidates(log, scan, pool, settings, executor), pool.start_field
    return find_modes(weigh_on(candidates, looks[1:], pool, field, settings), looks, pool, field, settings)


def _log_prior(pose: F64, here: F64) -> float:
    """Of a robot that was believed to be *here* and has drifted, or has been carried away."""
    away = pose - here
    drifts = np.array([*(away[:2] / DRIFT_M), float(wrap_angle(away[2])) / DRIFT_RAD])
    return max(-0.5 * float(drifts @ drifts), LOG_PRIOR_CARRIED)


def _modes_around(
    here: F64, looks: Sequence[Look], pool: MapPool, settings: LocalizationSettings
) -> list[Mode]:
    """All places within three sigma of drift."""
    reach = max(round(3.0 * DRIFT_M / settings.start_pitch_m), 1)
    turns = max(round(3.0 * DRIFT_RAD / math.radians(settings.start_pitch_deg)), 1)
    metres = settings.start_pitch_m * np.arange(-reach, reach + 1)
    yaws = math.radians(settings.start_pitch_deg) * np.arange(-turns, turns + 1)
    poses = here + np.stack(np.meshgrid(metres, metres, yaws, indexing="ij"), axis=-1).reshape(-1, 3)
    field = open_field(pool)
    found = Candidates(poses, all_scores(looks, poses, pool, field, settings))
    return find_modes(found, looks, pool, field, settings, math.inf)


def _looks(log: ScanLog, scan: int, settings: LocalizationSettings) -> Iterator[Look]:
    """A scan and the next ones, seen from the pose of the first."""
    yield Look(sweep_of(log, scan, settings.laser_max_range), np.zeros(3))
    for later in _later_scans(log, scan, settings):
        step = between(log.odometry[scan], log.odometry[later])
        yield Look(sweep_of(log, later, settings.laser_max_range), step)


def _later_scans(log: ScanLog, scan: int, settings: LocalizationSettings) -> Iterator[int]:
    """Usable scans of the same recording, apart from each other, that odometry links to a scan."""
    linked = log.has_odometry & (log.recording_index == log.recording_index[scan])
    if not linked[scan]:
        return
    previous = scan
    for later in range(scan + 1, log.n_scans):
        if not linked[later]:
            continue
        step = between(log.odometry[previous], log.odometry[later])
        is_apart = math.hypot(step[0], step[1]) >= APART_M or abs(step[2]) >= APART_RAD
        if is_apart and is_usable(log, later, settings):
            previous = later
            yield later
