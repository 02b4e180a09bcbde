"""Names of the message types that are used, in the spelling of ROS 2 or of Foxglove."""

from __future__ import annotations

LASER_TYPES = frozenset({"sensor_msgs/msg/LaserScan", "sensor_msgs/msg/MultiEchoLaserScan"})
ODOMETRY_TYPES = frozenset({"nav_msgs/msg/Odometry"})
POSE_TYPES = frozenset({"geometry_msgs/msg/PoseWithCovarianceStamped"})
"""Odometry where topic or frame say so."""
TRANSFORM_TYPES = frozenset({"tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"})
CLOUD_TYPES = frozenset({"sensor_msgs/msg/PointCloud2"})
"""Read only where they are asked for, or there is no laser."""
ROS_TYPES = LASER_TYPES | ODOMETRY_TYPES | POSE_TYPES | TRANSFORM_TYPES

_FOXGLOVE = ("LaserScan", "FrameTransform", "FrameTransforms", "PoseInFrame")
FOXGLOVE_SCHEMAS = frozenset(f"foxglove.{name}" for name in _FOXGLOVE)
"""In JSON and protobuf."""
FOXGLOVE_TYPES = FOXGLOVE_SCHEMAS | {f"foxglove_msgs/msg/{name}" for name in _FOXGLOVE}

USED_TYPES = ROS_TYPES | FOXGLOVE_TYPES
READ_TYPES = {
    "cdr": USED_TYPES,
    "ros1": USED_TYPES,
    "json": FOXGLOVE_SCHEMAS,
    "protobuf": FOXGLOVE_SCHEMAS,
}
"""By encoding of the messages."""
