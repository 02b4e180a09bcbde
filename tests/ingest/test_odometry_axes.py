"""Odometry whose positions and headings do not go together, and the motion that sweeps show."""

import itertools
import math

import numpy as np
import pytest

from dynmap_cli.domain.poses import between, wrap_angle
from dynmap_cli.ingest.seen_motion.range_flow import range_flow
from tests.ingest.corridors import Corridor, mended
from tests.ingest.rooms import Room, seen_from
from tests.ingest.test_choices import read
from tests.ingest.test_clock_offsets import with_poses
from tests.reference import seen_motion

QUARTER = math.pi / 2

FAULTS = {
    "x and y exchanged": lambda x, y, yaw: (y, x, yaw),
    "a quarter turn": lambda x, y, yaw: (x, y, yaw + QUARTER),
    "a quarter turn back": lambda x, y, yaw: (x, y, yaw - QUARTER),
    "half a turn": lambda x, y, yaw: (x, y, yaw + math.pi),
    "y to the right": lambda x, y, yaw: (x, -y, yaw),
    "headings clockwise": lambda x, y, yaw: (x, y, -yaw),
    "north is x, clockwise": lambda x, y, yaw: (y, x, QUARTER - yaw),
}


class Slow(Room):
    """Turns less from scan to scan, and drives longer."""

    @staticmethod
    def poses_at(numbers):
        time_s = 0.1 * numbers
        yaw_rad = 1.4 * np.sin(0.4 * time_s) + 0.5 * np.sin(0.23 * time_s)
        steps = 0.03 * np.column_stack([np.cos(yaw_rad), np.sin(yaw_rad)])
        return np.column_stack([np.cumsum(steps, axis=0), yaw_rad])


def axis_warnings(report):
    return [line for line in report.warnings if "its positions go" in line]


@pytest.mark.parametrize("change", FAULTS.values(), ids=FAULTS)
def test_positions_and_headings_are_brought_together_as_the_scans_show(change, tmp_path):
    world = with_poses(Slow(n_scans=200), change)
    log, report = read(tmp_path, world)
    if change(1.0, 2.0, 0.5) == (2.0, 1.0, QUARTER - 0.5):
        # All is turned over, so that positions fit headings; the turns of the sweeps say that something is.
        assert not axis_warnings(report)
        assert "turn left where the odometry turns right" in " ".join(report.warnings)
        return
    (line,) = axis_warnings(report)
    assert "mended" in line
    assert not report.lasers[0].upside_down
    found, right = (between(poses[:-1], poses[1:]) for poses in (log.odometry, world.poses))
    np.testing.assert_allclose(found, right, atol=1e-6)


def test_a_robot_that_really_drives_sideways_and_back_is_believed(tmp_path):
    class Sideways(Slow):
        @staticmethod
        def poses_at(numbers):
            poses = Slow.poses_at(numbers)
            way_rad = poses[:, 2] + 1.6 + 0.4 * np.sin(0.3 * numbers)
            steps = 0.03 * np.column_stack([np.cos(way_rad), np.sin(way_rad)])
            return np.column_stack([np.cumsum(steps, axis=0), poses[:, 2]])

    world = Sideways(n_scans=150)
    log, report = read(tmp_path, world)
    assert not axis_warnings(report)
    np.testing.assert_allclose(log.odometry, world.poses, atol=1e-6)


def test_the_laser_may_be_turned_on_the_robot(tmp_path):
    mounting = (0.2, -0.1, 0.3, 0.0, 0.0, math.sin(0.6), math.cos(0.6))

    def turned(_number, fields):
        fields["angle_min"] -= 1.2
        fields["angle_max"] -= 1.2

    world = with_poses(Slow(n_scans=200, mounting=mounting, change=turned), FAULTS["x and y exchanged"])
    log, report = read(tmp_path, world)
    assert "mended" in axis_warnings(report)[0]
    found, right = (between(poses[:-1], poses[1:]) for poses in (log.odometry, world.poses))
    np.testing.assert_allclose(found, right, atol=1e-6)


@pytest.mark.parametrize("missing", [0.0, 0.1])
def test_the_flow_of_ranges_is_the_motion_of_the_laser(missing):
    world = Slow(n_scans=200, mounting=(0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 1.0))
    bearings_rad = world.first_rad + world.step_rad * np.arange(world.n_beams)
    ranges_m, poses = world.ranges_m.astype(np.float64), world.poses
    ranges_m[np.random.default_rng(2).random(ranges_m.shape) < missing] = np.nan
    moved, turned_rad, is_known = range_flow(ranges_m[:-2], ranges_m[2:], bearings_rad)
    right = between(poses[:-2], poses[2:])
    is_slow = is_known & (np.abs(right[:, 2]) < 0.1)
    assert np.count_nonzero(is_slow) > 50
    off_m = np.abs(moved - (right[:, 0] + 1j * right[:, 1]))[is_slow]
    assert np.median(off_m) < 0.01
    assert np.median(np.abs(wrap_angle(turned_rad - right[:, 2]))[is_slow]) < 0.01


