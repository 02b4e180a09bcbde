"""Freezes and slips are found where they were made, and registration does without the wheels there."""

from dataclasses import replace

import numpy as np
import pytest

from dynmap_cli.domain.poses import between, compose
from dynmap_cli.mapping.settings import MapSettings
from dynmap_cli.mapping.site import Site
from dynmap_cli.scan_matching.wheel_faults import (
    find_wheel_faults,
    jumps_while_lost,
    suspicious_stops,
    without_steps,
)
from dynmap_cli.simulation import parse_scenario, simulate

TIMES = np.arange(600) * 0.2
NEVER = np.zeros(600, dtype=bool)


def chained(steps):
    poses = np.zeros_like(steps)
    for k in range(1, len(steps)):
        poses[k] = compose(poses[k - 1], steps[k])
    return poses


def drive(seed=0):
    """Steps of a smooth drive with turns, standing from 300 to 350."""
    rng = np.random.default_rng(seed)
    steps = np.column_stack([np.full(600, 0.1), np.zeros(600), 0.05 * np.sin(np.arange(600) / 15)])
    steps[300:350] = 0.0
    return steps, chained(steps + rng.normal(0, 1, steps.shape) * [0.002, 0.002, 0.001])


@pytest.mark.parametrize("seed", range(4))
def test_good_wheels_and_a_robot_that_stands_are_no_fault(seed):
    steps, poses = drive(seed)
    assert find_wheel_faults(steps, TIMES, poses, NEVER, reversible=False) == []
    assert find_wheel_faults(steps, TIMES, poses, NEVER, reversible=True) == []


def test_a_freeze_is_found_with_its_times():
    steps, poses = drive()
    steps[100:125] = 0.0
    (fault,) = find_wheel_faults(steps, TIMES, poses, NEVER, reversible=False)
    assert fault.is_frozen
    assert abs(fault.start_s - 19.8) < 0.5
    assert abs(fault.end_s - 24.8) < 0.5
    assert abs(fault.scans_m - 2.5) < 0.2
    assert set(range(100, 125)) <= set(fault.steps)
    trusted = without_steps(steps, [fault.steps])
    assert np.isnan(trusted[100:125]).all()
    assert np.isfinite(trusted[:99]).all()
    assert np.isfinite(trusted[127:]).all()


@pytest.mark.parametrize("extra", [(0.8, 0.0, 0.0), (0.0, 0.0, 0.5)])
def test_a_slip_is_found_with_its_time(extra):
    steps, poses = drive()
    steps[200:203] += np.array(extra) / 3
    (fault,) = find_wheel_faults(steps, TIMES, poses, NEVER, reversible=False)
    assert not fault.is_frozen
    assert fault.start_s <= 40.0 <= fault.end_s + 0.2
    assert fault.end_s - fault.start_s < 1.5
    assert {200, 201, 202} <= set(fault.steps)
    assert len(fault.steps) <= 5


def test_a_stop_is_suspicious_only_where_scans_fit_worse():
    steps, _ = drive()
    shares = np.full(600, 0.9)
    assert suspicious_stops(steps, TIMES, shares) == []
    shares[300:350] = 0.7
    (stop,) = suspicious_stops(steps, TIMES, shares)
    assert set(range(300, 350)) <= set(stop)


@pytest.mark.parametrize("extra", [(0.2, 0.0, 0.0), (0.0, 0.0, -0.15)])
def test_wheels_that_jump_are_unsure_only_where_scans_are_lost(extra):
    steps, _ = drive()
    is_lost = NEVER.copy()
    is_lost[[100, 101, 200, 201, 202]] = True
    assert jumps_while_lost(steps, is_lost) == []
    steps[[150, 201]] += extra
    # To the step that jumped, and back from it.
    assert jumps_while_lost(steps, is_lost) == [(201, 202)]
    assert jumps_while_lost(steps, NEVER) == []
    assert jumps_while_lost(np.full((600, 3), np.nan), is_lost) == []


def test_lost_scans_say_nothing_about_wheels():
    steps, poses = drive()
    is_lost = NEVER.copy()
    is_lost[200:210] = True
    poses[200:210] += [3.0, 0.0, 0.0]
    assert find_wheel_faults(steps, TIMES, poses, is_lost, reversible=False) == []


