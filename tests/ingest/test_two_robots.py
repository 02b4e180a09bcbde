"""Two robots that publish on one topic."""

import math

import numpy as np
import pytest

from dynmap_cli.errors import LogError
from tests.ingest.rooms import Room
from tests.ingest.test_choices import read
from tests.ingest.written import ODOMETRY, PERIOD_NS, SCAN, TF, odometry, scan, transform


def messages_of(topic, world, poses, after_ns):
    """Odometry on a topic, or in tf, some time after each scan."""
    found = []
    for stamp_ns, (x, y, yaw) in zip((world.stamps_ns + after_ns).tolist(), poses.tolist(), strict=True):
        values = (x, y, 0.0, 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
        if topic == "/tf":
            fields = {"transforms": [transform("odom", "base_link", stamp_ns, values)]}
            found.append((topic, TF, stamp_ns, fields))
        else:
            found.append((topic, ODOMETRY, stamp_ns, odometry("odom", "base_link", stamp_ns, values)))
    return found


def mounted(world):
    values = world.mounting
    return (
        "/tf_static",
        TF,
        world.start_ns - 1,
        {"transforms": [transform("base_link", "laser", 0, values)]},
    )


@pytest.mark.parametrize("topic", ["/tf", "/odom"])
@pytest.mark.parametrize("is_second", [False, True])
def test_of_two_tracks_that_which_turns_as_the_scans_do_is_used(topic, is_second, tmp_path):
    world = Room(with_tf=False, with_odometry=False)
    other = np.column_stack([world.poses[:, 0] * 0.5, world.poses[:, 1] - 9.0, np.linspace(0.0, 2.0, 120)])
    after_ns = (30_000_000, 0) if is_second else (0, 30_000_000)
    both = [
        *messages_of(topic, world, world.poses, after_ns[0]),
        *messages_of(topic, world, other, after_ns[1]),
    ]
    world.extra = [mounted(world), *sorted(both, key=lambda message: message[2])]
    log, report = read(tmp_path, world)
    assert "jump between two tracks, 9.0 m apart" in report.warnings[0]
    assert report.odometry == ("tf odom -> base_link" if topic == "/tf" else "/odom")
    off = log.odometry - world.poses[-log.n_scans :]
    assert np.abs(off[np.isfinite(off).all(axis=1)]).max() < 0.1
    assert log.has_odometry.mean() > 0.95


def test_tracks_of_which_neither_turns_as_the_scans_do_are_not_used(tmp_path):
    world = Room(with_tf=False, with_odometry=False)
    straight = np.column_stack([0.05 * np.arange(120), np.zeros((120, 2))])
    both = [
        *messages_of("/odom", world, straight, 0),
        *messages_of("/odom", world, straight + np.array([0.0, 9.0, 0.0]), 30_000_000),
    ]
    world.extra = [mounted(world), *sorted(both, key=lambda message: message[2])]
    _, report = read(tmp_path, world)
    assert "neither is used" in report.warnings[0]
    assert report.odometry == "none"


def test_an_odometry_that_is_reset_once_has_one_track(tmp_path):
    world = Room(with_tf=False, with_odometry=False)
    reset = world.poses.copy()
    reset[60:, 0] -= 7.0
    world.extra = [mounted(world), *messages_of("/odom", world, reset, 0)]
    _, report = read(tmp_path, world)
    assert report.odometry == "/odom"
    assert not any("two tracks" in line for line in report.warnings)


def test_tracks_are_told_where_the_messages_of_each_robot_come_in_bursts(tmp_path):
    world = Room(with_tf=False, with_odometry=False)
    other = np.column_stack([world.poses[:, 0] * 0.5, world.poses[:, 1] - 9.0, np.linspace(0.0, 2.0, 120)])
    both = []
    for number, poses in enumerate((world.poses, other)):
        for topic, kind, stamp_ns, fields in messages_of("/odom", world, poses, 30_000_000 * number):
            burst_ns = 20 * PERIOD_NS * ((stamp_ns - world.start_ns) // (20 * PERIOD_NS))
            both.append((topic, kind, world.start_ns + burst_ns + 10**9 * number, fields))
    world.extra = [mounted(world), *sorted(both, key=lambda message: message[2])]
    log, report = read(tmp_path, world)
    assert any("jump between two tracks, 9.0 m apart" in line for line in report.warnings)
    off = log.odometry - world.poses[-log.n_scans :]
    assert np.abs(off[np.isfinite(off).all(axis=1)]).max() < 0.1


@pytest.mark.parametrize("every", [5, 7, 10])
def test_that_a_second_robot_sends_scans_now_and_then_is_said(every, tmp_path):
    world = Room()
    for number in range(3, world.n_scans, every):
        stamp_ns = int(world.stamps_ns[number]) + PERIOD_NS // 2
        fields = scan(world, stamp_ns, np.roll(world.ranges_m[number // 4], 40))
        world.extra.append(("/scan", SCAN, stamp_ns + 1000, fields))
    _, report = read(tmp_path, world)
    assert any(
        "a second robot or laser publishes on the topic now and then" in line for line in report.warnings
    )


@pytest.mark.parametrize("every", [5, 10, 20])
def test_scans_with_stamps_of_others_are_no_second_robot(every, tmp_path):
    world = Room()
    late = {number: number + 4 for number in range(3, world.n_scans - 5, every)}

    def change(number, fields):
        fields["ranges"] = world.ranges_m[late.get(number, number)]

    world.change = change
    _, report = read(tmp_path, world)
    assert not any("second robot" in line for line in report.warnings)


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, 7.9])
@pytest.mark.parametrize("every", [2, 3, 10, 20])
def test_a_laser_that_drops_out_now_and_then_is_no_second_robot(value, every, tmp_path):
    world = Room()

    def change(number, fields):
        if number % every == 1:
            fields["ranges"] = np.full_like(fields["ranges"], value)

    world.change = change
    log, report = read(tmp_path, world)
    assert log.n_scans >= world.n_scans // 2
    assert not any("second robot" in line for line in report.warnings)


def test_scans_of_two_robots_in_turn_are_refused(tmp_path):
    world, far = Room(), Room(skipped=60)
    world.extra = [
        ("/scan", SCAN, stamp_ns + 1000, scan(world, stamp_ns, ranges_m))
        for stamp_ns, ranges_m in zip(
            (world.stamps_ns + PERIOD_NS // 2).tolist(), np.roll(far.ranges_m, 40, axis=1), strict=True
        )
    ]
    with pytest.raises(LogError, match="two robots or lasers publish on one topic under one frame"):
        read(tmp_path, world)
