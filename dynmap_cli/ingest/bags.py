"""ROS 1 and ROS 2 bags through rosbags: the one module that knows this library, whose minor versions differ."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from dynmap_cli.errors import LogError
from dynmap_cli.ingest.raw import RawRecording, Topic
from dynmap_cli.ingest.ros_messages import TRANSFORM_TYPES, USED_TYPES, Message, take_messages

_ROS2_DEFAULT = Stores.ROS2_HUMBLE
_NOT_ROS2_PROFILE = "Profile is not ros2"


class ForeignProfileError(Exception):
    """An MCAP file that rosbags refuses because its profile is not "ros2"."""


def read_bag(path: Path, name: str, kind: str) -> RawRecording:
    """Read the laser scans, odometry and transforms of a bag.

    Parameters
    ----------
    path : Path
        A ROS 1 bag, a ROS 2 folder with metadata.yaml, or a lone .db3 or .mcap file.
    name, kind : str
        For messages: what the operator called it, and what it is.

    Raises
    ------
    LogError
        If the bag is cut off or damaged.
    ForeignProfileError
        If it is an MCAP file of another profile.
    """
    with _open(path, name, kind) as reader:
        counts: Counter[tuple[str, str]] = Counter()
        for connection in reader.connections:
            counts[connection.topic, connection.msgtype] += connection.msgcount
        topics = [Topic(topic, msgtype, count) for (topic, msgtype), count in sorted(counts.items())]
        recording = RawRecording(name, kind, topics)
        take_messages(recording, _messages(reader, name, kind))
    return recording


@contextmanager
def _open(path: Path, name: str, kind: str) -> Iterator[AnyReader]:
    """Open a bag; whatever the library raises then becomes one line."""
    reader = None
    try:
        reader = AnyReader([path], default_typestore=get_typestore(_ROS2_DEFAULT))
        reader.open()
    except Exception as err:
        if _NOT_ROS2_PROFILE in str(err):
            raise ForeignProfileError from err
        raise damaged(name, kind, err) from err
    try:
        yield reader
    finally:
        reader.close()


def _messages(reader: AnyReader, name: str, kind: str) -> Iterator[Message]:
    """Messages of the types that are used, in the order of their recording."""
    wanted = [connection for connection in reader.connections if connection.msgtype in USED_TYPES]
    if not wanted:
        return
    stream = reader.messages(connections=wanted)
    while True:
        try:
            connection, logged_ns, raw = next(stream)
            content: Any = reader.deserialize(raw, connection.msgtype)
        except StopIteration:
            return
        except Exception as err:
            raise damaged(name, kind, err) from err
        yield Message(connection.topic, connection.msgtype, logged_ns, content)


def message_decoders() -> dict[str, Callable[[bytes, str], Any]]:
    """Functions (data, type) -> message for each encoding of ROS, for readers of other containers."""
    ros1 = get_typestore(Stores.ROS1_NOETIC)
    for kind in TRANSFORM_TYPES:
        ros1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", kind))
    return {"cdr": get_typestore(_ROS2_DEFAULT).deserialize_cdr, "ros1": ros1.deserialize_ros1}


def damaged(name: str, kind: str, err: Exception) -> LogError:
    """One line for what a reading library could not digest."""
    found = " ".join(str(err).split()).rstrip(".")[:160] or type(err).__name__
    return LogError(
        f"{name}: this {kind} is cut off or damaged ({found}). Copy it again from the robot, or repair it "
        "first (`rosbag reindex`, `mcap recover`)."
    )
