"""The places among many candidate poses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import B1, F32, F64
from dynmap_cli.domain.poses import compose, wrap_angle
from dynmap_cli.localization.sensing.map_pool import MapPool
from dynmap_cli.localization.sensing.sensor import Sweep, pose_ends, scan_log_likelihoods, temper
from dynmap_cli.localization.settings import LocalizationSettings

START_BEAMS = 60
MODES = 100
"""Places that are told apart."""
APART_M, APART_RAD = 0.75, math.radians(20.0)
"""Candidates closer than this belong to one place."""
LOG_LIKELIHOOD_OFF_MAP = -1.5
"""Of an end where the map knows nothing: as that of ends in real scans from right poses is on average."""
SCANS_OF_A_DRIVE = 3.0
"""As how many scans all those of a drive count when places are weighed: where the map is not as the world, or not
exact, a wrong place may fit a little better all along."""
LEAST_BELOW = 30.0
"""Of log-likelihoods: by so much the lattice and the drift of the odometry may spoil the best place."""
_WEIGHED_FIRST = 1000
"""Candidates that are weighed by all scans before the others are."""
_ROUNDING = 1e-6
"""Of sums of log-likelihoods."""
_STEPS = np.arange(-2, 3)
_AROUND = np.stack(np.meshgrid(_STEPS, _STEPS, _STEPS, indexing="ij"), axis=-1).reshape(-1, 3)


@dataclass(frozen=True, slots=True)
class Candidates:
    """Poses of a lattice that scans leave possible.

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
class Look:
    """One of the scans that candidates are weighed by.

    Attributes
    ----------
    sweep : Sweep
    step : (3,) float64
        From the pose that the candidates stand for to that of this scan.
    """

    sweep: Sweep
    step: F64


@dataclass(frozen=True, slots=True)
class Mode:
    """One place where the robot may be.

    Attributes
    ----------
    pose : (3,) float64
        The best one there, at the first scan.
    poses : (n, 3) float64
        Candidates around it; the lattice may lie anywhere, so they are shifted so that the best one is *pose*.
    scores : (n,) float64
        Theirs.
    score : float
        Log-likelihood of the looks from there.
    n_looks : int
        How many.
    log_prior : float
        What was believed of the place before.
    """

    pose: F64
    poses: F64
    scores: F64
    score: float
    n_looks: int
    log_prior: float = 0.0

    @property
    def log_weight(self) -> float:
        """Logarithm of the weight of the place; scans of one drive err together, so they are worth a few."""
        return min(SCANS_OF_A_DRIVE / max(self.n_looks, 1), 1.0) * self.score + self.log_prior


def look_scores(look: Look, poses: F64, pool: MapPool, field: F32, settings: LocalizationSettings) -> F64:
    """Tempered log-likelihood of a scan from each pose (n, 3), in a field (rows * cols,)."""
    ends = pose_ends(look.sweep, START_BEAMS)
    moved = compose(poses, look.step)
    return temper(ends.shape[0], settings) * scan_log_likelihoods(field, pool.frame, moved, ends)


def all_scores(
    looks: Sequence[Look], poses: F64, pool: MapPool, field: F32, settings: LocalizationSettings
) -> F64:
    """Tempered log-likelihood (n,) of all scans together."""
    return sum((look_scores(look, poses, pool, field, settings) for look in looks), np.zeros(len(poses)))


def weigh_on(
    candidates: Candidates, looks: Sequence[Look], pool: MapPool, field: F32, settings: LocalizationSettings
) -> Candidates:
    """Add what more scans say; candidates that will end `LEAST_BELOW` below the best are left out on the way.

    A scan says no more than if all its ends lay on the map, and the best ends no lower than those that are good from
    the start (bounds as in branch and bound): most candidates are out of the question after a few scans.
    """
    poses, before = candidates.poses, candidates.scores
    first = np.argpartition(-before, min(_WEIGHED_FIRST, before.size) - 1)[:_WEIGHED_FIRST]
    reached = float((before[first] + all_scores(looks, poses[first], pool, field, settings)).max())
    highest = np.array([_highest_score(look, float(field.max()), settings) for look in looks])
    added = np.zeros(before.size)
    for number, look in enumerate(looks):
        added += look_scores(look, poses, pool, field, settings)
        can_reach = before + added + highest[number + 1 :].sum()
        possible = can_reach > reached - LEAST_BELOW - _ROUNDING
        poses, before, added = poses[possible], before[possible], added[possible]
    return Candidates(poses, before + added)


def _highest_score(look: Look, best_end: float, settings: LocalizationSettings) -> float:
    """What a scan says of a pose from which every end is as likely as it can be."""
    n_ends = min(look.sweep.n_returns, START_BEAMS)
    return temper(n_ends, settings) * n_ends * best_end


def open_field(pool: MapPool) -> F32:
    """The blunt field of all states (rows * cols,), where ends in the unknown speak neither for nor against a pose."""
    unknown = np.maximum(pool.start_field, np.float32(LOG_LIKELIHOOD_OFF_MAP))
    return np.where(pool.free.ravel(), pool.start_field, unknown)


def find_modes(
    candidates: Candidates,
    looks: Sequence[Look],
    pool: MapPool,
    field: F32,
    settings: LocalizationSettings,
    least_below: float = LEAST_BELOW,
) -> list[Mode]:
    """The best places among candidates, best first, with the log-likelihood of the looks at the best pose of each.

    Candidates that are *least_below* or more below the best are out of the question.
    """
    poses, scores = candidates.poses, candidates.scores
    order = np.argsort(-scores, kind="stable")
    order = order[scores[order] > scores[order[0]] - least_below]
    modes: list[Mode] = []
    while order.size and len(modes) < MODES:
        best = poses[order[0]]
        members = is_near(poses[order], best)
        refined, score = _refined(best, looks, pool, field, settings)
        around = poses[order[members]] + (refined - best)
        modes.append(Mode(refined, around, scores[order[members]], score, len(looks)))
        order = order[~members]
    return sorted(modes, key=lambda mode: -mode.score)


def is_near(poses: F64, pose: F64) -> B1:
    """Which poses (n, 3) are in the same place as another one."""
    away = poses - pose
    return np.asarray(
        (np.hypot(away[:, 0], away[:, 1]) <= APART_M) & (np.abs(wrap_angle(away[:, 2])) <= APART_RAD)
    )


def _refined(
    pose: F64, looks: Sequence[Look], pool: MapPool, field: F32, settings: LocalizationSettings
) -> tuple[F64, float]:
    """The best pose around a candidate in a blunt field, and its log-likelihood."""
    score = 0.0
    for poses in finer_lattices(settings):
        scores = all_scores(looks, pose + poses, pool, field, settings)
        best = int(np.argmax(scores))
        pose, score = pose + poses[best], float(scores[best])
    return pose, score


def finer_lattices(settings: LocalizationSettings) -> list[F64]:
    """Steps (125, 3) around a pose, four times and then sixteen times as fine as the lattice of a start."""
    size = np.array([settings.start_pitch_m, settings.start_pitch_m, math.radians(settings.start_pitch_deg)])
    return [_AROUND * size / fineness for fineness in (4.0, 16.0)]
