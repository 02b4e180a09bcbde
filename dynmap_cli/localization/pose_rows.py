"""The pose after an update, with what the particles say about how sure it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import F64
from dynmap_cli.kernels.particles import covariance_near
from dynmap_cli.localization.particles.particle_filter import CLUSTER_M, CLUSTER_RAD, Estimate, Particles


@dataclass(frozen=True, slots=True)
class PoseRow:
    """Pose of the robot at one update.

    Attributes
    ----------
    stamp_ns : int
    scan : int
        Index in the log.
    pose : (3,) float64
        Weighted mean of the heaviest cluster of particles; x, y in metres, yaw in radians.
    covariance : (3, 3) float64
        Of that cluster, around its mean, in the axes of the map; m^2, m rad, rad^2.
    best : (3,) float64
        The particle of the largest weight.
    share : float
        Weight of the cluster, 0 to 1.
    spread_m : float
        Weighted standard deviation of all particles around the pose, in position.
    """

    stamp_ns: int
    scan: int
    pose: F64
    covariance: F64
    best: F64
    share: float
    spread_m: float


def pose_row(stamp_ns: int, scan: int, particles: Particles, estimate: Estimate) -> PoseRow:
    """Describe the particles of an update, after they were weighed and before they are drawn again."""
    return PoseRow(
        stamp_ns=stamp_ns,
        scan=scan,
        pose=estimate.pose,
        covariance=cluster_covariance(particles, estimate.pose),
        best=particles.poses[int(np.argmax(particles.weights))].copy(),
        share=estimate.share,
        spread_m=estimate.spread_m,
    )


def cluster_covariance(particles: Particles, pose: F64) -> F64:
    """(3, 3) weighted covariance of the particles in the cluster around a pose, yaw along the shorter arc."""
    covariance = np.empty((3, 3))
    covariance_near(particles.poses, particles.weights, pose, CLUSTER_M, CLUSTER_RAD, covariance)
    return covariance
