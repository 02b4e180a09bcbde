"""CARMEN and Wean Hall logs as messages of ROS 2: LaserScan, Odometry, tf and tf_static."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore

from dynmap_cli.arrays import F64
from dynmap_cli.domain.poses import between
from dynmap_cli.export.messages import Container
from dynmap_cli.files.ros_messages import (
    LATCHED_QOS,
    ODOMETRY,
    SCAN,
    TRANSFORMS,
    MessageMaker,
    ScanFields,
)
from dynmap_cli.ingest.choices.merging import period_s_of
from dynmap_cli.ingest.messages.stored import Channel, StoredMessage
from dynmap_cli.ingest.raw.laser import RawLaser
from dynmap_cli.ingest.raw.recording import RawOdometry, RawRecording

_ROBOT, _WORLD = "base_link", "odom"


@dataclass(frozen=True, slots=True)
class TextChoices:
    """What a text log leaves open, as it was decided when it was read.

    Attributes
    ----------
    odometry : str
        Name of the odometry that is used; where there is none of that name, none is written.
    reach_m : float
        From where on a range is no return.
    """

    odometry: str
    reach_m: float


def text_container(recording: RawRecording, choices: TextChoices) -> Container:
    """Messages of a text log."""
    writer = _Writer(choices.reach_m)
    streams = [writer.scans(laser, len(recording.lasers) == 1) for laser in recording.lasers.values()]
    track = recording.odometry.get(choices.odometry)
    if track is not None:
        streams.append(writer.odometry(track))
    mountings = {_frame_of(laser): laser.robot_from_sensor for laser in recording.lasers.values()}
    first_ns = min(int(laser.stamps_ns.min()) for laser in recording.lasers.values())
    if track is not None:
        first_ns = min(first_ns, int(track.stamps_ns.min()))
    fixed = writer.mountings(first_ns, {name: pose for name, pose in mountings.items() if pose is not None})
    return Container("ros2", heapq.merge(fixed, *streams, key=lambda stored: stored.logged_ns))


def _frame_of(laser: RawLaser) -> str:
    return f"laser_{laser.name.lower()}"


class _Writer:
    """Serializes messages and numbers them by topic."""

    def __init__(self, reach_m: float) -> None:
        self._reach_m = reach_m
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        self._maker = MessageMaker(self._store)
        self._numbers: dict[str, int] = {}
        self._channels: dict[str, Channel] = {}

    def mountings(self, stamp_ns: int, poses: dict[str, F64]) -> Iterator[StoredMessage]:
        """Yield where the lasers sit, once, at the very beginning."""
        header = self._maker.header(stamp_ns, _ROBOT, 0)
        fixed = [self._maker.transform(header, frame, pose.tolist()) for frame, pose in poses.items()]
        if fixed:
            yield self._stored(stamp_ns, "/tf_static", TRANSFORMS, self._maker.transforms(fixed))

    def scans(self, laser: RawLaser, is_only_one: bool) -> Iterator[StoredMessage]:
        """Yield the sweeps of a laser by their stamps."""
        topic = "/scan" if is_only_one else f"/{laser.name.lower()}/scan"
        period_s = period_s_of(laser.stamps_ns)
        for number in np.argsort(laser.stamps_ns, kind="stable").tolist():
            stamp_ns, shape = int(laser.stamps_ns[number]), laser.shape_of(number)
            interval_s = float(laser.beam_interval_s[number])
            fields = ScanFields(
                shape.first_bearing_rad,
                shape.first_bearing_rad + shape.increment_rad * (shape.n_beams - 1),
                shape.increment_rad,
                interval_s if np.isfinite(interval_s) else 0.0,
                period_s,
                shape.range_min_m,
                min(shape.range_max_m, self._reach_m),
            )
            header = self._maker.header(stamp_ns, _frame_of(laser), 0)
            message = self._maker.scan(header, fields, laser.ranges_of(number))
            yield self._stored(stamp_ns, topic, SCAN, message)

    def odometry(self, track: RawOdometry) -> Iterator[StoredMessage]:
        """Yield poses by their stamps, as Odometry and as a transform."""
        stamps_ns, poses = track.as_arrays()
        steps = between(poses[:-1], poses[1:])
        seconds = np.maximum(np.diff(stamps_ns) * 1e-9, 1e-6)
        speeds = np.concatenate([np.zeros((1, 3)), steps / seconds[:, None]])
        for stamp_ns, pose, speed in zip(stamps_ns.tolist(), poses.tolist(), speeds.tolist(), strict=True):
            header = self._maker.header(stamp_ns, _WORLD, 0)
            message = self._maker.odometry(header, _ROBOT, pose, speed)
            yield self._stored(stamp_ns, "/odom", ODOMETRY, message)
            moved = self._maker.transforms([self._maker.transform(header, _ROBOT, pose)])
            yield self._stored(stamp_ns, "/tf", TRANSFORMS, moved)

    def _stored(self, stamp_ns: int, topic: str, message_type: str, message: Any) -> StoredMessage:
        if topic not in self._channels:
            definition, _ = self._store.generate_msgdef(message_type, ros_version=2)
            metadata = (("offered_qos_profiles", LATCHED_QOS),) if topic == "/tf_static" else ()
            self._channels[topic] = Channel(
                topic, "cdr", message_type, "ros2msg", definition.encode(), metadata
            )
        number = self._numbers[topic] = self._numbers.get(topic, -1) + 1
        data = bytes(self._store.serialize_cdr(message, message_type))
        return StoredMessage(stamp_ns, stamp_ns, number, self._channels[topic], data)
