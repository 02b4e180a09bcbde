"""One recording through one map: where the robot is put, how sure, how far from the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import F64, I64
from dynmap_cli.comparison.maps import ComparedMap
from dynmap_cli.domain.poses import Trajectory, interpolate
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.localization.beliefs.parts import believed_parts
from dynmap_cli.localization.beliefs.state_tables import PatchBelief, patch_beliefs
from dynmap_cli.localization.found import HealthRow, Localization
from dynmap_cli.localization.sensing.map_pool import make_map_pool
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.localization.tracking import localize_log
from dynmap_cli.progress import Tick


@dataclass(frozen=True, slots=True)
class Course:
    """What came out in one map; one entry per update.

    Attributes
    ----------
    compared : ComparedMap
    stamps_ns : (n,) int64
    poses : (n, 3) float64
    spread_m : (n,) float64
        Weighted standard deviation of the particles around the pose, in position.
    error_m : (n,) float64
        Weighted mean distance of the particles from the true position (paper, Fig. 1.13); NaN where it is not known.
    pose_error_m : (n,) float64
        Distance of the pose itself from the true position; NaN where it is not known.
    log_likelihood : (n,) float64
        Per beam, at the pose.
    is_lost : (n,) bool
    states : sequence of PatchBelief
    health : sequence of HealthRow
    """

    compared: ComparedMap
    stamps_ns: I64
    poses: F64
    spread_m: F64
    error_m: F64
    pose_error_m: F64
    log_likelihood: F64
    is_lost: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]
    states: Sequence[PatchBelief]
    health: Sequence[HealthRow]

    def away_from_m(self, other: Course) -> F64:
        """(n,) distance of each pose from where the other map puts the robot then; NaN before and after it."""
        there = interpolate(other.stamps_ns, other.poses, self.stamps_ns)
        return np.asarray(np.hypot(self.poses[:, 0] - there[:, 0], self.poses[:, 1] - there[:, 1]))


def course_in(
    compared: ComparedMap,
    log: ScanLog,
    settings: LocalizationSettings,
    truth: Trajectory | None,
    *,
    seed: int,
    threads: int,
    tick: Tick,
) -> Course:
    """Localize the recording in one of the maps.

    Parameters
    ----------
    compared : ComparedMap
    log : ScanLog
    settings : LocalizationSettings
    truth : Trajectory or None
        True poses in the frame of the map.
    seed, threads : int
    tick : callable
    """
    parts = believed_parts(compared.patch_sets, compared.visits, settings.states)
    pool = make_map_pool(compared.grid, [part.states for part in parts], settings)
    with_particles = settings.model_copy(update={"save_particles": True})
    found = localize_log(log, pool, with_particles, seed=seed, threads=threads, tick=tick)
    rows = found.poses
    stamps = np.array([row.stamp_ns for row in rows], dtype=np.int64)
    poses = np.array([row.pose for row in rows]).reshape(-1, 3)
    true = true_positions_m(truth, stamps)
    return Course(
        compared=compared,
        stamps_ns=stamps,
        poses=poses,
        spread_m=np.array([row.spread_m for row in rows]),
        error_m=particle_errors_m(found, true),
        pose_error_m=np.hypot(poses[:, 0] - true[:, 0], poses[:, 1] - true[:, 1]),
        log_likelihood=np.array([row.log_likelihood_per_beam for row in found.health]),
        is_lost=np.array([row.verdict == "lost" for row in found.health], dtype=np.bool_),
        states=patch_beliefs(found.states, pool, parts, compared.patch_sets),
        health=found.health,
    )


def particle_errors_m(found: Localization, true_m: F64) -> F64:
    """(n_updates,) weighted mean distance of the particles from true positions (n_updates, 2)."""
    return np.array(
        [
            float(cloud.weights @ np.hypot(cloud.poses[:, 0] - x, cloud.poses[:, 1] - y))
            for (_, cloud), (x, y) in zip(found.clouds, true_m, strict=True)
        ]
    )


def true_positions_m(truth: Trajectory | None, stamps_ns: I64) -> F64:
    """(n, 2) true positions at some times; NaN where they are not known."""
    if truth is None:
        return np.full((stamps_ns.size, 2), np.nan)
    return interpolate(truth.stamps_ns, truth.poses, stamps_ns)[:, :2]
