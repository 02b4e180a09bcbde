"""Messages of Foxglove say what those of ROS say."""

import math
import struct
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynmap_cli.ingest.messages import protobuf
from dynmap_cli.ingest.messages.foxglove import DEFINITIONS, as_ros, decode_json
from dynmap_cli.ingest.messages.ros_messages import Message
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from tests.ingest.written import ROS2, World
from tests.ingest.written_foxglove import descriptors, sized, varint, whole, write_foxglove
from tests.ingest.written_foxglove import protobuf as encoded

STRICT = IngestSettings(strict=True)


def assert_is_world(path, world):
    log, report = read_recordings([path], STRICT)
    np.testing.assert_array_equal(log.stamps_ns, world.stamps_ns)
    seen = log.ranges_m.copy()
    np.testing.assert_array_equal(seen[:, 1:], world.ranges_m[:, 1:])
    np.testing.assert_allclose(log.odometry, world.poses, atol=1e-12)
    np.testing.assert_allclose(log.sensor_poses, [[0.2, -0.1, 0.0]], atol=1e-12)
    bearings_rad = world.first_rad + world.step_rad * np.arange(world.n_beams)
    np.testing.assert_allclose(log.bearings_rad[0], bearings_rad, atol=1e-6)
    assert not report.warnings
    assert not report.dropped
    return report


@pytest.mark.parametrize("encoding", ["json", "protobuf"])
@pytest.mark.parametrize("profile", ["", "ros1", "ros2"])
@pytest.mark.parametrize("options", [{}, {"use_chunking": False}], ids=["chunked", "unchunked"])
def test_a_drive_reads_back_from_every_encoding_and_profile(encoding, profile, options, tmp_path):
    path = write_foxglove(tmp_path / "a.mcap", World(), encoding, profile, **options)
    report = assert_is_world(path, World())
    assert report.odometry == "tf odom -> base_link"


@pytest.mark.parametrize("encoding", ["json", "protobuf"])
def test_poses_in_the_frame_of_odometry_are_odometry(encoding, tmp_path):
    world = World(with_tf=False)
    log, report = read_recordings([write_foxglove(tmp_path / "a.mcap", world, encoding)], STRICT)
    assert report.odometry == "/odom"
    np.testing.assert_allclose(log.odometry, world.poses, atol=1e-12)


@pytest.mark.parametrize("encoding", ["json", "protobuf"])
def test_the_pose_of_a_scan_is_where_its_sensor_sits(encoding, tmp_path):
    def change(_number, fields):
        fields["header"]["frame_id"] = "base_link"
        fields["pose"] = {
            "position": {"x": 0.2, "y": -0.1, "z": 0.3},
            "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
        }

    world = World(change=change)
    assert_is_world(write_foxglove(tmp_path / "a.mcap", world, encoding), world)


def test_what_is_no_odometry_is_left_alone():
    pose = '{"position": {"x": 1, "y": 2, "z": 0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}'
    text = f'{{"timestamp": {{"sec": 1, "nsec": 2}}, "frame_id": "map", "pose": {pose}}}'
    content = decode_json(text.encode())
    assert as_ros(Message("/goal", "foxglove.PoseInFrame", 5, content)) == []
    (said,) = as_ros(Message("/odom", "foxglove.PoseInFrame", 5, content))
    assert said.content.pose.pose.position.y == 2.0
    assert said.content.header.stamp.nanosec == 2


def test_null_in_json_is_no_measurement():
    text = b"""{"timestamp": {"sec": 1, "nsec": 0}, "frame_id": "laser", "pose": null,
               "start_angle": -1, "end_angle": 1, "ranges": [1.5, null, "Infinity"]}"""
    (said,) = as_ros(Message("/scan", "foxglove.LaserScan", 5, decode_json(text)))
    np.testing.assert_array_equal(said.content.ranges, [1.5, math.nan, math.inf])


