"""When sweeps were made, and how the robot moved during them."""

import numpy as np

from dynmap_cli.domain.poses import compose
from dynmap_cli.domain.sweep_motion import steady_times_s, sweep_twists

PERIOD_S, N = 0.2, 200


def test_stamps_that_jitter_are_straightened():
    true_s = np.arange(N) * PERIOD_S
    late_s = np.random.default_rng(3).uniform(0.0, 0.5 * PERIOD_S, N)
    times_s = steady_times_s(np.sort(true_s + late_s))
    assert (np.diff(times_s) > 0.0).all()
    # What is late on average stays: it is a lag.
    assert np.std(times_s - true_s) < 0.3 * np.std(late_s)
    assert np.std(np.diff(times_s)) < 0.1 * np.std(np.diff(true_s + late_s))


def test_a_pause_is_no_jitter():
    true_s = np.arange(N) * PERIOD_S
    true_s[100:] += 5.0
    stamps_s = np.sort(true_s + np.random.default_rng(3).uniform(0.0, 0.5 * PERIOD_S, N))
    assert abs(np.diff(steady_times_s(stamps_s))[99] - 5.0 - PERIOD_S) < 0.5 * PERIOD_S


def test_good_stamps_stay_as_they_are():
    slower = np.cumsum(np.linspace(0.1, 0.2, N))
    left_out = np.delete(np.arange(N) * PERIOD_S, np.arange(5, N, 9))
    for times_s in (np.arange(N) * PERIOD_S, slower, left_out, np.zeros(N), np.zeros(0)):
        np.testing.assert_array_equal(steady_times_s(times_s), times_s)


def _circle(n):
    """Poses of a robot on a circle: the same velocity all the time."""
    poses = np.zeros((n, 3))
    for k in range(1, n):
        poses[k] = compose(poses[k - 1], np.array([0.05, 0.0, 0.1]))
    return poses


def test_the_velocity_is_that_of_the_path():
    twists = sweep_twists(np.arange(50) * 0.1, _circle(50), np.full(50, 0.1), np.zeros(50, dtype=np.int64))
    np.testing.assert_allclose(twists[2:-3, 2], 1.0, atol=1e-9)
    np.testing.assert_allclose(twists[2:-3, 0], 0.5, rtol=0.01)
    np.testing.assert_allclose(twists[2:-3, 1], 0.0, atol=1e-9)


def test_lasers_that_disagree_feign_no_velocity():
    poses = np.zeros((100, 3))
    poses[1::2, 0] = 0.02
    series = np.arange(100) % 2
    twists = sweep_twists(np.arange(100) * 0.05, poses, np.full(100, 0.1), series.astype(np.int64))
    np.testing.assert_array_equal(twists, 0.0)


def test_no_velocity_across_a_pause_or_without_a_pose():
    times_s = np.arange(20) * 0.1
    times_s[10:] += 10.0
    poses = _circle(20)
    poses[5] = np.nan
    twists = sweep_twists(times_s, poses, np.full(20, 0.1), np.zeros(20, dtype=np.int64))
    np.testing.assert_array_equal(twists[[5, 9]], 0.0)
    assert np.isfinite(twists).all()
