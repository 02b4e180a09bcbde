"""An odometry that starts at its origin again while a recording is made."""

import numpy as np
import pytest

from dynmap_cli.domain.poses import between, compose
from dynmap_cli.ingest.choices.restarts import join_restarts
from dynmap_cli.ingest.raw.laser import ScanShape
from dynmap_cli.ingest.raw.recording import RawOdometry, RawRecording
from tests.ingest.rooms import Room
from tests.ingest.test_choices import read
from tests.ingest.written import ODOMETRY, PERIOD_NS, TF, odometry


class Restarted(Room):
    """A room in which the odometry is started anew before some scans."""

    restarts = (60,)
    is_exact = True

    @property
    def poses(self):
        poses = super().poses.copy()
        whole = poses.copy()
        for first in self.restarts:
            origin = whole[first].copy()
            if not self.is_exact:
                origin[:2] -= 0.004
            poses[first:] = between(np.broadcast_to(origin, whole[first:].shape), whole[first:])
        return poses

    @property
    def ranges_m(self):
        return Room(n_scans=self.n_scans).ranges_m


@pytest.mark.parametrize(
    ("restarts", "is_exact"),
    [
        ((60,), True),
        ((60,), False),
        ((40, 80), True),
        ((40, 80), False),
        ((6,), True),
        ((15, 30, 45, 60, 75, 90, 105), True),
    ],
)
@pytest.mark.parametrize("source", ["tf", "odometry"])
def test_poses_go_on_from_where_they_were(source, restarts, is_exact, tmp_path):
    world = Restarted(with_tf=source == "tf", with_odometry=source == "odometry")
    world.restarts, world.is_exact = restarts, is_exact
    log, report = read(tmp_path, world)
    (line,) = [line for line in report.warnings if "started anew" in line]
    assert line.count(" deg at t = ") == min(len(restarts), 4)
    assert ("3 times more, the last at t = 10.5 s" in line) == (len(restarts) == 7)
    assert f"at t = {restarts[0] / 10:.1f} s" in line
    np.testing.assert_allclose(log.odometry[: restarts[0]], Room().poses[: restarts[0]], atol=1e-6)
    steps = [between(poses[:-1], poses[1:]) for poses in (log.odometry, Room().poses)]
    is_joint = np.isin(np.arange(119), np.array(restarts) - 1)
    np.testing.assert_allclose(steps[0][~is_joint], steps[1][~is_joint], atol=1e-6)
    np.testing.assert_allclose(steps[0][is_joint], steps[1][is_joint], atol=0.02)


def test_a_robot_that_drives_back_through_its_origin_was_not_restarted(tmp_path):
    class Returning(Room):
        @staticmethod
        def poses_at(numbers):
            x = 0.05 * np.abs(numbers - 60.0)
            return np.column_stack([x, np.zeros((x.size, 2))])

    _, report = read(tmp_path, Returning())
    assert not any("anew" in line for line in report.warnings)


def test_fast_poses_far_apart_that_pass_the_origin_were_not_restarted(tmp_path):
    class Fast(Room):
        @staticmethod
        def poses_at(numbers):
            return np.column_stack([0.5 * (numbers - 60.0), np.full((numbers.size, 2), 0.005)])

    _, report = read(tmp_path, Fast(first_rad=-0.2, step_rad=0.003))
    assert not any("anew" in line for line in report.warnings)


class Standing(Room):
    """Stands at its exact origin for a second, then drives."""

    @staticmethod
    def poses_at(numbers):
        driven = Room.poses_at(np.arange(numbers.size))
        driven = between(np.broadcast_to(driven[0], driven.shape), driven)
        return driven[np.maximum(numbers - 10, 0)]


class Late(Standing):
    """Some poses reach the recorder late, under their own stamps."""

    late, late_s = (0, 1, 2, 3), 4.0

    def messages(self):
        told, counts = [], {}
        for topic, kind, logged_ns, fields in super().messages():
            number = counts[topic] = counts.get(topic, -1) + 1
            is_late = kind in {ODOMETRY, TF} and topic != self.static_topic and number in self.late
            told.append((topic, kind, logged_ns + is_late * int(self.late_s * 1e9), fields))
        return sorted(told, key=lambda message: message[2])


@pytest.mark.parametrize(("late", "late_s"), [((0, 1, 2, 3), 4.0), ((3,), 1.5), ((9,), 3.0), ((2, 7), 3.0)])
@pytest.mark.parametrize("source", ["tf", "odometry"])
def test_poses_that_reach_the_recorder_late_were_not_restarted(source, late, late_s, tmp_path):
    world = Late(with_tf=source == "tf", with_odometry=source == "odometry")
    world.late, world.late_s = late, late_s
    log, report = read(tmp_path, world)
    assert not any("anew" in line for line in report.warnings)
    np.testing.assert_allclose(log.odometry, world.poses, atol=1e-6)