@pytest.mark.parametrize("noise_m", [0.0, 0.01, 0.05])
def test_the_flow_of_ranges_and_what_stands_out_are_those_of_the_plain_search(noise_m):
    """Along a corridor with a few people the noise of the walls is most of what there is."""
    drive = Corridor(people_per_m=0.1, noise_m=0.0)
    rng, bearings_rad = np.random.default_rng(3), np.linspace(-3.1, 3.1, 361)
    corridor = np.where(np.isfinite(drive.sweeps()), drive.sweeps(), np.nan)[::20, :].astype(np.float64)
    steps = np.arange(9.0)[:, None]
    room = seen_from(steps * (0.05, 0.01), 0.02 * steps + bearings_rad)
    ranges_m = np.concatenate([corridor, room.astype(np.float64)])
    ranges_m += rng.normal(0.0, noise_m, ranges_m.shape)
    moved, turned_rad, is_known = range_flow(ranges_m[:-1], ranges_m[1:], bearings_rad)
    plain = [
        seen_motion.range_flow(before, after, bearings_rad, reach=1)
        for before, after in itertools.pairwise(ranges_m)
    ]
    assert is_known.tolist() == [one for _, one in plain]
    found = np.column_stack([moved.real, moved.imag, turned_rad])
    np.testing.assert_allclose(found[is_known], [motion for motion, one in plain if one], atol=1e-6)
    assert is_known[-8:].sum() >= 6
    assert is_known[:15].any() == (noise_m == 0.0)


def test_a_corridor_does_not_say_how_far_the_laser_moved_along_it():
    bearings_rad = np.linspace(-3.0, 3.0, 181)
    with np.errstate(divide="ignore"):
        ranges_m = 1.5 / np.abs(np.sin(bearings_rad))
    ranges_m[ranges_m > 12.0] = np.nan
    _, _, is_known = range_flow(ranges_m[None], ranges_m[None], bearings_rad)
    assert not is_known.any()


def test_positions_that_nothing_simple_mends_are_said_and_left(tmp_path):
    """Its frame turns all the while, as where headings are mended by a compass and positions are not."""

    class Twisted(Slow):
        @staticmethod
        def twisted(poses):
            steps = np.diff(poses[:, :2], axis=0, prepend=0.0) @ np.array([1.0, 1j])
            way = np.cumsum(steps * np.exp(1j * np.linspace(0.5, 6.0, len(poses))))
            return np.column_stack([way.real, way.imag, poses[:, 2]])

    world = Twisted(n_scans=200)
    wrong = Twisted.twisted(world.poses)
    told = iter(wrong.tolist())
    log, report = read(tmp_path, with_poses(world, lambda *_: next(told)))
    (line,) = axis_warnings(report)
    assert "nothing simple mends that; if the map comes out bent, pass --odom none" in line
    np.testing.assert_allclose(log.odometry, wrong, atol=1e-6)


HEADINGS = {"reversing": math.pi, "crabbing": QUARTER}


@pytest.mark.parametrize("walk_mps", [0.4, 0.8, 1.3])
@pytest.mark.parametrize("yaw_rad", HEADINGS.values(), ids=HEADINGS)
def test_people_who_walk_along_with_the_robot_do_not_turn_its_odometry(yaw_rad, walk_mps):
    drive = Corridor(yaw_rad=yaw_rad, people_per_m=0.1, walk_mps=walk_mps)
    poses, said = mended(drive.poses, drive.sweeps())
    assert not said
    np.testing.assert_array_equal(poses, drive.poses)


@pytest.mark.parametrize("noise_m", [0.01, 0.03])
@pytest.mark.parametrize("yaw_rad", HEADINGS.values(), ids=HEADINGS)
def test_noise_along_a_bare_corridor_says_nothing_of_the_odometry(yaw_rad, noise_m):
    drive = Corridor(60.0, 2.0, 0.5, yaw_rad, noise_m=noise_m)
    poses, said = mended(drive.poses, drive.sweeps())
    assert not said
    np.testing.assert_array_equal(poses, drive.poses)


def test_a_short_corridor_still_tells_that_positions_go_sideways():
    drive = Corridor(length_m=24.0)
    wrong = drive.poses + np.array([0.0, 0.0, QUARTER])
    poses, said = mended(wrong, drive.sweeps())
    assert "mended" in said[0]
    np.testing.assert_allclose(poses, drive.poses, atol=1e-6)
