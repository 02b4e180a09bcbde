"""Message types of ROS and Foxglove as they should be, and messages taken apart by them."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from dynmap_cli.ingest.containers.unpacking import unpacked_message
from dynmap_cli.ingest.messages import protobuf
from dynmap_cli.ingest.messages.definitions import check_definitions, check_size
from dynmap_cli.ingest.messages.foxglove import DEFINITIONS, decode_json
from dynmap_cli.ingest.messages.kinds import TRANSFORM_TYPES
from dynmap_cli.ingest.messages.stored import Channel, words_of

_ENCODINGS = {"cdr": ("ros2msg", "ros2idl", "omgidl"), "ros1": ("ros1msg",)}
_IDL = ("ros2idl", "omgidl")
_SEPARATOR = "=" * 80 + "\n"


@functools.cache
def ros2_types() -> Typestore:
    """Message types for bags that do not define theirs."""
    return _with_foxglove(get_typestore(Stores.ROS2_HUMBLE))


@functools.cache
def ros1_types() -> Typestore:
    """The same for ROS 1."""
    store = get_typestore(Stores.ROS1_NOETIC)
    for kind in TRANSFORM_TYPES:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", kind))
    return _with_foxglove(store)


def _with_foxglove(store: Typestore) -> Typestore:
    """Add the types of Foxglove."""
    for kind, definition in DEFINITIONS.items():
        store.register(get_types_from_msg(definition, kind))
    return store


def decode_message(channel: Channel, data: bytes) -> Any:
    """Take a message apart by the encoding of its channel, one of `READ_TYPES`; for readers of other containers."""
    if channel.message_encoding == "json":
        return decode_json(data)
    if channel.message_encoding == "protobuf":
        return protobuf.decode(data, channel.schema_data, channel.schema_name)
    if channel.message_encoding == "ros1":
        return ros1_types().deserialize_ros1(data, channel.message_type)
    return ros2_types().deserialize_cdr(unpacked_message(data), channel.message_type)


def definition_fault(channel: Channel) -> str:
    """Say why the definition of a type of ROS that is used is not believed; "" where nothing is wrong with it."""
    kind = channel.message_type
    if channel.schema_encoding not in _ENCODINGS[channel.message_encoding]:
        return f"its definition of {kind} is of no known kind"
    try:
        text = channel.schema_data.decode()
        check_size(kind, text)
        own = get_typestore(Stores.EMPTY)
        if channel.schema_encoding in _IDL:
            parts = text.split(_SEPARATOR)[1:] if text.startswith(f"{_SEPARATOR}IDL: ") else [f"\n{text}"]
            for part in parts:
                own.register(get_types_from_idl(part.partition("\n")[2]))
        else:
            own.register(get_types_from_msg(text, kind))
        check_definitions(own, _standard(channel), [kind])
    except ValueError as err:
        return words_of(err)
    except Exception as err:
        return f"its definition of {kind} cannot be read: {words_of(err)}"
    return ""


def usual_definition(channel: Channel) -> Channel:
    """The same channel with the usual definition of its type; as it is where the type is not a usual one of ROS."""
    if channel.message_encoding not in _ENCODINGS or channel.message_type not in _standard(channel).fielddefs:
        return channel
    is_ros1 = channel.message_encoding == "ros1"
    definition, digest = _standard(channel).generate_msgdef(
        channel.message_type, ros_version=1 if is_ros1 else 2
    )
    metadata = {**dict(channel.metadata), **({"md5sum": digest} if is_ros1 else {})}
    return replace(
        channel,
        schema_encoding="ros1msg" if is_ros1 else "ros2msg",
        schema_data=definition.encode(),
        metadata=tuple(metadata.items()),
    )


def _standard(channel: Channel) -> Typestore:
    """Types as they should be in a channel."""
    return ros1_types() if channel.message_encoding == "ros1" else ros2_types()