@pytest.mark.parametrize("has_own_stamps", [False, True])
def test_a_second_publisher_that_lags_behind_was_not_restarted(has_own_stamps, tmp_path):
    class Faster(Standing):
        @staticmethod
        def poses_at(numbers):
            return Standing.poses_at(numbers) * (1.7, 1.7, 1.0)

    world = Faster(with_tf=False)
    late_ns = 500_000_000
    for stamp_ns, (x, y, yaw) in zip(world.stamps_ns.tolist(), world.poses, strict=True):
        values = (x, y, 0.0, 0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))
        stamped_ns = stamp_ns + has_own_stamps * (late_ns + PERIOD_NS // 3)
        fields = odometry("odom", "base_link", stamped_ns, values)
        world.extra.append(("/odom", ODOMETRY, stamp_ns + late_ns, fields))
    log, report = read(tmp_path, world)
    assert not any("anew" in line for line in report.warnings)
    if not has_own_stamps:
        np.testing.assert_allclose(log.odometry, world.poses, atol=1e-6)


def recorded(poses, period_ns=PERIOD_NS, order=None):
    """A recording of nothing but poses (n, 3), in an order."""
    recording, source = RawRecording("a.bag", "bag"), RawOdometry("/odom")
    for number in np.arange(len(poses)) if order is None else order:
        stamp_ns = period_ns * int(number)
        source.add(stamp_ns, stamp_ns, tuple(poses[number]))
    recording.odometry["/odom"] = source
    return recording


def joined(*given, **options):
    """Poses (n, 3) by their stamps after restarts were looked for, and what was said."""
    recording = recorded(*given, **options)
    join_restarts(recording)
    return recording.odometry["/odom"].as_arrays()[1], recording.warnings


@pytest.mark.parametrize("world", [Standing(), Restarted()])
def test_the_order_of_recording_changes_nothing(world):
    in_order, told = joined(world.poses)
    order = np.random.default_rng(7).permutation(len(world.poses))
    shuffled, told_shuffled = joined(world.poses, order=order)
    np.testing.assert_array_equal(shuffled, in_order)
    assert told_shuffled == told
    assert len(told) == isinstance(world, Restarted)


@pytest.mark.parametrize("n_wrong", [1, 2, 4, 8, 30])
@pytest.mark.parametrize("first", [5, 40, 61])
def test_poses_at_the_origin_that_the_old_track_comes_after_were_not_restarted(first, n_wrong):
    poses = Room().poses + np.array([1.0, -0.5, 0.0])
    poses[first : first + n_wrong] = 0.0
    found, told = joined(poses)
    assert not told
    np.testing.assert_array_equal(found, poses)


def test_a_second_driver_that_is_started_for_a_while_is_no_restart():
    poses = Room().poses + np.array([1.0, -0.5, 0.0])
    poses[50:60] = between(np.broadcast_to(poses[50], (10, 3)), poses[50:60])
    found, told = joined(poses)
    assert not told
    np.testing.assert_array_equal(found, poses)


@pytest.mark.parametrize("n_poses", [70, 200])
@pytest.mark.parametrize("speed_m_s", [0.7, 1.5, 3.0])
def test_a_shuttle_that_passes_its_exact_origin_was_not_restarted(speed_m_s, n_poses):
    ways = np.abs((np.arange(n_poses) + 10) % 40 - 20) - 10.0
    poses = np.column_stack([0.5 * speed_m_s * ways, np.zeros((ways.size, 2))])
    found, told = joined(poses, 5 * PERIOD_NS)
    assert not told
    np.testing.assert_array_equal(found, poses)


def test_slow_odometry_of_a_fast_robot_is_mended():
    whole = np.column_stack([0.75 * np.arange(40), np.zeros((40, 2))])
    poses = compose(np.array([0.0, 0.0, 0.2]), whole)
    poses[20:] = between(np.broadcast_to(poses[20], (20, 3)), poses[20:])
    found, (line,) = joined(poses, 5 * PERIOD_NS)
    assert "/odom from 14.25 m and 11 deg" in line
    np.testing.assert_allclose(found, compose(np.array([0.0, 0.0, 0.2]), whole), atol=1e-9)


def test_a_thousand_restarts_are_said_and_left():
    run = np.column_stack([0.1 * np.arange(8), np.zeros((8, 2))])
    poses = np.tile(run, (1100, 1))
    found, (line,) = joined(poses)
    assert "/odom was started anew 1000 times in its first 1000 of 1099 returns to its origin" in line
    np.testing.assert_array_equal(found, poses)
    found, (line,) = joined(poses[: 8 * 20])
    assert "15 times more" in line
    np.testing.assert_allclose(found[:, 0], 0.1 * np.arange(160), atol=1e-9)


@pytest.mark.parametrize(("first_sweep", "is_said"), [(0, True), (80, False)])
def test_what_an_odometry_did_before_the_first_sweep_does_not_matter(first_sweep, is_said):
    poses = np.zeros((160, 3))
    poses[:80, 0] = 0.1 * np.arange(80) + 0.1
    poses[80:, 0] = 0.1 * np.arange(80)
    recording = recorded(poses)
    sweeps_ns = PERIOD_NS * np.arange(first_sweep, 160)
    laser = recording.laser("/scan")
    for stamp_ns in sweeps_ns.tolist():
        laser.add(stamp_ns, stamp_ns, np.ones(9, dtype=np.float32), ScanShape(-1.0, 0.25, 9, 0.1, 8.0))
    join_restarts(recording)
    assert bool(recording.warnings) == is_said
