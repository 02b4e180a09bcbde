"""Recordings: MCAP (profile ros2), ROS 1 bag, or CARMEN text, chosen by the suffix."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from dynmap_cli.errors import ConfigError
from dynmap_cli.files.atomic import replacing
from dynmap_cli.files.ros_messages import LATCHED_QOS
from dynmap_cli.simulation.carmen import write_carmen
from dynmap_cli.simulation.messages import messages, topics_of
from dynmap_cli.simulation.run import SimulatedRun

SUFFIXES = (".mcap", ".bag", ".log", ".clf")


def check_suffix(path: Path) -> None:
    """Refuse a recording of a kind that is not written.

    Raises
    ------
    ConfigError
    """
    if path.suffix not in SUFFIXES:
        msg = (
            f"{path}: the suffix says which kind of recording to write: "
            ".mcap (ROS 2), .bag (ROS 1), .log or .clf (CARMEN)"
        )
        raise ConfigError(msg)


def write_recording(path: Path, run: SimulatedRun) -> None:
    """Write a run as a recording; the file is whole or absent."""
    check_suffix(path)
    with replacing(path) as part:
        if path.suffix == ".mcap":
            _write_mcap(part, run)
        elif path.suffix == ".bag":
            _write_bag(part, run)
        else:
            write_carmen(part, run)


def _write_mcap(path: Path, run: SimulatedRun) -> None:
    """Write an MCAP file that ROS 2 tools play; chunks carry checksums."""
    from mcap.writer import CompressionType, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD, enable_crcs=True)
        writer.start(profile="ros2", library="dynmap simulate")
        schemas: dict[str, int] = {}
        channels: dict[str, int] = {}
        for topic, message_type in topics_of(run).items():
            if message_type not in schemas:
                definition, _ = store.generate_msgdef(message_type, ros_version=2)
                schemas[message_type] = writer.register_schema(message_type, "ros2msg", definition.encode())
            metadata = {"offered_qos_profiles": LATCHED_QOS} if topic == "/tf_static" else {}
            channels[topic] = writer.register_channel(topic, "cdr", schemas[message_type], metadata)
        counts = dict.fromkeys(channels, 0)
        for entry in messages(run, store):
            content = bytes(store.serialize_cdr(entry.message, entry.message_type))
            writer.add_message(
                channels[entry.topic], entry.time_ns, content, entry.time_ns, sequence=counts[entry.topic]
            )
            counts[entry.topic] += 1
        writer.finish()  # type: ignore[no-untyped-call]


def _write_bag(path: Path, run: SimulatedRun) -> None:
    """Write a ROS 1 bag."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(
        get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", "tf2_msgs/msg/TFMessage")
    )
    path.unlink(missing_ok=True)
    writer = Writer(path)
    writer.set_compression(Writer.CompressionFormat.LZ4)
    with writer:
        connections: dict[str, Any] = {
            topic: writer.add_connection(
                topic, message_type, typestore=store, latching=1 if topic == "/tf_static" else None
            )
            for topic, message_type in topics_of(run).items()
        }
        for entry in messages(run, store):
            content = store.serialize_ros1(entry.message, entry.message_type)
            writer.write(connections[entry.topic], entry.time_ns, content)
