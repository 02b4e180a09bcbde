"""Robots of others: frames, lasers and odometry that are named, joined and published in other ways."""

import math

import numpy as np
import pytest

from dynmap_cli.commands.screens import screen
from dynmap_cli.domain.poses import inverse
from tests.ingest.test_choices import read, second_laser, used, why_not
from tests.ingest.written import ODOMETRY, START_NS, TF, World, odometry, transform

POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"


def moved(parent, child, world, *, is_inverse=False):
    """Transforms of a drive between two frames."""
    messages = []
    poses = inverse(world.poses) if is_inverse else world.poses
    for stamp_ns, (x, y, yaw) in zip(world.stamps_ns.tolist(), poses.tolist(), strict=True):
        values = (x, y, 0.0, 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
        messages.append(("/tf", TF, stamp_ns, {"transforms": [transform(parent, child, stamp_ns, values)]}))
    return messages


def mounted(child="laser", parent="base_link", world=None):
    values = (world or World()).mounting
    return ("/tf_static", TF, START_NS - 1, {"transforms": [transform(parent, child, 0, values)]})


@pytest.mark.parametrize("frame", ["", "base_scan"])
def test_a_laser_whose_frame_is_not_in_the_tree_leaves_the_odometry_of_the_tree(frame, tmp_path):
    world = World(with_odometry=False, change=lambda _, fields: fields["header"].update(frame_id=frame))
    log, report = read(tmp_path, world)
    assert report.odometry == "tf odom -> base_link"
    np.testing.assert_allclose(log.odometry, world.poses, atol=1e-9)
    assert not report.lasers[0].is_pose_known
    assert "does not say where" in report.warnings[0]


def test_two_trees_that_are_not_joined_are_taken_to_be_one_robot(tmp_path):
    world = World(with_tf=False, with_odometry=False)
    world.extra = [*moved("odom", "base_footprint", world), mounted()]
    log, report = read(tmp_path, world)
    assert report.odometry_why == "transforms; 'base_footprint' taken to be 'base_link'"
    np.testing.assert_allclose(log.odometry, world.poses, atol=1e-9)
    np.testing.assert_allclose(log.sensor_poses, [[0.2, -0.1, 0.0]])


def test_an_odometry_frame_that_is_not_joined_to_the_robot_is_passed_over(tmp_path):
    world, other = World(with_tf=False, with_odometry=False), World(yaw_rad=2.0)
    world.extra = [*moved("odom_combined", "base_link", world), *moved("odom", "camera", other), mounted()]
    log, report = read(tmp_path, world)
    assert report.odometry == "tf odom_combined -> base_link"
    np.testing.assert_allclose(log.odometry, world.poses, atol=1e-9)


@pytest.mark.parametrize("combined", [False, True])
def test_odometry_that_is_written_as_the_inverse_comes_after_one_that_is_not(combined, tmp_path):
    world, other = World(with_tf=False, with_odometry=False), World(yaw_rad=2.0)
    world.extra = [*moved("base_link", "odom", other if combined else world, is_inverse=True), mounted()]
    if combined:
        world.extra += moved("odom_combined", "base_link", world)
    log, report = read(tmp_path, world)
    assert report.odometry == f"tf {'odom_combined' if combined else 'odom'} -> base_link"
    np.testing.assert_allclose(log.odometry, world.poses, atol=1e-9)


def test_a_fixed_frame_named_after_odometry_is_no_odometry(tmp_path):
    world = World(with_odometry=False)
    world.extra = [mounted("odometer")]
    assert read(tmp_path, world)[1].odometry == "tf odom -> base_link"


def test_the_robot_is_the_one_that_was_scanned_from_most(tmp_path):
    world = World(
        with_tf=False,
        with_odometry=False,
        change=lambda _, fields: fields["header"].update(frame_id="b/laser"),
    )
    world.extra = [*moved("b/odom", "b/base_link", world), mounted("b/laser", "b/base_link")]
    few = World(n_scans=5, yaw_rad=2.0)
    world.extra += [*moved("a/odom", "a/base_link", few), mounted("a/laser", "a/base_link")]
    world.extra += second_laser(few, topic="/a/scan", frame="a/laser", mounting=None)
    log, report = read(tmp_path, world)
    assert used(report) == ["/scan"]
    assert report.odometry == "tf b/odom -> b/base_link"
    np.testing.assert_allclose(log.sensor_poses, [[0.2, -0.1, 0.0]])


def drive_on(topic, world, *, child="base_link", frame="odom"):
    """Odometry messages of a drive."""
    return [
        (
            topic,
            ODOMETRY,
            stamp_ns,
            odometry(frame, child, stamp_ns, (x, y, 0.0, 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))),
        )
        for stamp_ns, (x, y, yaw) in zip(world.stamps_ns.tolist(), world.poses.tolist(), strict=True)
    ]


