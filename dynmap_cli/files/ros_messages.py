"""ROS messages made from numbers: LaserScan, Odometry, transforms. Shared by all that write recordings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from dynmap_cli.arrays import F32

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

SCAN, ODOMETRY, TRANSFORMS = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"
LATCHED_QOS = """- history: 1
  depth: 1
  reliability: 1
  durability: 1
  deadline: {sec: 9223372036, nsec: 854775807}
  lifespan: {sec: 9223372036, nsec: 854775807}
  liveliness: 1
  liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}
  avoid_ros_namespace_conventions: false
"""
"""Metadata `offered_qos_profiles` of a channel whose last message counts for ever, as that of /tf_static."""
_COVARIANCE = np.diag([1e-3, 1e-3, 1e6, 1e6, 1e6, 1e-2]).ravel()


@dataclass(frozen=True, slots=True)
class ScanFields:
    """The fields of a LaserScan that do not change from sweep to sweep.

    Attributes
    ----------
    first_bearing_rad, last_bearing_rad, increment_rad : float
    beam_interval_s, period_s : float
    range_min_m, range_max_m : float
    """

    first_bearing_rad: float
    last_bearing_rad: float
    increment_rad: float
    beam_interval_s: float
    period_s: float
    range_min_m: float
    range_max_m: float


class MessageMaker:
    """Makes messages of one distribution; ROS 1 headers have a number besides."""

    def __init__(self, store: Typestore) -> None:
        self.types = store.types
        self.numbered = any(name == "seq" for name, _ in store.fielddefs["std_msgs/msg/Header"][1])

    def make(self, name: str, *values: Any) -> Any:
        """Make a message from the values of its fields, in order."""
        return self.types[name](*values)

    def header(self, stamp_ns: int, frame: str, number: int) -> Any:
        """Make a header."""
        stamp = self.make("builtin_interfaces/msg/Time", stamp_ns // 10**9, stamp_ns % 10**9)
        first = (number,) if self.numbered else ()
        return self.make("std_msgs/msg/Header", *first, stamp, frame)

    def rotation(self, yaw_rad: float) -> Any:
        """Make a quaternion that turns about z."""
        half = 0.5 * yaw_rad
        return self.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sin(half), math.cos(half))

    def transform(self, header: Any, child: str, pose: Sequence[float]) -> Any:
        """Make a stamped transform from x, y, yaw."""
        shift = self.make("geometry_msgs/msg/Vector3", pose[0], pose[1], 0.0)
        moved = self.make("geometry_msgs/msg/Transform", shift, self.rotation(pose[2]))
        return self.make("geometry_msgs/msg/TransformStamped", header, child, moved)

    def transforms(self, stamped: list[Any]) -> Any:
        """Make a message of tf."""
        return self.make(TRANSFORMS, stamped)

    def odometry(self, header: Any, child: str, pose: Sequence[float], speed: Sequence[float]) -> Any:
        """Make an Odometry message from a pose x, y, yaw and the speeds forward, left (m/s) and of turning (rad/s)."""
        place = self.make("geometry_msgs/msg/Point", pose[0], pose[1], 0.0)
        at = self.make("geometry_msgs/msg/Pose", place, self.rotation(pose[2]))
        ahead = self.make("geometry_msgs/msg/Vector3", speed[0], speed[1], 0.0)
        turn = self.make("geometry_msgs/msg/Vector3", 0.0, 0.0, speed[2])
        twist = self.make("geometry_msgs/msg/Twist", ahead, turn)
        return self.make(
            ODOMETRY,
            header,
            child,
            self.make("geometry_msgs/msg/PoseWithCovariance", at, _COVARIANCE),
            self.make("geometry_msgs/msg/TwistWithCovariance", twist, _COVARIANCE),
        )

    def scan(self, header: Any, fields: ScanFields, ranges_m: F32) -> Any:
        """Make a LaserScan without intensities."""
        return self.make(
            SCAN,
            header,
            fields.first_bearing_rad,
            fields.last_bearing_rad,
            fields.increment_rad,
            fields.beam_interval_s,
            fields.period_s,
            fields.range_min_m,
            fields.range_max_m,
            ranges_m,
            np.empty(0, dtype=np.float32),
        )
