"""Parts of real recordings, as files that any program can read, and true poses out of them."""

from __future__ import annotations

import bz2
import gzip
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rosbags.rosbag1 import Reader, Writer
from rosbags.typesys import Stores, get_typestore

from dynmap_cli.domain.poses import Trajectory

_STATIC = "/tf_static"


def cut(recording: Path, first: float, last: float, to: Path) -> Path:
    """Write what lies between two shares of a recording: of its time in a bag, of its lines of data in a text log."""
    to.parent.mkdir(parents=True, exist_ok=True)
    to.unlink(missing_ok=True)
    if recording.suffix == ".bag":
        _cut_bag(recording, first, last, to)
    else:
        _cut_text(recording, first, last, to)
    return to


def _cut_bag(recording: Path, first: float, last: float, to: Path) -> None:
    """Copy messages as they are; static transforms go into every part."""
    with Reader(recording) as reader, Writer(to) as writer:
        length_ns = reader.end_time - reader.start_time
        start, end = (reader.start_time + round(share * length_ns) for share in (first, last))
        connections = {
            c.id: writer.add_connection(
                c.topic,
                c.msgtype,
                msgdef=c.msgdef.data,
                md5sum=c.digest,
                callerid=c.ext.callerid,
                latching=c.ext.latching,
            )
            for c in reader.connections
        }
        for connection, stamp, content in reader.messages():
            if start <= stamp < end or (connection.topic == _STATIC and stamp < end):
                writer.write(connections[connection.id], max(stamp, start), content)


def _cut_text(recording: Path, first: float, last: float, to: Path) -> None:
    """Copy lines as they are; what is not data goes into every part."""
    lines = list(_lines(recording))
    is_data = np.array([line.startswith(("FLASER", "RLASER", "ROBOTLASER", "ODOM")) for line in lines])
    place = np.cumsum(is_data) - is_data
    start, end = (round(share * int(is_data.sum())) for share in (first, last))
    kept = ~is_data | ((place >= start) & (place < end))
    to.write_text("".join(line for line, is_kept in zip(lines, kept, strict=True) if is_kept))


def _lines(recording: Path) -> Iterator[str]:
    openers = {".bz2": bz2.open, ".gz": gzip.open}
    with openers.get(recording.suffix, open)(recording, "rt", errors="replace") as stream:
        yield from stream


def poses_in_bag(recording: Path, topic: str) -> Trajectory:
    """Poses of a PoseStamped topic by their header stamps, in order, each stamp once."""
    types = get_typestore(Stores.ROS1_NOETIC)
    rows: dict[int, tuple[float, float, float]] = {}
    with Reader(recording) as reader:
        chosen = [connection for connection in reader.connections if connection.topic == topic]
        for connection, _, content in reader.messages(chosen):
            message = types.deserialize_ros1(content, connection.msgtype)
            at, turn = message.pose.position, message.pose.orientation
            stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            yaw = np.arctan2(2.0 * (turn.w * turn.z + turn.x * turn.y), 1.0 - 2.0 * (turn.y**2 + turn.z**2))
            rows[stamp] = (at.x, at.y, float(yaw))
    stamps = sorted(rows)
    poses = np.array([rows[stamp] for stamp in stamps], dtype=np.float64).reshape(-1, 3)
    return Trajectory(np.array(stamps, dtype=np.int64), poses)
