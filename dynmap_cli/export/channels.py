"""Channels as a copy has them: what no reader would believe is found, and the usual is written instead."""

from __future__ import annotations

from dataclasses import replace

from rosbags.rosbag2.metadata import parse_qos

from dynmap_cli.ingest.containers.type_stores import definition_fault, usual_definition
from dynmap_cli.ingest.messages.kinds import USED_TYPES
from dynmap_cli.ingest.messages.stored import Channel

_ROS_ENCODINGS = frozenset({"cdr", "ros1"})
_TEXTS = frozenset({"", "ros1msg", "ros2msg", "ros2idl", "omgidl"})
_PROFILES = "offered_qos_profiles"


def faults_of(channel: Channel) -> list[str]:
    """What is wrong with the definition of its type, and its profiles."""
    return [fault for fault in (_fault_of_definition(channel), _fault_of_profiles(channel)) if fault]


def as_usual(channel: Channel) -> Channel:
    """The same channel without what is wrong with it; a type of ROS that has no definition gets the usual one."""
    if _fault_of_profiles(channel):
        without = {name: "" if name == _PROFILES else value for name, value in channel.metadata}
        channel = replace(channel, metadata=tuple(without.items()))
    if _fault_of_definition(channel):
        return usual_definition(replace(channel, schema_encoding="", schema_data=b""))
    return channel if channel.schema_data else usual_definition(channel)


def _fault_of_definition(channel: Channel) -> str:
    kind, is_ros = channel.message_type, channel.message_encoding in _ROS_ENCODINGS
    if is_ros and kind in USED_TYPES and channel.schema_data:
        return definition_fault(channel)
    if is_ros and channel.schema_encoding not in _TEXTS:
        return f"its definition of {kind} is of no known kind"
    try:
        if is_ros or channel.schema_encoding in _TEXTS:
            channel.schema_data.decode()
    except ValueError:
        return f"its definition of {kind} is no text"
    return ""


def _fault_of_profiles(channel: Channel) -> str:
    try:
        parse_qos(dict(channel.metadata).get(_PROFILES, ""))
    except Exception:
        return f"the {_PROFILES} of {channel.topic} cannot be read"
    return ""
