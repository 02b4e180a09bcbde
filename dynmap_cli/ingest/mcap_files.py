"""MCAP files that rosbags refuses (profile "" or "ros1"), through the mcap package; messages decoded by rosbags."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from mcap.reader import McapReader, make_reader
from mcap.records import Channel, Schema

from dynmap_cli.errors import LogError
from dynmap_cli.ingest.bags import damaged, message_decoders
from dynmap_cli.ingest.raw import RawRecording, Topic
from dynmap_cli.ingest.ros_messages import USED_TYPES, Message, take_messages

_KIND = "MCAP file"
_ENCODINGS = ("cdr", "ros1")


def read_mcap(path: Path, name: str) -> RawRecording:
    """Read the messages in `cdr` or `ros1` encoding of an MCAP file of any profile."""
    with path.open("rb") as stream:
        try:
            reader = make_reader(stream, validate_crcs=True)
            summary = reader.get_summary()
        except Exception as err:
            raise damaged(name, _KIND, err) from err
        if summary is None:
            msg = f"{name}: this {_KIND} has no summary, it was not closed properly. Repair it first (`mcap recover`)."
            raise LogError(msg)
        counts = summary.statistics.channel_message_counts if summary.statistics else {}
        topics: dict[tuple[str, str], int] = {}
        for number, channel in summary.channels.items():
            key = channel.topic, _type_of(summary.schemas.get(channel.schema_id), channel)
            topics[key] = topics.get(key, 0) + counts.get(number, 0)
        recording = RawRecording(name, _KIND, [Topic(*key, count) for key, count in sorted(topics.items())])
        wanted = {topic for topic, kind in topics if kind in USED_TYPES}
        if wanted:
            take_messages(recording, _messages(reader, sorted(wanted), name))
    return recording


def _type_of(schema: Schema | None, channel: Channel) -> str:
    """ROS 2 spelling of a message type where the encoding is one that is read, else its own name and encoding."""
    name = schema.name if schema else ""
    if channel.message_encoding not in _ENCODINGS:
        return f"{name} ({channel.message_encoding or 'no encoding'})"
    package, _, last = name.rpartition("/")
    return f"{package.removesuffix('/msg')}/msg/{last}"


def _messages(reader: McapReader, wanted: list[str], name: str) -> Iterator[Message]:
    """Messages on the wanted topics, in the order of their recording."""
    decode = message_decoders()
    stream = reader.iter_messages(topics=wanted)
    while True:
        try:
            schema, channel, message = next(stream)
            kind = _type_of(schema, channel)
            if kind not in USED_TYPES:
                continue
            content = decode[channel.message_encoding](message.data, kind)
        except StopIteration:
            return
        except Exception as err:
            raise damaged(name, _KIND, err) from err
        yield Message(channel.topic, kind, message.log_time, content)
