"""Sweeps of one topic that name different frames."""

import numpy as np
import pytest

from tests.ingest.rooms import Room
from tests.ingest.test_choices import read, used
from tests.ingest.written import START_NS, TF, transform


def named(frame_of):
    """Scans whose frame is given by their number."""
    return lambda number, fields: fields["header"].update(frame_id=frame_of(number))


def sits(frame, values):
    return ("/tf_static", TF, START_NS - 1, {"transforms": [transform("base_link", frame, 0, values)]})


def test_two_lasers_on_one_topic_are_told_by_their_frames(tmp_path):
    rear = Room(mounting=(-0.4, 0.1, 0.2, 0.0, 0.0, 1.0, 0.0))
    world = Room(change=named(lambda number: "laser" if number % 2 else "rear"))
    front_ranges, rear_ranges = world.ranges_m, np.empty(0)
    rear.first_rad += np.pi
    rear_ranges = rear.ranges_m
    inner = world.change

    def change(number, fields):
        inner(number, fields)
        if number % 2 == 0:
            fields["ranges"] = rear_ranges[number]

    world.change = change
    world.extra = [sits("rear", rear.mounting)]
    log, report = read(tmp_path, world)
    assert sorted(used(report)) == ["/scan", "/scan (laser)"]
    assert "its 120 scans name several frames: 60 of them 'laser', 60 'rear'" in report.warnings[0]
    assert log.n_scans == 120
    np.testing.assert_allclose(
        log.sensor_poses[log.geometry_index[:2]], [[-0.4, 0.1, -np.pi], [0.2, -0.1, 0.0]], atol=1e-6
    )
    np.testing.assert_allclose(log.ranges_m[1], front_ranges[1], atol=1e-6)


@pytest.mark.parametrize("has_both", [False, True])
def test_a_laser_whose_frame_is_renamed_stays_one(has_both, tmp_path):
    world = Room(change=named(lambda number: "old" if number < 30 else "laser"))
    if has_both:
        world.extra = [sits("old", world.mounting)]
    log, report = read(tmp_path, world)
    assert used(report) == ["/scan"]
    assert not report.warnings
    assert any("are taken as one laser" in line for line in report.notes)
    np.testing.assert_array_equal(log.stamps_ns, world.stamps_ns)
    np.testing.assert_allclose(log.ranges_m, world.ranges_m, atol=1e-6)
    np.testing.assert_allclose(log.sensor_poses, [[0.2, -0.1, 0.0]])


def test_two_frames_at_one_place_are_one_laser(tmp_path):
    world = Room(change=named(lambda number: "laser" if number % 3 else "laser_link"))
    world.extra = [sits("laser_link", world.mounting)]
    log, report = read(tmp_path, world)
    assert used(report) == ["/scan"]
    assert not report.warnings
    assert report.out_of_order == 0
    np.testing.assert_allclose(log.ranges_m, world.ranges_m, atol=1e-6)


def test_many_frames_of_one_topic_are_damage_of_their_names(tmp_path):
    world = Room(change=named(lambda number: f"frame{number}"))
    _, report = read(tmp_path, world)
    assert len(report.lasers) <= 5