@pytest.mark.parametrize(
    "text",
    [
        "{}",
        "[]",
        '{"timestamp": {"sec": NaN}, "frame_id": "a", "pose": null, "start_angle": 0, "end_angle": 1, "ranges": [1]}',
        '{"timestamp": {"sec": 1}, "frame_id": 7, "pose": null, "start_angle": 0, "end_angle": 1, "ranges": [1]}',
        '{"timestamp": null, "frame_id": "a", "pose": null, "start_angle": 0, "end_angle": 1, "ranges": [[1]]}',
        '{"timestamp": null, "frame_id": "a", "pose": {}, "start_angle": 0, "end_angle": 1, "ranges": [1]}',
    ],
)
def test_json_that_is_no_scan_is_dropped_with_a_count(text, tmp_path):
    with pytest.raises((AttributeError, TypeError, ValueError)):
        as_ros(Message("/scan", "foxglove.LaserScan", 5, decode_json(text.encode())))


def test_messages_of_ros_with_the_types_of_foxglove(tmp_path):
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for kind, definition in DEFINITIONS.items():
        store.register(get_types_from_msg(definition, kind))
    types, world = store.types, World()
    turn = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    with Writer(tmp_path / "a", version=9) as writer:
        links = {
            topic: writer.add_connection(topic, f"foxglove_msgs/msg/{kind}", typestore=store)
            for topic, kind in (("/scan", "LaserScan"), ("/tf", "FrameTransform"))
        }
        for stamp_ns, ranges in zip(world.stamps_ns.tolist(), world.ranges_m, strict=True):
            time = types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
            place = types["geometry_msgs/msg/Vector3"](0.2, -0.1, 0.3)
            move = types["foxglove_msgs/msg/FrameTransform"](time, "base_link", "laser", place, turn)
            pose = types["geometry_msgs/msg/Pose"](types["geometry_msgs/msg/Point"](0.0, 0.0, 0.0), turn)
            beams = ranges.astype(np.float64)
            scan = types["foxglove_msgs/msg/LaserScan"](time, "laser", pose, -1.0, 1.0, beams, np.zeros(0))
            for topic, message in (("/tf", move), ("/scan", scan)):
                kind = links[topic].msgtype
                writer.write(links[topic], stamp_ns, store.serialize_cdr(message, kind))
    log, report = read_recordings([tmp_path / "a"], STRICT)
    np.testing.assert_array_equal(log.ranges_m[:, 1:], world.ranges_m[:, 1:])
    np.testing.assert_allclose(log.sensor_poses, [[0.2, -0.1, 0.0]])
    assert ROS2 is not store
    assert not report.dropped


SCHEMA = descriptors()


def test_protobuf_leaves_out_what_has_its_default():
    found = protobuf.decode(b"", SCHEMA, "foxglove.LaserScan")
    assert (found.timestamp, found.frame_id, found.start_angle) == (None, "", 0)
    assert found.ranges.shape == (0,)
    assert as_ros(Message("/scan", "foxglove.LaserScan", 5, found))[0].content.header.stamp.sec == 0


def test_protobuf_numbers_may_come_one_by_one_and_unknown_fields_are_passed_over():
    ranges = b"".join(varint(6 << 3 | 1) + struct.pack("<d", value) for value in (1.0, 2.5))
    unknown = (
        whole(90, 3) + sized(91, b"abc") + varint(92 << 3 | 5) + bytes(4) + varint(93 << 3 | 1) + bytes(8)
    )
    found = protobuf.decode(unknown + ranges + unknown, SCHEMA, "foxglove.LaserScan")
    np.testing.assert_array_equal(found.ranges, [1.0, 2.5])


def test_protobuf_negative_numbers():
    data = encoded("google.protobuf.Timestamp", {"seconds": -5, "nanos": 7})
    assert protobuf.decode(data, SCHEMA, "google.protobuf.Timestamp") == SimpleNamespace(seconds=-5, nanos=7)


@given(st.binary(max_size=80), st.sampled_from(["foxglove.LaserScan", "foxglove.FrameTransforms"]))
def test_bytes_that_are_no_protobuf_raise_what_damage_raises(data, name):
    for parts in ((data, SCHEMA), (data, SCHEMA[: len(data)] + data)):
        try:
            protobuf.decode(*parts, name)
        except (ValueError, LookupError, TypeError, AttributeError):
            continue
