"""Ten hours of a robot with 1080 beams at 40 Hz: memory of reading and building them, and whether the way is right."""

from __future__ import annotations

import math
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from dynmap_cli.arrays import F64
from dynmap_cli.domain.poses import Trajectory, between, compose
from dynmap_cli.files.scan_log import read_scan_log
from dynmap_cli.files.trajectory import read_tum
from tests.bench.mapped import ate_m
from tests.bench.measured import dynmap
from tests.bench.patrol import OFFICE
from tests.bench.tables import Row, Table, number
from tests.bench.worlds import Bench, truth_folder

_HOURS, _HOURS_QUICK = 10.0, 0.5
_INGEST_MB, _BUILD_MB = 400, 2048
_NOISE_M = 0.01
_GAP_NS = 20_000_000
_STORE = get_typestore(Stores.ROS2_HUMBLE)
_TYPES = {
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/scan": "sensor_msgs/msg/LaserScan",
}
_LAPS: dict[str, Any] = {
    **OFFICE,
    "robot": {"repeat": 4, "speed_mps": 0.6},
    "lasers": [
        {
            "beams": 1080,
            "fov_deg": 270,
            "max_range_m": 30,
            "rate_hz": 40,
            "beam_interval_s": 0.000017,
            "dropout_share": 0.01,
            "grazing_deg": 3,
        }
    ],
    "odometry": {"rate_hz": 50, "translation_scale": 1.01, "rotation_scale": 0.985, "bias_degpm": 0.3},
}


def tables(bench: Bench) -> list[Table]:
    """Reading alone, then the whole build, each in a process of its own."""
    hours = _HOURS_QUICK if bench.quick else _HOURS
    table = Table(
        f"A recording of {hours:g} hours",
        [
            "Four simulated laps in an office with people, doors and boxes that change, 1080 beams at 40 Hz, are "
            "repeated with 1 cm of new noise on every beam and odometry that goes on from lap to lap, and written as "
            "an uncompressed MCAP. `dynmap ingest`, then a whole `dynmap build`, each with one thread into an empty "
            f"folder. ATE after alignment. Bounds {_INGEST_MB} and {_BUILD_MB} MB; what misses one is **bold**.",
        ],
        ["", "scans", "million beams", "CPU s", "peak MB", "recording GB", "run directory GB", "ATE m"],
    )
    recording = bench.folder / "logs" / "long.mcap"
    laps = bench.simulated("laps-40hz", _LAPS)
    truth = write_repeated(laps, recording, hours)
    table.add("ingest", lambda: _row(bench, "ingest", recording, truth, _INGEST_MB))
    table.add("build", lambda: _row(bench, "build", recording, truth, _BUILD_MB))
    return [table]


def _row(bench: Bench, verb: str, recording: Path, truth: Trajectory, bound_mb: int) -> Row:
    """One command on the recording; what it wrote is measured and taken away."""
    run_dir = bench.folder / "runs" / f"long-{verb}"
    cost = dynmap(verb, recording, "-o", run_dir, "--force", log=run_dir.with_suffix(".txt"))
    log = read_scan_log(run_dir / "scans")
    path = run_dir / "map" / "trajectory.tum"
    cells = [
        f"{log.n_scans}",
        number(log.n_scans * log.n_beams / 1e6, 0),
        number(cost.cpu_s, 0),
        number(cost.peak_mb, 0) if cost.peak_mb < bound_mb else f"**{number(cost.peak_mb, 0)}**",
        number(recording.stat().st_size / 1e9, 1),
        number(sum(file.stat().st_size for file in run_dir.rglob("*") if file.is_file()) / 1e9, 1),
        number(ate_m(read_tum(path), truth), 4) if path.exists() else "",
    ]
    shutil.rmtree(run_dir)
    return cells


