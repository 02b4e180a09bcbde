"""Particles: weighing, resampling with as many as the spread needs, and the pose they stand for."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from dynmap_cli.arrays import B1, F64, I32, I64
from dynmap_cli.domain.poses import wrap_angle
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


def reweigh(particles: Particles, log_likelihoods: F64) -> Particles:
    """Multiply weights by likelihoods given as logarithms, and normalize."""
    with np.errstate(divide="ignore"):
        logs = np.log(particles.weights) + log_likelihoods
    weights = np.exp(logs - logs.max())
    return replace(particles, weights=weights / weights.sum())


def resample(particles: Particles, settings: LocalizationSettings, random: np.random.Generator) -> Particles:
    """Low-variance resampling, with the number of particles that KLD sampling asks for.

    Fox (2003): the number depends on how many bins of 0.5 m, 10 degrees and state the samples occupy.
    """
    drawn = low_variance_draw(particles.weights, particles.count, random.random())
    bins = np.unique(_bins(particles)[drawn]).size
    wanted = min(max(kld_count(bins, settings), settings.min_particles), settings.max_particles)
    drawn = low_variance_draw(particles.weights, wanted, random.random())
    return Particles(
        particles.poses[drawn],
        np.full(wanted, 1.0 / wanted),
        particles.submaps[drawn],
        particles.states[drawn],
    )


def low_variance_draw(weights: F64, count: int, offset: float) -> I64:
    """Indices of *count* draws: one comb with equal gaps, shifted by *offset* in [0, 1)."""
    sums = np.cumsum(weights)
    teeth = (np.arange(count) + offset) / count * sums[-1]
    return np.asarray(
        np.minimum(np.searchsorted(sums, teeth, side="right"), weights.size - 1), dtype=np.int64
    )


def kld_count(bins: int, settings: LocalizationSettings) -> int:
    """Samples needed so that the error stays below `pf_err` with the quantile `pf_z` (Fox 2003, Eq. 7)."""
    if bins < 2:
        return settings.min_particles
    a = 2.0 / (9.0 * (bins - 1))
    return math.ceil((bins - 1) / (2.0 * settings.pf_err) * (1.0 - a + math.sqrt(a) * settings.pf_z) ** 3)


def estimate_pose(particles: Particles) -> Estimate:
    """Weighted mean of the particles around the heaviest place."""
    _, inverse = np.unique(_places(particles.poses), return_inverse=True)
    heaviest = int(np.argmax(np.bincount(inverse, weights=particles.weights)))
    pose = _mean_pose(particles, inverse == heaviest)
    members = np.ones(particles.count, dtype=np.bool_)
    for _ in range(3):
        members = _members(particles.poses, pose)
        pose = _mean_pose(particles, members)
    away = np.square(particles.poses[:, :2] - pose[:2]).sum(axis=1)
    return Estimate(
        pose=pose,
        share=float(particles.weights[members].sum()),
        spread_m=math.sqrt(float(particles.weights @ away)),
    )


def _members(poses: F64, pose: F64) -> B1:
    """Which poses belong to the cluster around a pose."""
    near = np.hypot(poses[:, 0] - pose[0], poses[:, 1] - pose[1]) <= CLUSTER_M
    return np.asarray(near & (np.abs(wrap_angle(poses[:, 2] - pose[2])) <= CLUSTER_RAD))


def _mean_pose(particles: Particles, members: B1) -> F64:
    """Weighted mean of some particles, in yaw on the circle."""
    weights = particles.weights[members]
    total = max(float(weights.sum()), 1e-300)
    x, y, yaw = particles.poses[members].T
    mean_yaw = math.atan2(float(weights @ np.sin(yaw)), float(weights @ np.cos(yaw)))
    return np.array([float(weights @ x) / total, float(weights @ y) / total, mean_yaw])


def _places(poses: F64) -> I64:
    """(n,) one number for the bin of place and yaw that each pose lies in."""
    bins = np.floor(poses / (BIN_M, BIN_M, BIN_RAD)).astype(np.int64)
    bins -= bins.min(axis=0)
    _, n_y, n_yaw = (bins.max(axis=0) + 1).tolist()
    return np.asarray((bins[:, 0] * n_y + bins[:, 1]) * n_yaw + bins[:, 2])


def _bins(particles: Particles) -> I64:
    """(n,) one number for the bin of place, yaw, sub-map and state of each particle."""
    n_submaps = int(particles.submaps.max()) + 2
    n_states = int(particles.states.max()) + 2
    place = _places(particles.poses)
    return np.asarray((place * n_submaps + particles.submaps + 1) * n_states + particles.states + 1)
