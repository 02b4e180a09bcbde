"""Recordings with known content, written in every container."""

from __future__ import annotations

import bz2
import gzip
import lzma
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.interfaces import Nodetype
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Bag2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS2 = get_typestore(Stores.ROS2_HUMBLE)
ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
SCAN, ODOMETRY, TF = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"
START_NS = 1_700_000_000_123_456_789
PERIOD_NS = 100_000_000


@dataclass
class World:
    """A short drive along a line, seen by one laser; messages are (topic, type, logged_ns, fields)."""

    n_scans: int = 12
    n_beams: int = 9
    start_ns: int = START_NS
    start_m: float = 0.0
    step_m: float = 0.05
    yaw_rad: float = 0.3
    first_rad: float = -1.0
    step_rad: float = 0.25
    range_max_m: float = 8.0
    skipped: int = 0
    mounting: tuple[float, ...] = (0.2, -0.1, 0.3, 0.0, 0.0, 0.0, 1.0)
    static_topic: str = "/tf_static"
    with_tf: bool = True
    with_odometry: bool = True
    with_scans: bool = True
    change: Callable[[int, dict[str, Any]], None] = lambda _number, _fields: None
    extra: list[tuple[str, str, int, dict[str, Any]]] = field(default_factory=list)

    @property
    def stamps_ns(self) -> np.ndarray:
        return self.start_ns + PERIOD_NS * np.arange(self.n_scans)

    @property
    def ranges_m(self) -> np.ndarray:
        rng = np.random.default_rng(3)
        n_drawn = self.skipped + self.n_scans
        ranges = rng.uniform(0.5, 7.0, (n_drawn, self.n_beams)).astype(np.float32)[self.skipped :]
        ranges[:, 0] = np.inf
        ranges[:, 1] = np.nan
        return ranges

    @property
    def poses(self) -> np.ndarray:
        along = self.start_m + self.step_m * np.arange(self.n_scans)
        return np.column_stack(
            [along * np.cos(self.yaw_rad), along * np.sin(self.yaw_rad), np.full(self.n_scans, self.yaw_rad)]
        )

    def messages(self) -> Iterator[tuple[str, str, int, dict[str, Any]]]:
        if self.with_tf:
            yield (
                self.static_topic,
                TF,
                self.start_ns - 1,
                {"transforms": [transform("base_link", "laser", 0, self.mounting)]},
            )
        for number, stamp_ns in enumerate(self.stamps_ns.tolist()):
            x, y, yaw = self.poses[number]
            turn = (0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))
            if self.with_tf:
                moved = transform("odom", "base_link", stamp_ns, (x, y, 0.0, *turn))
                yield "/tf", TF, stamp_ns, {"transforms": [moved]}
            if self.with_odometry:
                yield "/odom", ODOMETRY, stamp_ns, odometry("odom", "base_link", stamp_ns, (x, y, 0.0, *turn))
            if self.with_scans:
                fields = scan(self, stamp_ns, self.ranges_m[number])
                self.change(number, fields)
                yield "/scan", SCAN, stamp_ns + 1000, fields
        yield from self.extra


def stamp(stamp_ns: int) -> dict[str, int]:
    return {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9}


def move_stamps(fields: dict[str, Any], by_ns: int) -> None:
    """Move the stamps of the headers of a message."""
    for one in [fields] if "header" in fields else fields["transforms"]:
        header = one["header"]
        at_ns = header["stamp"]["sec"] * 10**9 + header["stamp"]["nanosec"]
        header["stamp"] = stamp(at_ns + by_ns)


def transform(parent: str, child: str, stamp_ns: int, values: tuple[float, ...]) -> dict[str, Any]:
    return {
        "header": {"stamp": stamp(stamp_ns), "frame_id": parent},
        "child_frame_id": child,
        "transform": {
            "translation": dict(zip("xyz", values[:3], strict=True)),
            "rotation": dict(zip("xyzw", values[3:], strict=True)),
        },
    }


def odometry(parent: str, child: str, stamp_ns: int, values: tuple[float, ...]) -> dict[str, Any]:
    nothing = {"linear": dict.fromkeys("xyz", 0.0), "angular": dict.fromkeys("xyz", 0.0)}
    return {
        "header": {"stamp": stamp(stamp_ns), "frame_id": parent},
        "child_frame_id": child,
        "pose": {
            "pose": {
                "position": dict(zip("xyz", values[:3], strict=True)),
                "orientation": dict(zip("xyzw", values[3:], strict=True)),
            },
            "covariance": np.zeros(36),
        },
        "twist": {"twist": nothing, "covariance": np.zeros(36)},
    }


