"""The motion model p(x_t | x_{t-1}, u_{t-1}) of Eq. 1.24."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import F64
from dynmap_cli.kernels.particles import mean_step, move_poses
from dynmap_cli.localization.particles.spread_noise import spread_noise
from dynmap_cli.localization.settings import LocalizationSettings

SHORTEST_STEP_M = 0.01
SHARE_OF_STEP = 0.3
LONGEST_PREDICTION_S = 1.0
VELOCITY_MEMORY_S = 0.1
FASTEST = np.array([20.0, 20.0, 4.0])
"""m/s, m/s, rad/s: nothing that carries a laser scanner through a mapped place is faster."""


@dataclass(frozen=True, slots=True)
class Motion:
    """How the robot moved since the last update.

    Attributes
    ----------
    step : (3,) float64
        Pose now seen from the pose then: x, y in metres, yaw in radians.
    measured : bool
        True from odometry, False where it is a prediction.
    sigmas : (3,) float64 or None
        Noise along and across the way in metres, and of the yaw in radians; None = that of the settings.
    """

    step: F64
    measured: bool
    sigmas: F64 | None = None


def sample_motion(
    poses: F64, motion: Motion, settings: LocalizationSettings, random: np.random.Generator
) -> F64:
    """Move each pose (n, 3) by the step and noise of its own.

    The drift of every update has no direction, so it is added to the noise along and across the way.
    """
    first, length, last = _turn_drive_turn_of(motion)
    all_sigmas = np.asarray(motion_sigmas(motion, settings))
    out = np.empty(poses.shape)
    move_poses(poses, np.array([first, last]), length, all_sigmas, spread_noise(poses, random), out)
    return out


def motion_sigmas(motion: Motion, settings: LocalizationSettings) -> tuple[float, float, float, float]:
    """Noise of the first turn, along and across the way, and of the last turn."""
    if motion.sigmas is not None:
        along, across, yaw = motion.sigmas.tolist()
        return 0.0, along, across, yaw
    first, length, last = _turn_drive_turn_of(motion)
    drift_m, drift_rad = settings.drift_sigma_m, settings.drift_sigma_rad
    if motion.measured:
        sigmas = odometry_sigmas(first, length, last, settings)
    else:
        sigma_m = settings.prediction_sigma_m + SHARE_OF_STEP * length
        sigma_rad = settings.prediction_sigma_rad + SHARE_OF_STEP * abs(float(motion.step[2]))
        sigmas = 0.0, sigma_m, sigma_m, sigma_rad
    first, along, across, yaw = np.hypot(sigmas, (0.0, drift_m, drift_m, drift_rad)).tolist()
    return first, along, across, yaw


def _turn_drive_turn_of(motion: Motion) -> tuple[float, float, float]:
    """The step in three parts; what was measured to be shorter than odometry can tell has no direction."""
    return turn_drive_turn(motion.step, SHORTEST_STEP_M if motion.measured else 0.0)


def turn_drive_turn(step: F64, shortest_m: float) -> tuple[float, float, float]:
    """The step as a turn towards where it leads, a way in metres, and a turn to the final yaw.

    A way below *shortest_m* has no direction: it leads ahead.
    """
    length = math.hypot(step[0], step[1])
    first = math.atan2(step[1], step[0]) if length >= shortest_m else 0.0
    last = (float(step[2]) - first + math.pi) % (2.0 * math.pi) - math.pi
    return first, length, last


def odometry_sigmas(
    first: float, length: float, last: float, settings: LocalizationSettings
) -> tuple[float, float, float, float]:
    """Noise of the first turn, along and across the way, and of the last turn.

    Thrun et al., Probabilistic Robotics, table 5.6, as in AMCL: a robot that drives backwards does not
    turn by 180 degrees, so the angle to the nearer of the two directions makes the noise.
    """
    first_noise = min(abs(first), abs(abs(first) - math.pi))
    last_noise = min(abs(last), abs(abs(last) - math.pi))
    from_way = settings.alpha2 * length**2
    return (
        math.sqrt(settings.alpha1 * first_noise**2 + from_way),
        math.sqrt(settings.alpha3 * length**2 + settings.alpha4 * (first_noise**2 + last_noise**2)),
        0.0,
        math.sqrt(settings.alpha1 * last_noise**2 + from_way),
    )


def step_between(before: F64, after: F64) -> F64:
    """One pose (3,) seen from another, as `between` for many."""
    cos, sin = math.cos(before[2]), math.sin(before[2])
    dx, dy = float(after[0] - before[0]), float(after[1] - before[1])
    turn = math.remainder(float(after[2] - before[2]), 2.0 * math.pi)
    return np.array([cos * dx + sin * dy, cos * dy - sin * dx, turn])


def predicted_step(velocity: F64, seconds: float) -> F64:
    """How far the robot comes if it goes on as before; not further than in one second."""
    return velocity * min(max(seconds, 0.0), LONGEST_PREDICTION_S)


def updated_velocity(velocity: F64, before: F64, after: F64, weights: F64, seconds: float) -> F64:
    """Velocity (3,) in the robot frame after a step of the particles.

    The step is the weighted mean of the steps of single particles, so it does not jump when another
    cluster wins; the memory keeps scans with nearly equal stamps from making it boundless.

    Parameters
    ----------
    velocity : (3,) float64
        Before: x, y in m/s, yaw in rad/s.
    before, after : (n, 3) float64
        Poses of the same particles before and after the step.
    weights : (n,) float64
        Of the particles after the scan.
    seconds : float
        Time of the step.
    """
    time_s = min(max(seconds, 0.0), LONGEST_PREDICTION_S)
    step = np.empty(3)
    mean_step(before, after, weights, step)
    changed = velocity + (step - velocity * time_s) / (time_s + VELOCITY_MEMORY_S)
    return np.asarray(np.minimum(np.maximum(changed, -FASTEST), FASTEST))
