"""Robots whose topics are in namespaces of their own, and whose frames have the same names."""

import copy
import math

import numpy as np
import pytest

from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from tests.ingest.test_choices import read, used
from tests.ingest.test_robots_of_others import drive_on, moved
from tests.ingest.written import START_NS, TF, World, transform, write_bag1, write_bag2

OTHER_MOUNTING = (-0.3, 0.1, 0.3, 0.0, 0.0, math.sin(0.2), math.cos(0.2))


def robot(space, world, mounting):
    """Everything that one robot publishes, under its namespace."""
    fixed = {"transforms": [transform("base_link", "laser", START_NS, mounting)]}
    messages = [("/tf_static", TF, START_NS - 1, fixed), *moved("odom", "base_link", world)]
    messages += drive_on("/odom", world)
    plain = World(n_scans=world.n_scans, with_tf=False, with_odometry=False)
    messages += list(plain.messages())
    return [(f"/{space}{topic}", kind, logged_ns, fields) for topic, kind, logged_ns, fields in messages]


def two_robots():
    """Of which b drives another way, and has its laser elsewhere."""
    world = World(with_tf=False, with_odometry=False, with_scans=False)
    other = World(yaw_rad=2.0, start_m=30.0)
    world.extra = [*robot("a", World(), World().mounting), *robot("b", other, OTHER_MOUNTING)]
    world.extra.sort(key=lambda message: message[2])
    return world, other


@pytest.mark.parametrize("write", [write_bag1, write_bag2])
@pytest.mark.parametrize("name", ["a", "b"])
def test_robots_with_frames_of_the_same_names_are_told_by_the_namespaces_of_their_topics(
    name, write, tmp_path
):
    world, other = two_robots()
    path = write(tmp_path / "recording", world)
    log, report = read_recordings([path], IngestSettings(scan_topic=f"/{name}/scan"))
    assert used(report) == [f"/{name}/scan"]
    assert report.odometry == f"tf {name}/odom -> {name}/base_link"
    assert "frames of a, b have the same names" in report.notes[0]
    assert not report.warnings
    np.testing.assert_allclose(log.odometry, (World() if name == "a" else other).poses, atol=1e-9)
    expected = [0.2, -0.1, 0.0] if name == "a" else [-0.3, 0.1, 0.4]
    np.testing.assert_allclose(log.sensor_poses, [expected], atol=1e-9)


def test_fixed_transforms_outside_of_the_namespaces_are_those_of_each_robot(tmp_path):
    world, other = two_robots()
    static = [message for message in world.extra if message[0] == "/a/tf_static"]
    world.extra = [message for message in world.extra if not message[0].endswith("tf_static")]
    world.extra = [("/tf_static", *message[1:]) for message in static] + world.extra
    path = write_bag2(tmp_path / "recording", world)
    log, report = read_recordings([path], IngestSettings(scan_topic="/b/scan"))
    assert report.odometry == "tf b/odom -> b/base_link"
    assert not report.warnings
    np.testing.assert_allclose(log.odometry, other.poses, atol=1e-9)
    np.testing.assert_allclose(log.sensor_poses, [[0.2, -0.1, 0.0]], atol=1e-9)


def test_a_robot_is_told_from_one_without_a_laser(tmp_path):
    world, _ = two_robots()
    world.extra = [message for message in world.extra if message[0] not in {"/b/scan", "/a/odom", "/b/odom"}]
    log, report = read(tmp_path, world)
    assert report.odometry == "tf a/odom -> a/base_link"
    assert not report.warnings
    np.testing.assert_allclose(log.odometry, World().poses, atol=1e-9)


@pytest.mark.parametrize("name", ["", "b"])
def test_a_robot_without_a_namespace_is_told_from_one_in_a_namespace(name, tmp_path):
    world, other = two_robots()
    world.extra = [(topic.replace("/a/", "/"), *rest) for topic, *rest in world.extra]
    path = write_bag2(tmp_path / "recording", world)
    log, report = read_recordings([path], IngestSettings(scan_topic=f"/{name}/scan".replace("//", "/")))
    assert report.odometry == ("tf b/odom -> b/base_link" if name else "tf odom -> base_link")
    assert not report.warnings
    np.testing.assert_allclose(log.odometry, (other if name else World()).poses, atol=1e-9)
    np.testing.assert_allclose(log.sensor_poses, [[-0.3, 0.1, 0.4] if name else [0.2, -0.1, 0.0]], atol=1e-9)


def test_copies_of_transforms_in_the_namespaces_of_lasers_are_of_one_robot(tmp_path):
    world = World(with_tf=False, with_odometry=False, with_scans=False)
    for space, mounting in (("front", World().mounting), ("rear", OTHER_MOUNTING)):
        for topic, kind, logged_ns, known in robot(space, World(), mounting):
            fields = copy.deepcopy(known)
            if topic.endswith("scan"):
                fields["header"]["frame_id"] = space
            if topic.endswith("tf_static"):
                fields["transforms"][0]["child_frame_id"] = space
            world.extra.append((topic, kind, logged_ns, fields))
    world.extra.sort(key=lambda message: message[2])
    log, report = read(tmp_path, world)
    assert used(report) == ["/front/scan", "/rear/scan"]
    assert report.odometry == "tf odom -> base_link"
    assert not report.notes
    np.testing.assert_allclose(log.odometry, np.repeat(World().poses, 2, axis=0), atol=1e-9)


@pytest.mark.parametrize("spaces", [("a",), ("", "a")])
def test_one_robot_in_a_namespace_keeps_the_names_of_its_frames(spaces, tmp_path):
    """Also where what it publishes is copied to topics without the namespace."""
    world = World(with_tf=False, with_odometry=False, with_scans=False)
    for space in spaces:
        found = robot(space, World(), World().mounting)
        world.extra += [(topic.replace("//", "/"), *rest) for topic, *rest in found if space or "tf" in topic]
    world.extra.sort(key=lambda message: message[2])
    log, report = read(tmp_path, world)
    assert report.odometry == "tf odom -> base_link"
    assert not report.notes
    np.testing.assert_allclose(log.odometry, World().poses, atol=1e-9)
    np.testing.assert_allclose(log.sensor_poses, [[0.2, -0.1, 0.0]])