def scan(world: World, stamp_ns: int, ranges_m: np.ndarray) -> dict[str, Any]:
    return {
        "header": {"stamp": stamp(stamp_ns), "frame_id": "laser"},
        "angle_min": world.first_rad,
        "angle_max": world.first_rad + world.step_rad * (ranges_m.size - 1),
        "angle_increment": world.step_rad,
        "time_increment": 0.001,
        "scan_time": 0.1,
        "range_min": 0.1,
        "range_max": world.range_max_m,
        "ranges": ranges_m,
        "intensities": np.zeros(0, dtype=np.float32),
    }


def build(store: Any, kind: str, fields: dict[str, Any]) -> Any:
    """A message of the store's own classes from nested dictionaries; headers of ROS 1 get their counter."""
    values: dict[str, Any] = {}
    for name, (node, detail) in store.get_msgdef(kind).fields:
        if name not in fields:
            values[name] = 0
        elif node == Nodetype.NAME:
            values[name] = build(store, detail, fields[name])
        elif node == Nodetype.SEQUENCE and detail[0][0] == Nodetype.NAME:
            values[name] = [build(store, detail[0][1], inner) for inner in fields[name]]
        else:
            values[name] = fields[name]
    return store.types[kind](**values)


def write_bag1(path: Path, world: World, prepare: Callable[[Bag1Writer], None] = lambda _: None) -> Path:
    writer = Bag1Writer(path)
    prepare(writer)
    with writer:
        connections: dict[str, Any] = {}
        for topic, kind, logged_ns, fields in world.messages():
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=ROS1)
            writer.write(connections[topic], logged_ns, ROS1.serialize_ros1(build(ROS1, kind, fields), kind))
    return path


def write_bag2(
    path: Path,
    world: World,
    plugin: StoragePlugin = StoragePlugin.SQLITE3,
    mode: CompressionMode = CompressionMode.NONE,
) -> Path:
    writer = Bag2Writer(path, version=9, storage_plugin=plugin)
    if mode is not CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections: dict[str, Any] = {}
        for topic, kind, logged_ns, fields in world.messages():
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=ROS2)
            writer.write(connections[topic], logged_ns, ROS2.serialize_cdr(build(ROS2, kind, fields), kind))
    return path


def lone_file(folder: Path, suffix: str) -> Path:
    """The storage file of a ROS 2 bag, without its metadata."""
    (folder / "metadata.yaml").unlink()
    return next(folder.glob(f"*{suffix}"))


def write_mcap(
    path: Path,
    world: World,
    profile: str,
    encoding: str = "cdr",
    *,
    has_short_names: bool = False,
    prepare: Callable[[McapWriter], None] = lambda _: None,
    **options: Any,
) -> Path:
    """MCAP of any profile; encoding "cdr" (ros2msg), "ros1" (ros1msg) or another name, as is."""
    store, suffix = (ROS1, "ros1msg") if encoding == "ros1" else (ROS2, "ros2msg")
    with path.open("wb") as stream:
        writer = McapWriter(stream, **{"chunk_size": 2000, "compression": CompressionType.ZSTD, **options})
        writer.start(profile=profile, library="test")
        prepare(writer)
        channels: dict[str, int] = {}
        for topic, kind, logged_ns, fields in world.messages():
            if topic not in channels:
                name = kind.replace("/msg/", "/") if encoding == "ros1" or has_short_names else kind
                definition = store.generate_msgdef(kind, ros_version=1 if encoding == "ros1" else 2)[0]
                schema = writer.register_schema(name, suffix, definition.encode())
                channels[topic] = writer.register_channel(topic, encoding, schema)
            message = build(store, kind, fields)
            data = (
                store.serialize_ros1(message, kind)
                if encoding == "ros1"
                else store.serialize_cdr(message, kind)
            )
            writer.add_message(channels[topic], logged_ns, bytes(data), logged_ns)
        writer.finish()
    return path


def packed(path: Path, how: str) -> Path:
    """The file as .gz, .bz2, .xz, .zst or alone in a .zip, under a name that says nothing."""
    target = path.with_name(f"{path.stem}-{how}.dat")
    if how == "zip":
        with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.write(path, f"inner/{path.name}")
    else:
        target.write_bytes(
            {
                "gz": gzip.compress,
                "bz2": bz2.compress,
                "xz": lzma.compress,
                "zst": zstandard.ZstdCompressor(write_checksum=True).compress,
            }[how](path.read_bytes())
        )
    return target


def carmen_line(ranges_m: Any, laser: Any, robot: Any, stamp_text: str, word: str = "FLASER") -> str:
    numbers = [f"{value:.2f}" for value in ranges_m] + [f"{value:.6f}" for value in (*laser, *robot)]
    return f"{word} {len(ranges_m)} {' '.join(numbers)} {stamp_text} host 0.5\n"
