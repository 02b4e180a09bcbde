"""Particles: weighing, resampling with as many as the spread needs, and the pose they stand for."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from dynmap_cli.arrays import B1, F64, I32, I64
from dynmap_cli.domain.poses import wrap_angle
from dynmap_cli.kernels.particles import (
    count_bins,
    draw_low_variance,
    heaviest_cluster,
    multiply_weights,
    sort_into_bins,
)
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
    """

    pose: F64
    share: float
    spread_m: float

    @property
    def is_one_mode(self) -> bool:
        """Whether the particles agree on a place."""
        return self.share >= ONE_MODE_SHARE


def make_particles(poses: F64) -> Particles:
    """Particles of equal weight, in no sub-map."""
    n = poses.shape[0]
    none = np.full(n, -1, dtype=np.int32)
    return Particles(poses, np.full(n, 1.0 / n), none, none)


def reweigh(particles: Particles, log_likelihoods: F64, exponent: float = 1.0) -> Particles:
    """Multiply weights by likelihoods, given as logarithms, to the power of *exponent*, and normalize."""
    weights = np.empty(particles.count)
    multiply_weights(particles.weights, log_likelihoods, exponent, weights)
    return replace(particles, weights=weights)


def resample(particles: Particles, settings: LocalizationSettings, random: np.random.Generator) -> Particles:
    """Low-variance resampling, with the number of particles that KLD sampling asks for.

    Fox (2003): the number depends on how many bins of 0.5 m, 10 degrees and state the samples occupy.
    """
    drawn = low_variance_draw(particles.weights, particles.count, random.random())
    bins = bins_of(particles.poses, particles.submaps, particles.states)
    n_bins = count_bins(bins, drawn, np.empty(particles.count, dtype=np.int32))
    wanted = min(max(kld_count(n_bins, settings), settings.min_particles), settings.max_particles)
    drawn = low_variance_draw(particles.weights, wanted, random.random())
    return Particles(
        particles.poses.take(drawn, axis=0),
        np.full(wanted, 1.0 / wanted),
        particles.submaps.take(drawn),
        particles.states.take(drawn),
    )


def low_variance_draw(weights: F64, count: int, offset: float) -> I64:
    """Indices of *count* draws: one comb with equal gaps, shifted by *offset* in [0, 1)."""
    drawn = np.empty(count, dtype=np.int64)
    draw_low_variance(weights, count, offset, drawn)
    return drawn


def bins_of(poses: F64, submaps: I32, states: I32) -> I32:
    """(n,) for each particle the first one that lies in the same bin of place, yaw, sub-map and state."""
    n = poses.shape[0]
    keys, table = np.empty((n, 5), dtype=np.int32), np.empty(2 << n.bit_length(), dtype=np.int32)
    bins = np.empty(n, dtype=np.int32)
    sort_into_bins(poses, submaps, states, BIN_M, BIN_RAD, keys, table, bins)
    return bins


def kld_count(bins: int, settings: LocalizationSettings) -> int:
    """Samples needed so that the error stays below `pf_err` with the quantile `pf_z` (Fox 2003, Eq. 7)."""
    if bins < 2:
        return settings.min_particles
    a = 2.0 / (9.0 * (bins - 1))
    return math.ceil((bins - 1) / (2.0 * settings.pf_err) * (1.0 - a + math.sqrt(a) * settings.pf_z) ** 3)


def estimate_pose(particles: Particles) -> Estimate:
    """Weighted mean of the particles around the heaviest place."""
    n, found = particles.count, np.empty(5)
    nowhere = np.zeros(n, dtype=np.int32)
    bins = bins_of(particles.poses, nowhere, nowhere)
    heaviest_cluster(particles.poses, particles.weights, bins, np.empty(n), CLUSTER_M, CLUSTER_RAD, found)
    return Estimate(pose=found[:3], share=float(found[3]), spread_m=float(found[4]))


def members_of(poses: F64, pose: F64) -> B1:
    """Which poses belong to the cluster around a pose."""
    near = np.hypot(poses[:, 0] - pose[0], poses[:, 1] - pose[1]) <= CLUSTER_M
    return np.asarray(near & (np.abs(wrap_angle(poses[:, 2] - pose[2])) <= CLUSTER_RAD))
