"""The motion model p(x_t | x_{t-1}, u_{t-1}) of Eq. 1.24."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import F64
from dynmap_cli.domain.poses import between, compose, wrap_angle
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
    """

    step: F64
    measured: bool


def sample_motion(
    poses: F64, motion: Motion, settings: LocalizationSettings, random: np.random.Generator
) -> F64:
    """Move each pose (n, 3) by the step and noise of its own."""
    noise = random.standard_normal((3, poses.shape[0]))
    if motion.measured:
        moved = _by_odometry(poses, motion.step, noise, settings)
    else:
        moved = _by_prediction(poses, motion.step, noise, settings)
    drift = random.standard_normal((3, poses.shape[0]))
    moved[:, 0] += settings.drift_sigma_m * drift[0]
    moved[:, 1] += settings.drift_sigma_m * drift[1]
    moved[:, 2] = wrap_angle(moved[:, 2] + settings.drift_sigma_rad * drift[2])
    return moved


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
    step = weights @ between(before, after)
    changed = velocity + (step - velocity * time_s) / (time_s + VELOCITY_MEMORY_S)
    return np.clip(changed, -FASTEST, FASTEST)


def _by_odometry(poses: F64, step: F64, noise: F64, settings: LocalizationSettings) -> F64:
    """Turn, drive, turn (Thrun et al., Probabilistic Robotics, table 5.6, as in AMCL).

    A robot that drives backwards does not turn by 180 degrees: the angle to the nearer of the two
    directions makes the noise.
    """
    length = float(np.hypot(step[0], step[1]))
    first = float(np.arctan2(step[1], step[0])) if length >= SHORTEST_STEP_M else 0.0
    last = float(wrap_angle(np.asarray(step[2] - first)))
    first_noise = min(abs(first), abs(abs(first) - np.pi))
    last_noise = min(abs(last), abs(abs(last) - np.pi))
    sigma_first = np.sqrt(settings.alpha1 * first_noise**2 + settings.alpha2 * length**2)
    sigma_length = np.sqrt(settings.alpha3 * length**2 + settings.alpha4 * (first_noise**2 + last_noise**2))
    sigma_last = np.sqrt(settings.alpha1 * last_noise**2 + settings.alpha2 * length**2)
    turned = poses[:, 2] + first - sigma_first * noise[0]
    driven = length - sigma_length * noise[1]
    return np.stack(
        [
            poses[:, 0] + driven * np.cos(turned),
            poses[:, 1] + driven * np.sin(turned),
            wrap_angle(turned + last - sigma_last * noise[2]),
        ],
        axis=-1,
    )


def _by_prediction(poses: F64, step: F64, noise: F64, settings: LocalizationSettings) -> F64:
    """Go on as before: the last step again, with room for what may have changed since."""
    sigma_m = settings.prediction_sigma_m + SHARE_OF_STEP * float(np.hypot(step[0], step[1]))
    sigma_rad = settings.prediction_sigma_rad + SHARE_OF_STEP * abs(float(step[2]))
    steps = step + np.stack([sigma_m * noise[0], sigma_m * noise[1], sigma_rad * noise[2]], axis=-1)
    return compose(poses, steps)
