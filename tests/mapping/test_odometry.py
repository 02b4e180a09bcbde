"""Calibration names what was done to the odometry."""

import numpy as np
import pytest

from dynmap_cli.domain.poses import between, compose
from dynmap_cli.scan_matching.calibration import Calibration
from dynmap_cli.scan_matching.odometry import calibrate, corrected_motion, lacks_sign


def drive(n=1500, seed=0, backwards=False):
    """True poses of a smooth drive with turns, five per second."""
    rng = np.random.default_rng(seed)
    turn_rate = np.convolve(rng.normal(0, 0.6, n + 98), np.hanning(99) / 49, mode="valid")[:n]
    speed = 0.08 + 0.02 * np.sin(np.arange(n) / 40)
    if backwards:
        speed = speed * np.where(np.arange(n) % 200 < 60, -1, 1)
    poses = np.zeros((n, 3))
    for k in range(1, n):
        poses[k] = compose(poses[k - 1], np.array([speed[k], 0.0, turn_rate[k]]))
    return poses, np.arange(n) * 0.2


def odometry_of(poses, scale=1.0, bias=0.0, shift=1.0):
    """Odometry whose turns relate to the true ones by scale and bias per metre."""
    steps = between(poses[:-1], poses[1:])
    steps[:, 2] = (steps[:, 2] - bias * np.linalg.norm(steps[:, :2], axis=1)) / scale
    steps[:, :2] /= shift
    odometry = np.zeros_like(poses)
    for k, step in enumerate(steps):
        odometry[k + 1] = compose(odometry[k], step)
    return odometry


def delayed(odometry, scans):
    """Odometry that is late by a number of scans."""
    index = np.clip(np.arange(len(odometry)) - scans, 0, len(odometry) - 1)
    return np.column_stack(
        [
            np.interp(
                index, np.arange(len(odometry)), np.unwrap(odometry[:, 2]) if c == 2 else odometry[:, c]
            )
            for c in range(3)
        ]
    )


GOOD = np.ones(1500, dtype=bool)


def test_perfect_odometry_needs_no_correction():
    poses, times = drive()
    found = calibrate(odometry_of(poses), times, poses, GOOD, GOOD, reversible=False)
    assert abs(found.lag_scans) < 0.05
    assert abs(found.rotation_scale - 1) < 0.01
    assert abs(found.rotation_bias_rad_m) < 0.005
    assert found.n_steps > 1000
    assert found.step_noise_m < 0.001


@pytest.mark.parametrize("lag", [-1.0, -0.46, 0.43, 1.4])
def test_a_lag_is_found_and_taken_out(lag):
    poses, times = drive()
    odometry = delayed(odometry_of(poses), lag)
    found = calibrate(odometry, times, poses, GOOD, GOOD, reversible=False)
    assert abs(found.lag_scans + found.lag_s / 0.2 - lag) < 0.1
    motion = corrected_motion(odometry, times, found)[5:-5]
    true = between(poses[4:-6], poses[5:-5])
    assert (
        np.abs(motion[:, 2] - true[:, 2]).mean()
        < 0.2 * np.abs(np.diff(odometry[5:-5, 2]) - true[1:, 2]).mean()
    )


@pytest.mark.parametrize(("scale", "bias"), [(1.05, 0.0), (0.95, 0.035), (1.0, -0.05)])
def test_scale_and_bias_of_turns_are_found(scale, bias):
    poses, times = drive()
    found = calibrate(odometry_of(poses, scale, bias), times, poses, GOOD, GOOD, reversible=False)
    assert abs(found.rotation_scale - scale) < 0.02
    assert abs(found.rotation_bias_rad_m - bias) < 0.006
    assert f"turns x {found.rotation_scale:.3f}" in found.sentence()


def test_scale_of_the_distance_is_found():
    poses, times = drive()
    found = calibrate(odometry_of(poses, shift=1.04), times, poses, GOOD, GOOD, reversible=False)
    assert abs(found.translation_scale - 1.04) < 0.01


def test_distances_are_not_told_where_the_match_does_not_know_them():
    poses, times = drive()
    found = calibrate(odometry_of(poses, shift=1.04), times, poses, GOOD, ~GOOD, reversible=False)
    assert found.translation_scale == 1.0


def test_noise_of_steps_is_measured():
    poses, times = drive()
    noisy, rng = odometry_of(poses), np.random.default_rng(3)
    steps = between(noisy[:-1], noisy[1:]) + rng.normal(0, 1, (1499, 3)) * [0.006, 0.0, 0.004]
    for k, step in enumerate(steps):
        noisy[k + 1] = compose(noisy[k], step)
    found = calibrate(noisy, times, poses, GOOD, GOOD, reversible=False)
    assert 0.004 < found.step_noise_m < 0.008
    assert 0.002 < found.step_noise_rad < 0.006