def test_odometry_of_the_robot_comes_before_that_of_a_frame_that_is_not_joined_to_it(tmp_path):
    world = World(with_tf=False, with_odometry=False)
    world.extra = [mounted(), *drive_on("/camera/odom", World(yaw_rad=2.0), child="camera")]
    world.extra += drive_on("/wheels/odom", world)
    log, report = read(tmp_path, world)
    assert report.odometry == "/wheels/odom"
    assert report.odometry_rejected == (
        "/camera/odom (second choice after /wheels/odom, which is nearer to the robot's frame or first by name)",
    )
    np.testing.assert_allclose(log.odometry, world.poses, atol=1e-9)


def test_ground_truth_may_be_named_by_two_letters(tmp_path):
    world = World(with_tf=False)
    world.extra = drive_on("/base_pose_gt", world)
    _, report = read(tmp_path, world)
    assert report.odometry == "/odom"
    assert report.odometry_rejected == ("/base_pose_gt (named as ground truth or localization)",)


def test_odometry_in_millimetres_is_not_used(tmp_path):
    world = World(with_tf=False, with_odometry=False)
    world.extra = drive_on("/odom", World(step_m=50.0))
    _, report = read(tmp_path, world)
    assert report.odometry == "none"
    assert report.odometry_rejected == ("/odom (it jumps 11 times between scans, by up to 50.0 m)",)


@pytest.mark.parametrize(
    ("topic", "frame", "is_odometry"),
    [("/robot_pose_ekf/odom_combined", "odom_combined", True), ("/amcl_pose", "map", False)],
)
def test_poses_with_covariance_are_odometry_where_they_are_named_so(topic, frame, is_odometry, tmp_path):
    world = World(with_tf=False, with_odometry=False)
    world.extra = [
        (topic, POSE, logged_ns, {"header": fields["header"], "pose": fields["pose"]})
        for _, _, logged_ns, fields in drive_on(topic, world, frame=frame)
    ]
    log, report = read(tmp_path, world)
    assert report.odometry == (topic if is_odometry else "none")
    assert log.has_odometry.all() == is_odometry
    if is_odometry:
        np.testing.assert_allclose(log.odometry, world.poses, atol=1e-9)
    (line,) = [line for line in screen(report) if "other topics" in line] or [""]
    assert (topic in line) != is_odometry


def test_without_transforms_a_laser_that_is_named_vertical_is_left_out(tmp_path):
    world = World(with_tf=False, n_beams=5)
    wide = World(n_beams=30)
    world.extra = second_laser(wide, topic="vertical_laser_2d", frame="vertical_laser_link", mounting=None)
    _, report = read(tmp_path, world)
    assert used(report) == ["/scan"]
    assert "by its name" in why_not(report, "vertical_laser_2d")


def test_a_laser_all_around_comes_before_a_narrow_one_with_more_scans(tmp_path):
    world = World(n_scans=12, n_beams=30, step_rad=0.2)
    quick = World(n_scans=90, n_beams=10, step_rad=0.1)
    world.extra = [
        (topic, kind, logged_ns, fields)
        for topic, kind, logged_ns, fields in second_laser(quick, topic="/camera/scan", angle_increment=0.1)
    ]
    assert used(read(tmp_path, world)[1]) == ["/scan"]


def test_a_circle_whose_last_angle_is_given_within_half_a_turn_is_read_on_from_the_first(tmp_path):
    world = World(
        first_rad=1.0, step_rad=0.25, n_beams=25, change=lambda _, fields: fields.update(angle_max=0.75)
    )
    log, _ = read(tmp_path, world)
    np.testing.assert_allclose(log.bearings_rad[0], 1.0 + 0.25 * np.arange(25), atol=1e-9)
