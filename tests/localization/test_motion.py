"""Laws of the motion model."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dynmap_cli.domain.poses import compose, wrap_angle
from dynmap_cli.kernels.particles import mean_step
from dynmap_cli.localization.particles.motion import (
    SHARE_OF_STEP,
    SHORTEST_STEP_M,
    Motion,
    odometry_sigmas,
    predicted_step,
    sample_motion,
    turn_drive_turn,
    updated_velocity,
)
from dynmap_cli.localization.particles.spread_noise import spread_noise
from dynmap_cli.localization.settings import LocalizationSettings
from tests.reference.localization import plain_mean_step, plain_motion_moments, plain_odometry_step

STILL = {"drift_sigma_m": 0.0, "drift_sigma_rad": 0.0}
small = st.floats(-1.0, 1.0)


@given(small, small, small, st.integers(0, 99))
def test_it_is_the_printed_odometry_model(x, y, yaw, seed):
    poses = np.random.default_rng(seed).normal(size=(5, 3))
    settings = LocalizationSettings(alpha1=0.1, alpha2=0.2, alpha3=0.3, alpha4=0.4, **STILL)
    motion = Motion(np.array([x, y, yaw]), measured=True)
    moved = sample_motion(poses, motion, settings, np.random.default_rng(seed))
    noise = spread_noise(poses, np.random.default_rng(seed))
    for k in range(5):
        twin = plain_odometry_step(poses[k], (x, y, yaw), noise[[0, 1, 3], k], (0.1, 0.2, 0.3, 0.4))
        np.testing.assert_allclose(moved[k, :2], twin[:2], atol=1e-9)
        assert abs(wrap_angle(np.asarray(moved[k, 2] - twin[2]))) < 1e-9


@given(small, small, small, st.booleans())
def test_the_spread_of_many_draws_is_that_of_the_formula(x, y, yaw, measured):
    settings = LocalizationSettings(drift_sigma_m=0.05, drift_sigma_rad=0.02)
    step = np.array([x, y, yaw])
    motion = Motion(step, measured=measured)
    moved = sample_motion(np.zeros((20_000, 3)), motion, settings, np.random.default_rng(5))
    first, length, last = turn_drive_turn(step, SHORTEST_STEP_M if measured else 0.0)
    sigmas = odometry_sigmas(first, length, last, settings)
    if not measured:
        sigma_m = settings.prediction_sigma_m + SHARE_OF_STEP * length
        sigmas = 0.0, sigma_m, sigma_m, settings.prediction_sigma_rad + SHARE_OF_STEP * abs(yaw)
    drift = np.diag(np.square([0.05, 0.05, 0.02]))
    mean, covariance = plain_motion_moments((first, length, last), sigmas)
    np.testing.assert_allclose(moved[:, :2].mean(axis=0), mean[:2], atol=0.03)
    away = np.column_stack([moved[:, :2] - mean[:2], wrap_angle(moved[:, 2] - mean[2])])
    scale = np.sqrt(np.diag(covariance + drift))
    np.testing.assert_allclose(
        away.T @ away / len(away) / np.outer(scale, scale),
        (covariance + drift) / np.outer(scale, scale),
        atol=0.06,
    )


@given(small, small, small)
def test_without_noise_every_particle_makes_the_step(x, y, yaw):
    settings = LocalizationSettings(alpha1=0, alpha2=0, alpha3=0, alpha4=0, **STILL)
    poses, step = np.random.default_rng(1).normal(size=(9, 3)), np.array([x, y, yaw])
    moved = sample_motion(poses, Motion(step, measured=True), settings, np.random.default_rng(0))
    if np.hypot(x, y) >= 0.01:
        np.testing.assert_allclose(compose(poses, step)[:, :2], moved[:, :2], atol=1e-9)
    np.testing.assert_allclose(wrap_angle(moved[:, 2] - compose(poses, step)[:, 2]), 0, atol=1e-9)


def test_velocity_settles_at_that_of_a_steady_robot_and_never_explodes():
    velocity, poses = np.zeros(3), np.zeros((4, 3))
    for _ in range(30):
        after = compose(poses, np.array([0.05, 0.0, 0.01]))
        velocity = updated_velocity(velocity, poses, after, np.full(4, 0.25), 0.1)
        poses = after
    np.testing.assert_allclose(velocity, [0.5, 0.0, 0.1], atol=1e-3)
    np.testing.assert_allclose(predicted_step(velocity, 50.0), velocity)
    for seconds in (0.0, 1e-9, -1.0):
        assert np.abs(updated_velocity(velocity, poses, poses + 1.0, np.full(4, 0.25), seconds)).max() <= 20


def test_the_mean_step_is_that_of_single_particles():
    random = np.random.default_rng(2)
    before, after = random.normal(size=(7, 3)) * 2, random.normal(size=(7, 3)) * 2
    weights = random.dirichlet(np.ones(7))
    out = np.empty(3)
    mean_step(before, after, weights, out)
    np.testing.assert_allclose(out, plain_mean_step(before, after, weights), atol=1e-12)
