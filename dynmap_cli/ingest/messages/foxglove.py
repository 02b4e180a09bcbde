"""Messages of Foxglove (JSON, protobuf, or ROS with foxglove_msgs) as the messages of ROS that say the same.

    LaserScan        timestamp, frame_id, pose (of the sensor in that frame), start_angle, end_angle, ranges
    FrameTransform   timestamp, parent_frame_id, child_frame_id, translation, rotation
    FrameTransforms  transforms
    PoseInFrame      timestamp, frame_id, pose; odometry where topic or frame say so

A LaserScan has no reach, so that of the sensor is found from its ranges; where its pose is not that of the frame, the
frame of the sensor gets a name and a transform of its own.
"""

from __future__ import annotations

import json
import math
from types import SimpleNamespace
from typing import Any

import numpy as np

from dynmap_cli.ingest.messages.kinds import FOXGLOVE_TYPES
from dynmap_cli.ingest.messages.ros_messages import Message

DEFINITIONS = {
    "foxglove_msgs/msg/LaserScan": "time timestamp\nstring frame_id\ngeometry_msgs/Pose pose\nfloat64 start_angle\n"
    "float64 end_angle\nfloat64[] ranges\nfloat64[] intensities",
    "foxglove_msgs/msg/FrameTransform": "time timestamp\nstring parent_frame_id\nstring child_frame_id\n"
    "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "foxglove_msgs/msg/FrameTransforms": "foxglove_msgs/FrameTransform[] transforms",
    "foxglove_msgs/msg/PoseInFrame": "time timestamp\nstring frame_id\ngeometry_msgs/Pose pose",
}
"""For bags that do not define these types."""

_SCAN, _ODOMETRY = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry"
_TRANSFORMS = "tf2_msgs/msg/TFMessage"
_NO_MOVE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def decode_json(data: bytes) -> Any:
    """A message in JSON, its objects as attributes."""
    return json.loads(data, object_hook=lambda fields: SimpleNamespace(**fields))


def as_ros(message: Message) -> list[Message]:
    """A message as it is, or the messages of ROS for one of Foxglove.

    Raises
    ------
    AttributeError, TypeError, ValueError, OverflowError
        If a field is missing, or is not what it must be.
    """
    if message.msgtype not in FOXGLOVE_TYPES:
        return [message]
    name, content = message.msgtype.replace("/", ".").rpartition(".")[2], message.content
    if name == "LaserScan":
        return _scan(message)
    if name == "PoseInFrame":
        return _odometry(message)
    stamped = [content] if name == "FrameTransform" else content.transforms
    moves = [
        _transform(one.timestamp, one.parent_frame_id, one.child_frame_id, _values_of_transform(one))
        for one in stamped
    ]
    return [_said(message, _TRANSFORMS, SimpleNamespace(transforms=moves))]


def _scan(message: Message) -> list[Message]:
    """A sweep, and where its sensor sits in the frame it names."""
    scan, frame = message.content, _text(message.content.frame_id)
    pose = _values_of_pose(scan.pose)
    result = []
    if pose != _NO_MOVE:
        sensor = f"{frame}{message.topic}"
        move = _transform(scan.timestamp, frame, sensor, pose)
        result.append(_said(message, _TRANSFORMS, SimpleNamespace(transforms=[move])))
        frame = sensor
    values = np.array([math.nan if value is None else float(value) for value in scan.ranges])
    with np.errstate(over="ignore"):
        ranges_m = values.astype(np.float32)
    content = SimpleNamespace(
        header=_header(scan.timestamp, frame),
        angle_min=float(scan.start_angle),
        angle_max=float(scan.end_angle),
        angle_increment=0.0,
        time_increment=0.0,
        range_min=0.0,
        range_max=math.inf,
        ranges=ranges_m,
    )
    return [*result, _said(message, _SCAN, content)]


def _odometry(message: Message) -> list[Message]:
    """A pose, if it is odometry rather than a goal or a place on a map."""
    frame = _text(message.content.frame_id)
    if "odom" not in frame.lower() and "odom" not in message.topic.lower():
        return []
    x, y, z, *turn = _values_of_pose(message.content.pose)
    pose = SimpleNamespace(position=_fields("xyz", (x, y, z)), orientation=_fields("xyzw", turn))
    content = SimpleNamespace(
        header=_header(message.content.timestamp, frame),
        child_frame_id="",
        pose=SimpleNamespace(pose=pose),
    )
    return [_said(message, _ODOMETRY, content)]


def _said(message: Message, msgtype: str, content: Any) -> Message:
    """The same message in other words."""
    return Message(message.topic, msgtype, message.logged_ns, content)


def _header(stamp: Any, frame: str) -> Any:
    """Header of ROS; stamps have sec and nsec (Foxglove), nanosec (ROS), or seconds and nanos (google.protobuf)."""
    fields = {} if stamp is None else vars(stamp) if isinstance(stamp, SimpleNamespace) else _slots_of(stamp)
    sec = fields.get("sec", fields.get("seconds", 0))
    part = fields.get("nsec", fields.get("nanosec", fields.get("nanos", 0)))
    return SimpleNamespace(stamp=SimpleNamespace(sec=int(sec), nanosec=int(part)), frame_id=frame)


def _slots_of(stamp: Any) -> dict[str, Any]:
    """Fields of a deserialized time of ROS."""
    return {"sec": stamp.sec, "nanosec": stamp.nanosec}


def _transform(stamp: Any, parent: Any, child: Any, values: tuple[float, ...]) -> Any:
    """TransformStamped of ROS."""
    move = SimpleNamespace(translation=_fields("xyz", values[:3]), rotation=_fields("xyzw", values[3:]))
    return SimpleNamespace(header=_header(stamp, _text(parent)), child_frame_id=_text(child), transform=move)


def _values_of_transform(stamped: Any) -> tuple[float, ...]:
    """x, y, z, qx, qy, qz, qw; early versions have them one step further in."""
    inner = getattr(stamped, "transform", None) or stamped
    return _values(inner.translation, inner.rotation)


def _values_of_pose(pose: Any) -> tuple[float, ...]:
    """x, y, z, qx, qy, qz, qw; what protobuf leaves out is no move."""
    return _NO_MOVE if pose is None else _values(pose.position, pose.orientation)


def _values(move: Any, turn: Any) -> tuple[float, ...]:
    """x, y, z, qx, qy, qz, qw of a vector and a quaternion; None = no move, no turn."""
    moved = _NO_MOVE[:3] if move is None else (float(move.x), float(move.y), float(move.z))
    turned = _NO_MOVE[3:] if turn is None else (float(turn.x), float(turn.y), float(turn.z), float(turn.w))
    return (*moved, *turned)


def _fields(names: str, values: Any) -> Any:
    return SimpleNamespace(**dict(zip(names, values, strict=True)))


def _text(value: Any) -> str:
    """A name, which must be one."""
    if not isinstance(value, str):
        msg = f"{type(value).__name__} instead of a name"
        raise ValueError(msg)
    return value
