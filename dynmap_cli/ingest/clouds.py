"""Point clouds as sweeps of a plane: a slice of heights above the robot's frame, seen from where the sensor sits.

They are read in a second pass, when the transforms of the recording are known, and only where they are asked for or
there is no laser: decoding them costs more than all the rest.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from dynmap_cli.arrays import F32, F64
from dynmap_cli.ingest.choices.frames import FrameTree, make_edge
from dynmap_cli.ingest.choices.robot_frames import find_base
from dynmap_cli.ingest.choices.transforms import matrices, planar
from dynmap_cli.ingest.containers.salvage import stored_messages
from dynmap_cli.ingest.containers.type_stores import decode_message
from dynmap_cli.ingest.messages.kinds import CLOUD_TYPES
from dynmap_cli.ingest.messages.ros_messages import decoding_failed, mend_stamps, plain_frame, stamp_of
from dynmap_cli.ingest.messages.stored import Losses
from dynmap_cli.ingest.raw.laser import ScanShape
from dynmap_cli.ingest.raw.plausible import LONGEST_RANGE_M, is_stamp
from dynmap_cli.ingest.raw.recording import RawRecording
from dynmap_cli.ingest.settings import IngestSettings

_log = logging.getLogger(__name__)

N_BEAMS = 720
STEP_RAD = 2.0 * math.pi / N_BEAMS
LEAST_M = 0.3  # nearer points belong to the robot
_SHAPE = ScanShape(-math.pi + 0.5 * STEP_RAD, STEP_RAD, N_BEAMS, LEAST_M, math.inf)
_FLOATS = {7: "f4", 8: "f8"}  # sensor_msgs/PointField FLOAT32, FLOAT64


def wanted_clouds(recording: RawRecording, settings: IngestSettings) -> set[str]:
    """Topics of clouds that are to be read: the one that is asked for, or all of a recording without a laser."""
    topics = {topic.name for topic in recording.topics if topic.kind in CLOUD_TYPES}
    if settings.scan_topic is not None:
        return topics & {settings.scan_topic}
    return set() if recording.lasers else topics


def add_clouds(recording: RawRecording, path: Path, topics: set[str], settings: IngestSettings) -> None:
    """Add a laser for each topic of clouds.

    Parameters
    ----------
    recording : RawRecording
        As it was read, with its transforms.
    path : Path
        The bag or MCAP file it was read from.
    topics : set of str
    settings : IngestSettings
    """
    _log.info("%s: slices of the clouds on %s are the scans", recording.name, ", ".join(sorted(topics)))
    tree = FrameTree({pair: make_edge(raw) for pair, raw in recording.transforms.items()})
    low_m, high_m = settings.cloud_heights_m
    views: dict[str, _View] = {}
    for topic, logged_ns, cloud in _clouds(recording, path, topics):
        stamp_ns = stamp_of(cloud.header)
        if not is_stamp(stamp_ns) or not is_stamp(logged_ns):
            recording.dropped[f"cloud on {topic} stamped with no possible time"] += 1
            continue
        try:
            points = points_of(cloud)
        except (ValueError, TypeError, KeyError) as err:
            decoding_failed(recording, topic, err)
            continue
        if topic not in views:
            frame = plain_frame(cloud.header.frame_id)
            recording.laser(topic, frame)
            base = find_base(recording, tree, settings)
            views[topic] = _View(
                frame, base, _assumed_pose(settings), is_on_robot=frame not in tree.parents(base)
            )
        view, laser = views[topic], recording.lasers[topic]
        base_from_sensor = view.pose_at(tree, stamp_ns)
        points = points @ base_from_sensor[:3, :3].T + base_from_sensor[:3, 3]
        view.add_heights(points[:, 2])
        if view.is_known and laser.robot_from_sensor is None:
            if settings.laser_pose is None and view.is_on_robot:
                view.seen_from = planar(base_from_sensor[None])[0]
            laser.robot_from_sensor = view.seen_from
        ranges_m = slice_of(points, view.seen_from, low_m, high_m)
        laser.add(stamp_ns, logged_ns, ranges_m, _SHAPE)
        recording.n_read += 1
    for topic, view in views.items():
        _note(recording, topic, view, settings)
    mend_stamps(recording)


def _clouds(recording: RawRecording, path: Path, topics: set[str]) -> Iterator[tuple[str, int, Any]]:
    """Topic, time of recording and content of each cloud that can be decoded."""
    for message in stored_messages(path, Losses()):
        channel = message.channel
        if channel.topic not in topics or channel.message_type not in CLOUD_TYPES:
            continue
        try:
            yield channel.topic, message.logged_ns, decode_message(channel, message.data)
        except Exception as err:
            decoding_failed(recording, channel.topic, err)


class _View:
    """From where the clouds of a topic are seen."""

    def __init__(self, frame: str, base: str, assumed: F64, *, is_on_robot: bool) -> None:
        self.seen_from, self.is_on_robot = assumed, is_on_robot
        self.is_known = False
        self.lowest_m, self.highest_m = math.inf, -math.inf
        self._frame, self._base = frame, base
        self._pose = _raised(assumed)

    def pose_at(self, tree: FrameTree, stamp_ns: int) -> F64:
        """base_from_sensor (4, 4) at a time; where the transforms do not say, the last one, or the assumed one."""
        poses = tree.transform(self._base, self._frame, np.array([stamp_ns])) if self._base else None
        if poses is not None and np.isfinite(poses).all():
            self._pose, self.is_known = np.asarray(poses[0]), True
        return self._pose

    def add_heights(self, heights_m: F64) -> None:
        """Widen the span of heights at which there are points."""
        self.lowest_m = min(self.lowest_m, float(heights_m.min(initial=math.inf)))
        self.highest_m = max(self.highest_m, float(heights_m.max(initial=-math.inf)))


def _assumed_pose(settings: IngestSettings) -> F64:
    """x, y, yaw of a sensor as set, or at the centre of the robot."""
    return np.zeros(3) if settings.laser_pose is None else np.array(settings.laser_pose)


def _raised(pose: F64) -> F64:
    """A pose (3,) in the plane as a matrix (4, 4)."""
    half = 0.5 * pose[2]
    turn = np.array([[0.0, 0.0, math.sin(half), math.cos(half)]])
    return np.asarray(matrices(np.array([[pose[0], pose[1], 0.0]]), turn)[0])


def _note(recording: RawRecording, topic: str, view: _View, settings: IngestSettings) -> None:
    """Say where heights are counted from, if it is not the robot, and where the points are, if not between them."""
    if not view.is_known:
        recording.warnings.append(
            f"{topic}: the recording does not say how high the sensor of these clouds sits; heights "
            "(ingest.cloud_heights_m) are counted from the sensor"
        )
    if not view.is_on_robot and settings.laser_pose is None:
        recording.warnings.append(
            f"{topic}: these clouds are not in the frame of their sensor; taken to be seen from the centre of the "
            "robot. Pass --laser-pose X,Y,YAW"
        )
    low_m, high_m = settings.cloud_heights_m
    if view.lowest_m > high_m or view.highest_m < low_m:
        recording.warnings.append(
            f"{topic}: no point lies between {low_m:g} and {high_m:g} m above the robot's frame "
            f"(ingest.cloud_heights_m); they lie between {view.lowest_m:.2f} and {view.highest_m:.2f} m"
        )


def points_of(cloud: Any) -> F64:
    """Points (n, 3) of a sensor_msgs/PointCloud2 in the frame of the sensor, without those that no sensor sees.

    Raises
    ------
    ValueError, TypeError, KeyError
        If there are no x, y, z, or the data are shorter than the message says.
    """
    order = ">" if cloud.is_bigendian else "<"
    names = ["x", "y", "z"]
    fields = {
        field.name: (order + _FLOATS[field.datatype], field.offset)
        for field in cloud.fields
        if field.name in names
    }
    layout = np.dtype(
        {
            "names": names,
            "formats": [fields[name][0] for name in names],
            "offsets": [fields[name][1] for name in names],
            "itemsize": cloud.point_step,
        }
    )
    data = np.asarray(cloud.data, dtype=np.uint8)
    used_bytes = cloud.width * cloud.point_step
    row_bytes = cloud.row_step if cloud.height > 1 else used_bytes
    if row_bytes < used_bytes or cloud.height * row_bytes > data.size:
        msg = f"{cloud.height} x {cloud.width} points in {data.size} bytes"
        raise ValueError(msg)
    rows = data[: cloud.height * row_bytes].reshape(cloud.height, row_bytes)[:, :used_bytes]
    table = np.ascontiguousarray(rows).ravel().view(layout)
    points = np.column_stack([table[name].astype(np.float64) for name in names])
    return np.asarray(points[(np.abs(points) <= LONGEST_RANGE_M).all(axis=1)])


def slice_of(points: F64, seen_from: F64, low_m: float, high_m: float) -> F32:
    """Distance of the nearest point between two heights in each direction, (N_BEAMS,).

    NaN where there is none: whether a direction is free, out of sight or only its floor was seen is not known.

    Parameters
    ----------
    points : (n, 3) float64
        On the robot.
    seen_from : (3,) float64
        x, y, yaw on the robot from where distances and directions are measured.
    low_m, high_m : float
        Above the origin of the robot's frame.
    """
    within = points[(points[:, 2] >= low_m) & (points[:, 2] <= high_m)]
    dx, dy = within[:, 0] - seen_from[0], within[:, 1] - seen_from[1]
    distance_m = np.hypot(dx, dy)
    turn = (np.arctan2(dy, dx) - seen_from[2] + math.pi) % (2.0 * math.pi)
    beam = np.minimum((turn / STEP_RAD).astype(np.int64), N_BEAMS - 1)
    is_far = distance_m >= LEAST_M
    ranges_m = np.full(N_BEAMS, np.inf)
    np.minimum.at(ranges_m, beam[is_far], distance_m[is_far])
    ranges_m[np.isinf(ranges_m)] = np.nan
    return ranges_m.astype(np.float32)