def test_without_odometry_there_is_no_fault():
    _, poses = drive()
    assert find_wheel_faults(np.full((600, 3), np.nan), TIMES, poses, NEVER, reversible=False) == []
    assert find_wheel_faults(np.zeros((1, 3)), TIMES[:1], poses[:1], NEVER[:1], reversible=False) == []


OFFICE = {
    "world": {
        "walls": [
            {"points": [[0, 0], [14, 0], [14, 9], [0, 9]], "closed": True},
            [[0, 4], [3, 4]],
            [[4, 4], [9, 4]],
            [[10, 4], [14, 4]],
            [[11, 1.2], [11, 2.2]],
        ]
    },
    "robot": {"path": [[1.5, 2], [8, 1.5], [12.5, 2.8], [8, 2], [2, 2], [6, 1], [1, 1.5]], "speed_mps": 0.6},
    "lasers": [{"noise_m": 0.02, "rate_hz": 5}],
}


def test_registration_does_without_odometry_that_stands_still():
    """For 5 s the wheels count nothing while the robot drives 3 m along a room with hardly anything ahead."""
    run = simulate(parse_scenario(OFFICE))
    seconds = (run.log.stamps_ns - run.log.stamps_ns[0]) / 1e9
    steps = np.zeros_like(run.log.odometry)
    steps[1:] = between(run.log.odometry[:-1], run.log.odometry[1:])
    steps[(seconds >= 3.0) & (seconds < 8.0)] = 0.0
    site = Site(replace(run.log, odometry=chained(steps)), MapSettings(max_rounds=1))
    poses = site.poses(None, "")
    (fault,) = site.drives[0].wheel_faults
    assert fault.is_frozen
    assert abs(fault.start_s - 3.0) < 0.5
    assert abs(fault.end_s - 8.0) < 0.5
    error = poses - between(run.true_poses[0], run.true_poses)
    assert np.hypot(error[:, 0], error[:, 1]).max() < 0.1


OPEN = {
    "world": {"walls": [[[38, -2], [38, 2]], [[34, 8], [35, 11]], [[30, -12], [32, -12]]]},
    "robot": {"path": [[0, 0], [14, 0]], "speed_mps": 1.0},
    "lasers": [{"beams": 241, "fov_deg": 180, "max_range_m": 50, "rate_hz": 5}],
}


@pytest.mark.parametrize(("step", "slip_deg"), [(20, 10), (35, -12)])
def test_a_slip_where_little_is_seen_does_not_turn_the_path(step, slip_deg):
    """A few returns from far away: the first scan after a slip fits nowhere, and those after it fit on it."""
    run = simulate(parse_scenario(OPEN))
    steps = np.zeros_like(run.log.odometry)
    steps[1:] = between(run.log.odometry[:-1], run.log.odometry[1:])
    steps[step, 2] += np.radians(slip_deg)
    site = Site(replace(run.log, odometry=chained(steps)), MapSettings(max_rounds=1))
    poses = site.poses(None, "")
    (fault,) = site.drives[0].wheel_faults
    assert fault.steps == (step,)
    error = poses - between(run.true_poses[0], run.true_poses)
    assert np.hypot(error[:, 0], error[:, 1]).max() < 0.3


def test_along_a_bare_corridor_the_path_is_as_long_as_the_odometry_says():
    run = simulate(
        parse_scenario(
            {
                "world": {"walls": [{"points": [[0, 0], [70, 0], [70, 2.4], [0, 2.4]], "closed": True}]},
                "robot": {"path": [[12, 1.2], [58, 1.2]]},
                "lasers": [{"max_range_m": 10.0, "rate_hz": 5}],
            }
        )
    )
    poses = Site(run.log, MapSettings(max_rounds=1)).poses(None, "")
    # The first sweeps have only one another to fit on.
    paths = (poses, run.true_poses, run.log.odometry)
    poses, true, odometry = (between(path[10], path[10:]) for path in paths)
    by_odometry = np.abs(np.linalg.norm(odometry[:, :2], axis=1) - true[:, 0]).max()
    assert np.abs(poses[:, 0] - true[:, 0]).max() < by_odometry + 0.15
    assert np.abs(poses[:, 1] - true[:, 1]).max() < 0.1
