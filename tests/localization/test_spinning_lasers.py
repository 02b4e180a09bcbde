"""Lasers that make their beams one after another while the robot moves."""

import math
from dataclasses import replace

import numpy as np
import pytest

from dynmap_cli.domain.poses import compose, interpolate
from dynmap_cli.domain.scans import single_laser_log
from dynmap_cli.localization.odometry import sound_odometry, with_sound_odometry
from dynmap_cli.localization.sensing.map_pool import make_map_pool
from dynmap_cli.localization.sensing.sensor import sweep_of
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.localization.tracking import localize_log
from dynmap_cli.simulation.run import simulate
from tests.localization.worlds import office, pose_errors

SETTINGS = LocalizationSettings()
INTERVAL_S = 0.1 / 181
FULL_CIRCLE = {
    "beams": 180,
    "fov_deg": 358.0,
    "rate_hz": 10,
    "beam_interval_s": INTERVAL_S,
    "max_range_m": 30,
    "noise_m": 0.01,
}


@pytest.fixture(scope="module")
def run():
    scenario = office(seed=6, lasers=[FULL_CIRCLE])
    robot = scenario.robot.model_copy(update={"speed_mps": 1.2, "turn_rate_degps": 90.0})
    return simulate(scenario.model_copy(update={"robot": robot}))


def two_scans(step, interval_s=INTERVAL_S):
    """A log of a robot that makes a step in a tenth of a second."""
    draw = np.random.default_rng(0)
    ranges = draw.uniform(0.5, 9.0, (2, 180)).astype(np.float32)
    ranges[:, ::7], ranges[:, 3::11] = np.nan, np.inf
    return single_laser_log(
        np.array([0, 100_000_000]),
        ranges,
        np.radians(2.0 * np.arange(180) - 179.0),
        np.array([(1.0, 2.0, 0.5), compose(np.array([1.0, 2.0, 0.5]), np.array(step))]),
        sensor_pose=(0.3, -0.1, 0.4),
        beam_interval_s=interval_s,
    )


@pytest.mark.parametrize("interval_s", [INTERVAL_S, -INTERVAL_S])
def test_each_end_is_where_it_was_seen_from_the_robot_at_that_moment(interval_s):
    log = two_scans((0.15, 0.02, 0.2), interval_s)
    sweep = sweep_of(log, 0, 30.0)
    sensor_x, sensor_y, sensor_yaw = log.sensor_poses[0].tolist()
    expected = []
    for beam, distance in enumerate(log.ranges_m[0].tolist()):
        if not math.isfinite(distance):
            continue
        elapsed_s = interval_s * (beam if interval_s > 0 else beam - 179)
        robot = np.array([0.15, 0.02, 0.2]) * elapsed_s / 0.1
        angle = sensor_yaw + log.bearings_rad[0, beam]
        x, y = sensor_x + distance * math.cos(angle), sensor_y + distance * math.sin(angle)
        cos, sin = math.cos(robot[2]), math.sin(robot[2])
        expected.append((robot[0] + cos * x - sin * y, robot[1] + sin * x + cos * y))
    np.testing.assert_allclose(sweep.ends_m(np.isfinite(sweep.ranges_m)), expected, atol=1e-9)
    assert sweep.n_returns == len(expected)


def test_a_scan_stays_as_it_is_where_nobody_knows_how_the_robot_moved():
    moving = two_scans((0.15, 0.02, 0.2))
    at_once = sweep_of(replace(moving, beam_interval_s=np.zeros(1)), 0, 30.0)
    last = replace(moving, odometry=moving.odometry[::-1].copy(), ranges_m=moving.ranges_m[::-1].copy())
    unknown = replace(moving, odometry=np.full((2, 3), np.nan))
    late = replace(moving, stamps_ns=np.array([0, 3_000_000_000]))
    for log, scan in ((last, 1), (unknown, 0), (late, 0)):
        sweep = sweep_of(log, scan, 30.0)
        assert sweep.ranges_m.tobytes() == at_once.ranges_m.tobytes()
        assert sweep.directions_rad.tobytes() == at_once.directions_rad.tobytes()


def error_m(run, log, true):
    found = localize_log(log, make_map_pool(run.true_map, (), SETTINGS), SETTINGS, seed=0)
    return float(np.mean(pose_errors(found.trajectory.poses, true)[0]))


@pytest.mark.parametrize("said_s", [INTERVAL_S, 0.0, 1e-6])
def test_a_robot_is_found_at_the_stamps_whatever_the_driver_says_of_the_beams(run, said_s):
    """The true map has its walls in the middle of cells, which is an error of 0.036 m here with any laser."""
    log, _ = with_sound_odometry(replace(run.log, beam_interval_s=np.array([said_s])), SETTINGS)
    assert log.beam_interval_s[0] == pytest.approx(INTERVAL_S, rel=0.05)
    assert log.first_beam_s[0] == 0.0
    assert error_m(run, log, run.true_poses) < 0.04
    assert error_m(run, replace(log, beam_interval_s=np.zeros(1)), run.true_poses) > 0.05


def test_sweeps_that_are_stamped_at_their_end_are_found_by_the_odometry(run):
    """The stamps, the odometry at them and the true poses are those of a tenth of a second later."""
    later = run.log.stamps_ns + 100_000_000
    known = later <= run.log.stamps_ns[-1]
    rows, at = np.flatnonzero(known), later[known]
    log = replace(
        run.log.select(rows), stamps_ns=at, odometry=interpolate(run.log.stamps_ns, run.log.odometry, at)
    )
    true = interpolate(run.log.stamps_ns, run.true_poses, at)
    sound, _ = with_sound_odometry(log, SETTINGS)
    assert sound.first_beam_s[0] == pytest.approx(-0.1, rel=0.05)
    assert error_m(run, sound, true) < 0.045
    assert error_m(run, replace(sound, first_beam_s=np.zeros(1)), true) > 0.07


@pytest.mark.parametrize(("said_s", "sweeps"), [(INTERVAL_S, 0.0), (0.0, -0.5), (1e-6, -0.5)])
def test_without_odometry_the_stamp_is_where_the_message_has_it_if_its_times_are_right_and_else_the_middle(
    run, said_s, sweeps
):
    blind = replace(
        run.log, odometry=np.full((run.log.n_scans, 3), np.nan), beam_interval_s=np.array([said_s])
    )
    drive = sound_odometry(blind.select(slice(0, 250)), SETTINGS)
    assert not drive.has_wheels
    assert drive.first_beam_s[0] == pytest.approx(sweeps * 0.1, rel=0.05)


def test_beams_that_were_made_at_once_are_not_moved_though_the_driver_says_so():
    run = simulate(office(seed=6, lasers=[{**FULL_CIRCLE, "beam_interval_s": 0.0}]))
    said = replace(run.log, beam_interval_s=np.array([INTERVAL_S]))
    assert sound_odometry(said, SETTINGS).beam_interval_s[0] == 0.0