def write_repeated(laps: Path, recording: Path, hours: float) -> Trajectory:
    """Write the laps again and again with new noise until the hours are full; where the robot was at each scan.

    A repetition begins where the robot stands as it does at the end. Its odometry goes on from what it was at the end
    of the one before, by the true step between the two.
    """
    truth = read_tum(truth_folder(laps) / "trajectory.tum")
    begin = _like_the_end(truth.poses)
    truth = Trajectory(truth.stamps_ns[begin:], truth.poses[begin:])
    messages = [one for one in _messages(laps) if one[0] == "/tf_static" or one[1] >= truth.stamps_ns[0]]
    driven = np.array([_pose(message) for topic, _, message in messages if topic == "/tf"])
    to_next = compose(between(driven[0], driven[-1]), between(truth.poses[-1], truth.poses[0]))
    period_ns = messages[-1][1] - int(truth.stamps_ns[0]) + _GAP_NS
    count = math.ceil(hours * 3600e9 / period_ns)
    random = np.random.default_rng(1)
    start = driven[0]
    with recording.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start("ros2", "dynmap tests")
        channels = {topic: _channel(writer, topic, kind) for topic, kind in _TYPES.items()}
        for repetition in range(count):
            odometry = iter(compose(start, between(driven[0], driven)))
            noise_m = _NOISE_M if repetition else 0.0
            for topic, logged_ns, message in messages:
                later_ns = repetition * period_ns
                if topic == "/tf":
                    later = _transform(message, later_ns, next(odometry))
                elif topic == "/scan":
                    later = _scan(message, later_ns, noise_m, random)
                else:
                    later = message
                content = _STORE.serialize_cdr(later, _TYPES[topic])
                writer.add_message(channels[topic], logged_ns + later_ns, content, logged_ns + later_ns)
            start = compose(start, to_next)
        writer.finish()
    stamps_ns = truth.stamps_ns + period_ns * np.arange(count)[:, None]
    return Trajectory(stamps_ns.ravel(), np.tile(truth.poses, (count, 1)))


def _like_the_end(poses: F64) -> int:
    """Which pose of the first half is most like the last one."""
    error = between(poses[-1], poses[: len(poses) // 2])
    return int(np.argmin(np.hypot(error[:, 0], error[:, 1]) + np.abs(error[:, 2])))


def _messages(laps: Path) -> list[tuple[str, int, Any]]:
    """Topic, log time and content of what is repeated."""
    with AnyReader([laps], default_typestore=_STORE) as reader:
        return [
            (connection.topic, logged_ns, reader.deserialize(data, connection.msgtype))
            for connection, logged_ns, data in reader.messages()
            if connection.topic in _TYPES
        ]


def _channel(writer: Writer, topic: str, kind: str) -> int:
    """A channel with the definition of its type."""
    definition, _ = _STORE.generate_msgdef(kind, ros_version=2)
    return writer.register_channel(topic, "cdr", writer.register_schema(kind, "ros2msg", definition.encode()))


def _pose(message: Any) -> tuple[float, float, float]:
    """Odometry as x, y, yaw."""
    moved = message.transforms[0].transform
    return moved.translation.x, moved.translation.y, 2.0 * math.atan2(moved.rotation.z, moved.rotation.w)


def _later(header: Any, by_ns: int) -> Any:
    """The header with a later stamp."""
    stamp = header.stamp
    sec, nanosec = divmod(stamp.sec * 10**9 + stamp.nanosec + by_ns, 10**9)
    return replace(header, stamp=replace(stamp, sec=sec, nanosec=nanosec))


def _transform(message: Any, later_ns: int, pose: F64) -> Any:
    """The message with a later stamp and another pose."""
    old = message.transforms[0]
    x_m, y_m, yaw_rad = map(float, pose)
    moved = replace(
        old.transform,
        translation=replace(old.transform.translation, x=x_m, y=y_m),
        rotation=replace(old.transform.rotation, z=math.sin(yaw_rad / 2), w=math.cos(yaw_rad / 2)),
    )
    return replace(message, transforms=[replace(old, header=_later(old.header, later_ns), transform=moved)])


def _scan(message: Any, later_ns: int, noise_m: float, random: np.random.Generator) -> Any:
    """The scan with a later stamp and new noise."""
    noise = random.standard_normal(message.ranges.size, dtype=np.float32) * np.float32(noise_m)
    return replace(message, header=_later(message.header, later_ns), ranges=message.ranges + noise)
