"""What is said of the pose of an update."""

import math

import numpy as np

from dynmap_cli.localization.particles.particle_filter import Particles, estimate_pose
from dynmap_cli.localization.pose_rows import cluster_covariance, pose_row


def cloud():
    """Two clusters; the heavier one lies across the seam of yaw."""
    random = np.random.default_rng(3)
    heavy = np.array([5.0, 5.0, np.pi]) + random.multivariate_normal(
        np.zeros(3), [[0.01, 0.006, 0.0], [0.006, 0.02, 0.001], [0.0, 0.001, 0.004]], 700
    )
    heavy[:, 2] = (heavy[:, 2] + np.pi) % (2 * np.pi) - np.pi
    light = np.array([-5.0, 5.0, 0.0]) + 0.05 * random.normal(size=(300, 3))
    weights = random.random(1000)
    none = np.full(1000, -1, dtype=np.int32)
    return Particles(np.concatenate([heavy, light]), weights / weights.sum(), none, none)


def plain_covariance(particles, pose):
    """Around the pose, over the particles of its cluster, one by one."""
    total, result = 0.0, np.zeros((3, 3))
    for (x, y, yaw), weight in zip(particles.poses, particles.weights, strict=True):
        turn = math.atan2(math.sin(yaw - pose[2]), math.cos(yaw - pose[2]))
        away = np.array([x - pose[0], y - pose[1], turn])
        if math.hypot(away[0], away[1]) <= 1.0 and abs(turn) <= math.radians(30):
            total, result = total + weight, result + weight * np.outer(away, away)
    return result / total


def test_the_covariance_is_that_of_the_heavier_cluster_alone():
    particles = cloud()
    estimate = estimate_pose(particles)
    found = cluster_covariance(particles, estimate.pose)
    np.testing.assert_allclose(found, plain_covariance(particles, estimate.pose), atol=1e-12)
    np.testing.assert_allclose(np.diag(found), [0.01, 0.02, 0.004], rtol=0.2)


def test_the_best_particle_is_the_one_of_the_largest_weight():
    particles = cloud()
    row = pose_row(7, 3, particles, estimate_pose(particles))
    assert row.best.tolist() == particles.poses[np.argmax(particles.weights)].tolist()
    assert abs(row.share - particles.weights[:700].sum()) < 0.01
