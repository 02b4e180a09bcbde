"""ROS 1 and ROS 2 bags through rosbags: the one module that knows this library, whose minor versions differ."""

from __future__ import annotations

import functools
import logging
import re
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from dynmap_cli.errors import LogError
from dynmap_cli.ingest.plausible import printable
from dynmap_cli.ingest.raw import RawRecording, Topic
from dynmap_cli.ingest.ros_messages import TRANSFORM_TYPES, USED_TYPES, Message, take_messages
from dynmap_cli.ingest.stored import words_of

_log = logging.getLogger(__name__)
_ROS2_DEFAULT = Stores.ROS2_HUMBLE
_ABOUT_FILE = re.compile(r"^Cannot open database .*?: ")
_NOT_ROS2_PROFILE = "Profile is not ros2"


class UnreadableBagError(Exception):
    """A bag that rosbags refuses.

    Attributes
    ----------
    why : str
        What is wrong with it; "" for an MCAP file of a profile other than "ros2", with which nothing is wrong.
    """

    def __init__(self, why: str) -> None:
        super().__init__(why)
        self.why = why


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
    UnreadableBagError
        If the bag is cut off or damaged, holds fewer messages than it says, or is an MCAP file of another profile.
    """
    with _open(path) as reader:
        counts: Counter[tuple[str, str]] = Counter()
        for connection in reader.connections:
            counts[connection.topic, connection.msgtype] += connection.msgcount
        topics = [
            Topic(printable(topic), msgtype, count) for (topic, msgtype), count in sorted(counts.items())
        ]
        recording = RawRecording(name, kind, topics)
        take_messages(recording, _messages(reader, recording))
    return recording


@contextmanager
def _open(path: Path) -> Iterator[AnyReader]:
    """Open a bag; whatever the library raises then becomes one error."""
    reader = None
    try:
        reader = AnyReader([path], default_typestore=_ros2_types())
        reader.open()
        for inner in reader.readers:
            check_index(inner)
    except UnreadableBagError:
        raise
    except Exception as err:
        why = _ABOUT_FILE.sub("", words_of(err))
        raise UnreadableBagError("" if _NOT_ROS2_PROFILE in why else why) from err
    try:
        yield reader
    finally:
        reader.close()


def check_index(reader: Any) -> None:
    """Refuse a ROS 1 bag whose index leaves out messages that its chunks are said to hold."""
    chunks = getattr(reader, "chunk_infos", [])
    stated = sum(sum(chunk.connection_counts.values()) for chunk in chunks)
    indexed = sum(len(entries) for entries in getattr(reader, "indexes", {}).values())
    if chunks and stated != indexed:
        msg = f"its index has {indexed} messages, its chunks {stated}"
        raise UnreadableBagError(msg)


def _messages(reader: AnyReader, recording: RawRecording) -> Iterator[Message]:
    """Messages of the types that are used, in the order of their recording."""
    wanted = [connection for connection in reader.connections if connection.msgtype in USED_TYPES]
    if not wanted:
        return
    stream = reader.messages(connections=wanted)
    found = 0
    while True:
        try:
            connection, logged_ns, raw = next(stream)
        except StopIteration:
            break
        except Exception as err:
            raise UnreadableBagError(words_of(err)) from err
        found += 1
        try:
            content: Any = reader.deserialize(raw, connection.msgtype)
        except Exception as err:
            decoding_failed(recording, printable(connection.topic), err)
            continue
        yield Message(printable(connection.topic), connection.msgtype, logged_ns, content)
    stated = sum(connection.msgcount for connection in wanted)
    if found != stated:
        msg = f"it says that it holds {stated} messages of the types that are used, and holds {found}"
        raise UnreadableBagError(msg)


@functools.cache
def _ros2_types() -> Typestore:
    """Message types for bags that do not define theirs."""
    return get_typestore(_ROS2_DEFAULT)


@functools.cache
def message_decoders() -> dict[str, Callable[[bytes, str], Any]]:
    """Functions (data, type) -> message for each encoding of ROS, for readers of other containers."""
    ros1 = get_typestore(Stores.ROS1_NOETIC)
    for kind in TRANSFORM_TYPES:
        ros1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", kind))
    return {"cdr": _ros2_types().deserialize_cdr, "ros1": ros1.deserialize_ros1}


def decoding_failed(recording: RawRecording, topic: str, err: Exception) -> None:
    """Count a message that is not what its type says."""
    recording.drop_broken(f"message on {topic} that cannot be decoded")
    _log.debug("%s: %s: %s", recording.name, topic, words_of(err))


def damaged(name: str, kind: str, err: Exception) -> LogError:
    """One line for what a reading library could not digest."""
    return LogError(
        f"{name}: this {kind} is cut off or damaged ({words_of(err)}). Copy it again from the robot, or repair it "
        "first (`rosbag reindex`, `mcap recover`)."
    )