def test_odometry_without_sign_is_told_from_one_that_has_it():
    poses, _ = drive(backwards=True)
    steps = between(poses[:-1], poses[1:])
    steps[:, 0] = np.abs(steps[:, 0])
    signless = np.zeros_like(poses)
    for k, step in enumerate(steps):
        signless[k + 1] = compose(signless[k], step)
    assert lacks_sign(signless, poses, GOOD)
    assert not lacks_sign(poses, poses, GOOD)
    assert not lacks_sign(signless, signless, GOOD)
    assert not lacks_sign(signless, poses, ~GOOD)


@pytest.mark.parametrize("lag", [-0.9, 0.7])
@pytest.mark.parametrize("scale", [0.85, 1.15])
def test_a_lag_is_found_where_turns_are_counted_wrong_and_noisy(scale, lag):
    """Most of what is left of the turns is their scale, not the lag; as where a robot with six wheels turns."""
    poses, times = drive()
    turns = np.random.default_rng(3).normal(0.0, 0.004, len(poses)).cumsum()
    noisy = poses + np.column_stack([np.zeros((len(poses), 2)), turns])
    odometry = delayed(odometry_of(poses, scale=scale), lag)
    found = calibrate(odometry, times, noisy, GOOD, GOOD, reversible=False)
    assert abs(found.lag_scans + found.lag_s / 0.2 - lag) < 0.15
    assert found.rotation_scale == pytest.approx(scale, abs=0.03)


def test_without_odometry_there_is_nothing_to_correct():
    missing = np.full((10, 3), np.nan)
    assert not np.isfinite(corrected_motion(missing, np.arange(10.0), Calibration())[1:]).any()


@pytest.mark.parametrize("seed", range(5))
def test_noise_of_single_steps_is_no_lag(seed):
    """Interpolating between two scans averages their noise, which must not look like a lag of half a scan."""
    poses, times = drive()
    rng = np.random.default_rng(seed)
    steps = between(poses[:-1], poses[1:]) + rng.normal(0.0, 1.0, (len(poses) - 1, 3)) * [0.005, 0.002, 0.005]
    odometry = np.zeros_like(poses)
    for k, step in enumerate(steps):
        odometry[k + 1] = compose(odometry[k], step)
    found = calibrate(odometry, times, poses, GOOD, GOOD, reversible=False)
    assert abs(found.lag_scans + found.lag_s / 0.2) < 0.2


@pytest.mark.parametrize("seed", range(5))
def test_long_ways_straight_ahead_and_slips_do_not_hide_the_scale_of_few_turns(seed):
    """Twelve corners on a kilometre; what the odometry counts straight ahead is noise."""
    rng = np.random.default_rng(seed)
    n = 6000
    turns = np.zeros(n)
    for corner in range(12):
        turns[500 * corner : 500 * corner + 7] = np.pi / 14 * (1 if corner % 3 else -1)
    steps = np.column_stack([np.full(n, 0.16), np.zeros(n), turns])
    counted = steps.copy()
    counted[:, 2] = 0.98 * turns + rng.normal(0.0, 0.003, n) + 0.05 * np.abs(turns) * rng.normal(size=n)
    slips = rng.random(n) < 0.001
    counted[slips, 2] += np.radians(10.0) * rng.normal(size=int(slips.sum()))
    seen = steps + rng.normal(0.0, 1.0, steps.shape) * [0.005, 0.005, 0.0005]
    odometry, matched = _chained(counted), _chained(seen)
    good = np.ones(n + 1, dtype=bool)
    found = calibrate(odometry, np.arange(n + 1) * 0.2, matched, good, good, reversible=False)
    assert found.rotation_scale == pytest.approx(1.0 / 0.98, abs=0.02)
    assert found.lag_scans == 0.0


def _chained(steps):
    """Poses after each step."""
    poses = np.zeros((len(steps) + 1, 3))
    for k, step in enumerate(steps):
        poses[k + 1] = compose(poses[k], step)
    return poses


@pytest.mark.parametrize("seed", range(5))
def test_a_lag_is_only_seen_in_turns(seed):
    """Straight ahead the match follows noise of the odometry, half of it a step late, and turns only once."""
    rng = np.random.default_rng(seed)
    n = 4000
    noise = rng.normal(0.0, 0.004, n)
    turns = np.zeros(n)
    turns[2000:2007] = np.pi / 14
    steps = np.column_stack([np.full(n, 0.16), np.zeros(n), turns])
    counted, seen = steps.copy(), steps.copy()
    counted[:, 2] += noise
    seen[:, 2] += 0.25 * (noise + np.roll(noise, 1))
    good = np.ones(n + 1, dtype=bool)
    times_s = np.arange(n + 1) * 0.2
    found = calibrate(_chained(counted), times_s, _chained(seen), good, good, reversible=False)
    assert found.lag_scans == 0.0
    assert found.lag_s == 0.0
