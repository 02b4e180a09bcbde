"""Particles: weighing, resampling with as many as the spread needs, and the pose they stand for."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import F64, I32
from dynmap_cli.kernels.particles import draw_particles, heaviest_cluster, multiply_weights
from dynmap_cli.localization.settings import LocalizationSettings

BIN_M, BIN_RAD = 0.5, math.radians(10.0)
CLUSTER_M, CLUSTER_RAD = 1.0, math.radians(30.0)
ONE_MODE_SHARE = 0.8


@dataclass(frozen=True, slots=True)
class Particles:
    """Samples of p(x_t, m_t | z_1:t, u_0:t-1), Eq. 1.20.

    Attributes
    ----------
    poses : (n, 3) float64
        map_from_robot.
    weights : (n,) float64
        Sum 1.
    submaps : (n,) int32
        Index of the sub-map each particle is in, -1 = none.
    states : (n,) int32
        Index of its state there, -1 = none.
    """

    poses: F64
    weights: F64
    submaps: I32
    states: I32

    @property
    def count(self) -> int:
        """How many."""
        return int(self.weights.size)

    @property
    def effective(self) -> float:
        """Effective sample size, 1 / sum w^2."""
        return float(1.0 / np.square(self.weights).sum())


@dataclass(frozen=True, slots=True)
class Estimate:
    """The pose of the winning cluster.

    Attributes
    ----------
    pose : (3,) float64
    share : float
        Weight of the cluster, 0 to 1.
    spread_m : float
        Weighted standard deviation of all particles around the pose, in position.
    cluster_spread_m : float
        The same of the particles of the cluster.
    """

    pose: F64
    share: float
    spread_m: float
    cluster_spread_m: float


def make_particles(poses: F64) -> Particles:
    """Particles of equal weight, in no sub-map."""
    n = poses.shape[0]
    none = np.full(n, -1, dtype=np.int32)
    return Particles(poses, np.full(n, 1.0 / n), none, none)


def reweigh(particles: Particles, log_likelihoods: F64) -> Particles:
    """Multiply weights by likelihoods, given as logarithms, and normalize."""
    weights = np.empty(particles.count)
    multiply_weights(particles.weights, log_likelihoods, weights)
    return Particles(particles.poses, weights, particles.submaps, particles.states)


def resample(particles: Particles, settings: LocalizationSettings, random: np.random.Generator) -> Particles:
    """Low-variance resampling, with the number of particles that KLD sampling asks for.

    Fox (2003): the number depends on how many bins of 0.5 m, 10 degrees and state the samples occupy.
    """
    most = settings.max_particles
    poses, submaps, states = (
        np.empty((most, 3)),
        np.empty(most, dtype=np.int32),
        np.empty(most, dtype=np.int32),
    )
    count = draw_particles(
        particles.poses,
        particles.weights,
        particles.submaps,
        particles.states,
        random.random(2),
        np.array([BIN_M, BIN_RAD]),
        np.array([settings.pf_err, settings.pf_z]),
        settings.min_particles,
        poses,
        submaps,
        states,
    )
    return Particles(poses[:count], np.full(count, 1.0 / count), submaps[:count], states[:count])


def estimate_pose(particles: Particles) -> Estimate:
    """Weighted mean of the particles around the heaviest place."""
    found = np.empty(6)
    heaviest_cluster(particles.poses, particles.weights, BIN_M, BIN_RAD, CLUSTER_M, CLUSTER_RAD, found)
    share, spread_m, cluster_spread_m = found[3:].tolist()
    return Estimate(found[:3], share, spread_m, cluster_spread_m)
