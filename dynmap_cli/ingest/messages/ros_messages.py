"""ROS messages -> raw recording, whichever container and encoding they came in."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, replace
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from dynmap_cli.arrays import B1, F32, F64
from dynmap_cli.ingest.messages.kinds import LASER_TYPES, ODOMETRY_TYPES, POSE_TYPES, TRANSFORM_TYPES
from dynmap_cli.ingest.messages.namespaces import frame_in, name_frames, namespace_of, robots_in, share_fixed
from dynmap_cli.ingest.messages.stored import words_of
from dynmap_cli.ingest.raw.columns import spans
from dynmap_cli.ingest.raw.laser import ScanShape
from dynmap_cli.ingest.raw.plausible import (
    FARTHEST_M,
    LONGEST_RANGE_M,
    are_coordinates,
    are_degrees,
    are_stamps,
    is_stamp,
    is_sweep,
)
from dynmap_cli.ingest.raw.recording import RawOdometry, RawRecording, RawTransform
from dynmap_cli.printable import printable

_log = logging.getLogger(__name__)
_ANGLE_GRID_RAD, _STEP_GRID_RAD = 1e-4, 1e-7
LEAST_QUATERNION, MOST_QUATERNION = 0.5, 4.0
_CLIPPED = 1e3
"""Larger components than a rotation has, whose squares are numbers still."""
LONGEST_SWEEP_S = 60.0
_NO_STAMP = -1
_NEAR_STEPS = 2.5


@dataclass(frozen=True, slots=True)
class Message:
    """A message with its place.

    Attributes
    ----------
    topic, msgtype : str
    logged_ns : int
        When it was recorded.
    content : object
        The deserialized message, fields as in its ROS definition.
    """

    topic: str
    msgtype: str
    logged_ns: int
    content: Any


def take_message(recording: RawRecording, message: Message) -> None:
    """Keep one message."""
    recording.n_read += 1
    if not is_stamp(message.logged_ns):
        recording.dropped[f"message on {message.topic} recorded at no possible time"] += 1
    elif message.msgtype in LASER_TYPES:
        _take_scan(recording, message)
    elif message.msgtype in ODOMETRY_TYPES:
        _take_odometry(recording, message)
    elif message.msgtype in POSE_TYPES:
        _take_pose(recording, message)
    elif message.msgtype in TRANSFORM_TYPES:
        _take_transforms(recording, message)


def end_of_messages(recording: RawRecording) -> None:
    """What can only be done when all messages were taken."""
    _clean_transforms(recording)
    mend_stamps(recording)


def decoding_failed(recording: RawRecording, topic: str, err: Exception) -> None:
    """Count a message that is not what its type says."""
    recording.drop_broken(f"message on {topic} that cannot be decoded")
    _log.debug("%s: %s: %s", recording.name, topic, words_of(err))


def plain_frame(frame: str) -> str:
    """A frame name without the leading slash of old tf, and without what cannot be printed."""
    return printable(frame).strip().lstrip("/")


def stamp_of(header: Any) -> int:
    """Nanoseconds of a header."""
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)


def _take_scan(recording: RawRecording, message: Message) -> None:
    """Keep a sweep."""
    scan = message.content
    ranges_m = _ranges_of(scan)
    stamp_ns = stamp_of(scan.header)
    shape = shape_of(scan, ranges_m.size) if ranges_m.size else None
    fault = ""
    if ranges_m.size == 0:
        fault = "without beams"
    elif shape is None:
        fault = "with angles that no laser has"
    elif not is_stamp(stamp_ns):
        fault = "stamped with no possible time"
    if fault or shape is None:
        recording.dropped[f"scan on {message.topic} {fault}"] += 1
        return
    note_degrees(recording, message.topic, float(scan.angle_min), float(scan.angle_increment), ranges_m.size)
    laser = recording.laser(message.topic, plain_frame(scan.header.frame_id))
    interval_s = float(scan.time_increment)
    if not 0.0 <= interval_s * ranges_m.size <= LONGEST_SWEEP_S:
        interval_s = math.nan
    laser.add(stamp_ns, message.logged_ns, ranges_m, shape, interval_s)


def note_degrees(recording: RawRecording, topic: str, first: float, step: float, n_beams: int) -> None:
    """Say that the angles of a topic are taken to be in degrees, where they are."""
    if are_degrees(first, step, n_beams):
        recording.say_degrees(topic)


def _ranges_of(scan: Any) -> F32:
    """Ranges (n_beams,) of a LaserScan, or first echoes of a MultiEchoLaserScan."""
    if len(scan.ranges) and hasattr(scan.ranges[0], "echoes"):
        first = [beam.echoes[0] if len(beam.echoes) else math.inf for beam in scan.ranges]
        return np.array(first, dtype=np.float32)
    return np.array(scan.ranges, dtype=np.float32)


def shape_of(scan: Any, n_beams: int) -> ScanShape | None:
    """Geometry of a LaserScan; None where its angles are not those of a laser."""
    return shape_of_angles(
        float(scan.angle_min),
        float(scan.angle_max),
        float(scan.angle_increment),
        float(scan.range_min),
        float(scan.range_max),
        n_beams,
    )


@lru_cache(maxsize=256)
def shape_of_angles(
    first: float, last: float, step: float, low: float, high: float, n_beams: int
) -> ScanShape | None:
    """Geometry from the angles and limits of a LaserScan; None where its angles are not those of a laser.

    The increment decides, for many drivers count one beam more or less than angle_min and angle_max say; where it
    is (nearly) zero, or of the wrong sign and does not lead to angle_max by way of the full circle either, the beams
    are spread between the two. Angles are rounded to 0.006 deg, so that
    sensors which compute them anew for each sweep do not get a geometry for each. Angles of many circles are degrees.
    """
    if abs(step) < _STEP_GRID_RAD or (
        (last - first) * step < 0.0 and not _leads_to(first, last, step, n_beams)
    ):
        step = (last - first) / max(n_beams - 1, 1)
    if are_degrees(first, step, n_beams):
        first, step = math.radians(first), math.radians(step)
    if not is_sweep(first, step, n_beams):
        return None
    increment_rad = round(round(step / _STEP_GRID_RAD) * _STEP_GRID_RAD, 12)
    if increment_rad == 0.0 and n_beams > 1:
        return None
    return ScanShape(
        round(round(first / _ANGLE_GRID_RAD) * _ANGLE_GRID_RAD, 9),
        increment_rad,
        n_beams,
        round(low, 6) if 0.0 <= low < math.inf else 0.0,
        round(high, 6) if 0.0 < high < LONGEST_RANGE_M else math.inf,
    )


def _leads_to(first: float, last: float, step: float, n_beams: int) -> bool:
    """Whether beams from the first angle on end within two steps of the last, up to full circles."""
    off = (first + step * (n_beams - 1) - last) / (2.0 * math.pi)
    return math.isfinite(off) and abs(off - round(off)) * 2.0 * math.pi < _NEAR_STEPS * abs(step)


def _take_pose(recording: RawRecording, message: Message) -> None:
    """Keep a pose without a child frame, if it is odometry rather than a start or a place on a map."""
    header = message.content.header
    if "odom" in header.frame_id.lower() or "odom" in message.topic.lower():
        content = SimpleNamespace(header=header, child_frame_id="", pose=message.content.pose)
        _take_odometry(recording, replace(message, content=content))


def _take_odometry(recording: RawRecording, message: Message) -> None:
    """Keep an odometry pose, projected to the plane."""
    odometry = message.content
    pose = odometry.pose.pose
    yaw_rad = yaw_of(pose.orientation)
    values = (float(pose.position.x), float(pose.position.y), yaw_rad)
    stamp_ns = stamp_of(odometry.header)
    if not (are_coordinates(values) and is_stamp(stamp_ns)):
        recording.dropped[f"odometry on {message.topic} that is no pose or has no possible time"] += 1
        return
    track = recording.odometry.setdefault(
        message.topic,
        RawOdometry(
            message.topic, plain_frame(odometry.header.frame_id), plain_frame(odometry.child_frame_id)
        ),
    )
    track.add(stamp_ns, message.logged_ns, values)


def yaw_of(q: Any) -> float:
    """Heading of a quaternion message, radians; NaN where it is no rotation."""
    if not LEAST_QUATERNION <= q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w <= MOST_QUATERNION:
        return math.nan
    return math.atan2(2.0 * (q.w * q.z + q.x * q.y), q.w * q.w + q.x * q.x - q.y * q.y - q.z * q.z)


def _take_transforms(recording: RawRecording, message: Message) -> None:
    """Keep the transforms of a tf message."""
    transforms, space = recording.transforms_read, namespace_of(message.topic)
    for stamped in message.content.transforms:
        header, move, q = stamped.header, stamped.transform.translation, stamped.transform.rotation
        key = space, header.frame_id, stamped.child_frame_id
        kept = transforms.get(key)
        if kept is None:
            kept = transforms[key] = RawTransform(message.topic.endswith("tf_static"))
        stamp_ns = header.stamp.sec * 10**9 + header.stamp.nanosec
        values = (move.x, move.y, move.z, q.x, q.y, q.z, q.w)
        kept.add(stamp_ns if is_stamp(stamp_ns) else _NO_STAMP, message.logged_ns, values)


def _clean_transforms(recording: RawRecording) -> None:
    """Name frames without slashes and drop what is no rotation; done once at the end, for tf is most of many bags."""
    robots = robots_in(recording)
    name_frames(recording, robots)
    found, recording.transforms_read = recording.transforms_read, {}
    for (space, parent, child), raw in found.items():
        is_pose = _are_transforms(raw.values)
        is_pose &= are_stamps(raw.stamps_ns)
        raw.give_back()
        if not is_pose.all():
            recording.dropped["transform that is no pose or has no possible time"] += int(
                np.count_nonzero(~is_pose)
            )
        if not is_pose.any():
            continue
        pair = plain_frame(parent), plain_frame(child)
        if space in robots:
            pair = frame_in(space, pair[0]), frame_in(space, pair[1])
        if is_pose.all() and pair not in recording.transforms:
            recording.transforms[pair] = raw
            raw.give_back()
            continue
        kept = recording.transforms.setdefault(pair, RawTransform(raw.is_static))
        kept.add_many(raw.stamps_ns[is_pose], raw.logged_ns[is_pose], raw.values[is_pose])
        kept.keep(np.argsort(kept.logged_ns, kind="stable"))
    share_fixed(recording, robots)


def _are_transforms(values: F64) -> B1:
    """(n,) which rows x, y, z, qx, qy, qz, qw (n, 7) are poses; in blocks, to save memory."""
    is_pose = np.zeros(values.shape[0], dtype=bool)
    for rows in spans(is_pose.size, values):
        part = values[rows]
        length = (np.clip(part[:, 3:], -_CLIPPED, _CLIPPED) ** 2).sum(axis=1)
        is_pose[rows] = (np.abs(part[:, :3]) <= FARTHEST_M).all(axis=1)
        is_pose[rows] &= (length >= LEAST_QUATERNION) & (length <= MOST_QUATERNION)
    return is_pose


def mend_stamps(recording: RawRecording) -> None:
    """Where a driver never set its stamps take the times of recording; single scans without a stamp go."""
    for track in recording.odometry.values():
        if track.stamps_ns.size > 1 and np.ptp(track.stamps_ns) == 0:
            track.stamps_ns = track.logged_ns
            recording.warnings.append(
                f"{track.name}: all poses have the same time stamp; the times of recording are used"
            )
    for (parent, child), transform in recording.transforms.items():
        if (
            transform.stamps_ns.size > 1
            and np.ptp(transform.stamps_ns) == 0
            and np.ptp(transform.values, axis=0).any()
        ):
            transform.stamps_ns = transform.logged_ns
            recording.warnings.append(
                f"{parent} -> {child}: all transforms have the same time stamp; the times of recording are used"
            )
    for laser in recording.lasers.values():
        unstamped = int(np.count_nonzero(laser.stamps_ns == 0))
        if np.ptp(laser.stamps_ns) == 0 and (unstamped or laser.n_scans > 1):
            laser.stamps_ns = laser.logged_ns
            found = "no scan has a time stamp" if unstamped else "all scans have the same time stamp"
            recording.warnings.append(
                f"{laser.name}: {found}; the times of recording are used, they come later"
            )
        elif unstamped:
            laser.keep(laser.stamps_ns != 0)
            recording.dropped[f"scan on {laser.name} without a time stamp"] += unstamped
