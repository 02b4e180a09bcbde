"""The files of a localization: poses.csv, states.csv, objects.csv, health.csv, particles.npz."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from dynmap_cli.domain.patches import NEVER_MAPPED
from dynmap_cli.files.trajectory import format_stamp
from dynmap_cli.localization.beliefs.state_tables import ObjectBelief, PatchBelief
from dynmap_cli.localization.found import HealthRow, Localization
from dynmap_cli.localization.pose_rows import PoseRow

POSES_HEADER = (
    "stamp_s,x_m,y_m,yaw_rad,xx_m2,xy_m2,x_yaw_m_rad,yy_m2,y_yaw_m_rad,yaw_yaw_rad2,"
    "best_x_m,best_y_m,best_yaw_rad,cluster_weight"
)
STATES_HEADER = "stamp_s,submap,patch,probability,nearest"
OBJECTS_HEADER = "stamp_s,submap,object,probability_on"
HEALTH_HEADER = (
    "stamp_s,explained,explained_by_other_state,unexplained,log_likelihood_per_beam,"
    "effective_particles,patch_entropy_bits,verdict,where"
)


def write_poses(path: Path, rows: Sequence[PoseRow]) -> None:
    """Write one line per update: pose, upper triangle of its covariance row by row, best particle."""
    lines = [POSES_HEADER]
    for row in rows:
        upper = row.covariance[np.triu_indices(3)]
        numbers = [f"{value:.6f}" for value in row.pose.tolist()]
        numbers += [f"{value:.6e}" for value in upper.tolist()]
        numbers += [f"{value:.6f}" for value in (*row.best.tolist(), row.share)]
        lines.append(f"{format_stamp(row.stamp_ns)},{','.join(numbers)}")
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def write_states(path: Path, rows: Iterable[PatchBelief]) -> None:
    """Write one line per scan, sub-map in view and state; the last one where states were never mapped is for these."""
    lines = [STATES_HEADER]
    for row in rows:
        stamp = format_stamp(row.stamp_ns)
        for patch_id, probability in zip(row.patch_ids, row.belief.tolist(), strict=True):
            nearest = row.description if patch_id == NEVER_MAPPED else ""
            lines.append(f"{stamp},{row.submap_id},{patch_id},{probability:.6f},{nearest}")
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def write_objects(path: Path, rows: Iterable[ObjectBelief]) -> None:
    """Write one line per scan and object in view."""
    lines = [OBJECTS_HEADER]
    lines += [
        f"{format_stamp(row.stamp_ns)},{row.submap_id},{row.object_id},{row.probability_on:.6f}"
        for row in rows
    ]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def write_health(path: Path, rows: Sequence[HealthRow]) -> None:
    """Write one line per update."""
    lines = [HEALTH_HEADER]
    for row in rows:
        health = row.health
        lines.append(
            f"{format_stamp(row.stamp_ns)},{health.explained:.4f},{health.explained_by_other_state:.4f},"
            f"{health.unexplained:.4f},{row.log_likelihood_per_beam:.4f},{row.effective_particles:.1f},"
            f"{row.patch_entropy_bits:.4f},{row.verdict},{health.where if row.verdict == 'changed' else ''}"
        )
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def write_particles(path: Path, found: Localization) -> None:
    """Write the clouds of all updates, one after another.

    `stamps_ns (n_updates,)`, `counts (n_updates,)`, and for all particles `poses (n, 3)` float32,
    `weights (n,)` float32, `submaps (n,)` and `states (n,)` int16 (-1 = none).
    """
    clouds = [cloud for _, cloud in found.clouds]
    np.savez_compressed(
        path,
        stamps_ns=np.array([stamp for stamp, _ in found.clouds], dtype=np.int64),
        counts=np.array([cloud.count for cloud in clouds], dtype=np.int64),
        poses=np.concatenate([np.empty((0, 3)), *(cloud.poses for cloud in clouds)]).astype(np.float32),
        weights=np.concatenate([np.empty(0), *(cloud.weights for cloud in clouds)]).astype(np.float32),
        submaps=np.concatenate([np.empty(0), *(cloud.submaps for cloud in clouds)]).astype(np.int16),
        states=np.concatenate([np.empty(0), *(cloud.states for cloud in clouds)]).astype(np.int16),
    )
