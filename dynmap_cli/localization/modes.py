"""The places among many candidate poses: each refined, and charged for the walls its beams would go through."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynmap_cli.arrays import F64, I64
from dynmap_cli.domain.poses import compose, wrap_angle
from dynmap_cli.localization.health import count_places_through, ends_off_map
from dynmap_cli.localization.map_pool import MapPool
from dynmap_cli.localization.sensor import Sweep, pose_ends, scan_log_likelihoods, temper
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.localization.states import place_sweep

START_BEAMS = 60
MODES = 100
APART_M, APART_RAD = 0.75, math.radians(20.0)
"""Candidates closer than this belong to one place."""
LOG_LIKELIHOOD_PER_PLACE = -1.0
"""Of a scan that goes through walls in one more place: a likelihood field does not see it, and it happens where a
door was opened, but not in many places."""
_LEAST_BELOW = 30.0
"""Candidates with a log-likelihood this far below the best are out of the question; the lattice alone takes 20 from a
right one between its points."""
_STEPS = np.arange(-2, 3)


@dataclass(frozen=True, slots=True)
class Look:
    """One of the scans that candidates are weighed by.

    Attributes
    ----------
    sweep : Sweep
    step : (3,) float64
        From the pose that the candidates stand for to that of this scan.
    weight : float
        Of the scan: the share of its beams that are left in it.
    """

    sweep: Sweep
    step: F64
    weight: float = 1.0


def look_scores(look: Look, poses: F64, pool: MapPool, settings: LocalizationSettings) -> F64:
    """Tempered log-likelihood of a scan from each pose (n, 3), in the blunt field of all states."""
    ends = pose_ends(look.sweep, START_BEAMS)
    moved = compose(poses, look.step)
    exponent = look.weight * temper(ends.shape[0], settings)
    return exponent * scan_log_likelihoods(pool.start_field, pool.frame, moved, ends)


def judged_look(look: Look, pose: F64, pool: MapPool) -> Look:
    """A scan without the beams that end where the map knows nothing, seen from a pose (3,) at the first scan."""
    placed = place_sweep(look.sweep, compose(pose, look.step))
    judged = ~ends_off_map(placed, pool)
    share = float((judged & placed.hits).sum()) / max(int(placed.hits.sum()), 1)
    sweep = look.sweep
    kept = replace(sweep, directions_rad=sweep.directions_rad[judged], ranges_m=sweep.ranges_m[judged])
    return Look(kept, look.step, share)


def judge_modes(
    poses: F64, scores: F64, looks: Sequence[Look], pool: MapPool, settings: LocalizationSettings
) -> tuple[I64, F64]:
    """Find the best places, judge each by the best pose in it, and charge it for walls.

    How well a candidate fits depends on where in its cell of the lattice the robot is, by ten and more for a right
    one; among places that look alike that would decide.

    Parameters
    ----------
    poses : (n, 3) float64
    scores : (n,) float64
        Log-likelihood of all looks together.
    looks : sequence of Look

    Returns
    -------
    kept : (m,) int64
        Candidates that lie in one of the best `MODES` places.
    scores : (m,) float64
        Theirs, more by what the best pose around the best of them gains, less by the charge.
    """
    order = np.argsort(-scores, kind="stable")
    order = order[scores[order] > scores[order[0]] - _LEAST_BELOW]
    kept: list[I64] = []
    charged: list[F64] = []
    while order.size and len(kept) < MODES:
        best = order[0]
        away = poses[order] - poses[best]
        members = (np.hypot(away[:, 0], away[:, 1]) <= APART_M) & (
            np.abs(wrap_angle(away[:, 2])) <= APART_RAD
        )
        refined, score = refined_pose(poses[best], looks, pool, settings)
        kept.append(order[members])
        charged.append(scores[order[members]] - scores[best] + score + _charge(refined, looks, pool))
        order = order[~members]
    return np.concatenate(kept), np.concatenate(charged)


def _charge(pose: F64, looks: Sequence[Look], pool: MapPool) -> float:
    """What the walls cost that beams go through."""
    places = sum(
        count_places_through(place_sweep(look.sweep, compose(pose, look.step)), pool) for look in looks
    )
    return LOG_LIKELIHOOD_PER_PLACE * places


def refined_pose(
    pose: F64, looks: Sequence[Look], pool: MapPool, settings: LocalizationSettings
) -> tuple[F64, float]:
    """The best pose around a candidate, on a lattice four times and then sixteen times as fine, and its score."""
    size = np.array([settings.start_pitch_m, settings.start_pitch_m, math.radians(settings.start_pitch_deg)])
    around = np.stack(np.meshgrid(_STEPS, _STEPS, _STEPS, indexing="ij"), axis=-1).reshape(-1, 3)
    for fineness in (4.0, 16.0):
        poses = pose + around * size / fineness
        total = sum((look_scores(look, poses, pool, settings) for look in looks), np.zeros(len(poses)))
        pose = poses[int(np.argmax(total))]
    return pose, float(total.max())
