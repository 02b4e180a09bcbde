"""Whole recordings of every kind, small, and how they are read."""

from __future__ import annotations

import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from dynmap_cli.checking import check_recordings
from dynmap_cli.config import Config
from dynmap_cli.errors import LogError
from dynmap_cli.export.salvaging import write_salvaged
from dynmap_cli.ingest.messages.stored import ORPHAN
from dynmap_cli.ingest.reading import load_recordings
from dynmap_cli.ingest.settings import IngestSettings
from tests.ingest import written
from tests.ingest.written_foxglove import write_foxglove

WORLD, FEW = written.World(n_scans=8, n_beams=12), written.World(n_scans=4, n_beams=12)
SMALL = IngestSettings(max_unpacked_gib=0.05)
_NUMBERS = " ".join(f"{value}" for value in range(100, 280))
_PLAIN: dict[str, Any] = {"compression": CompressionType.NONE, "enable_crcs": False}


def ingest(folder: Path, settings: IngestSettings) -> object:
    """All that `dynmap check` does: read, choose, merge, and say whether it can be built."""
    (path,) = folder.iterdir()
    found = check_recordings([path], Config(ingest=settings))
    if found.refusals:
        raise LogError(found.refusals[0].why)
    return found


def salvage(folder: Path) -> object:
    """Copy what is whole into an MCAP file, which is whole and holds all that the reader finds, or says why not."""
    (path,) = folder.iterdir()
    out = folder.parent / f"{folder.name}.salvaged.mcap"
    try:
        done = write_salvaged([path], out, SMALL)
        (copied,) = load_recordings([out], SMALL)
    finally:
        out.unlink(missing_ok=True)
    (read,) = load_recordings([path], SMALL)
    # Messages that are broken themselves are copied byte for byte.
    faults = [why for why in copied.damage if why not in copied.dropped]
    n_read = sum(topic.count for topic in read.topics) + read.dropped[ORPHAN]
    assert not faults, f"the copy is damaged: {faults}"
    assert done.losses or done.messages.total() == n_read, f"{n_read - done.messages.total()} lost in silence"
    return done


def write_packed(folder: Path, how: str) -> None:
    """A text log, packed."""
    path = _carmen(folder)
    target = written.packed(path, how)
    path.unlink()
    target.rename(folder / f"a.log.{how}")


def _carmen(folder: Path) -> Path:
    lines = []
    for number, (ranges, pose) in enumerate(zip(WORLD.ranges_m, WORLD.poses, strict=True)):
        ranges_m = np.nan_to_num(ranges, nan=1.5, posinf=81.83)
        stamp = f"{1000 + 0.1 * number:.6f}"
        lines.append(written.carmen_line(ranges_m, pose, pose, stamp))
        x, y, yaw = pose
        lines.append(f"ODOM {x:.4f} {y:.4f} {yaw:.4f} 0.5 0 0 {stamp} host 0.5\n")
        values = " ".join(f"{value:.2f}" for value in ranges_m)
        poses = " ".join(f"{value:.4f}" for value in (*pose, *pose))
        lines.append(
            f"ROBOTLASER1 0 -1.5708 3.1416 0.2618 81.9 0.01 0 {ranges_m.size} {values} 0 "
            f"{poses} 0 0 0.3 0.3 1e6 {stamp} host 0.5\n"
        )
    path = folder / "a.log"
    path.write_text("# CARMEN log\n" + "".join(lines))
    return path


def _wean(folder: Path) -> Path:
    lines = [
        f"O {10 * k} 0 0.1 {0.1 * k:.2f}\nL {10 * k} 0 0.1 {10 * k + 25} 0 0.1 {_NUMBERS} {0.1 * k:.2f}\n"
        for k in range(6)
    ]
    path = folder / "a.log"
    path.write_text("".join(lines))
    return path


def _cloud(folder: Path) -> Path:
    """An MCAP file with a point cloud instead of a laser."""
    points = np.zeros(40, dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("i", "<f4")])
    bearings = np.linspace(-3.0, 3.0, 40)
    ranges_m = np.linspace(1.0, 5.0, 40)
    points["x"], points["y"], points["z"] = ranges_m * np.cos(bearings), ranges_m * np.sin(bearings), 0.3
    fields = [
        {"name": name, "offset": 4 * number, "datatype": 7, "count": 1} for number, name in enumerate("xyzi")
    ]
    clouds = [
        (
            "/points",
            "sensor_msgs/msg/PointCloud2",
            stamp_ns + 1000,
            {
                "header": {"stamp": written.stamp(stamp_ns), "frame_id": "laser"},
                "height": 1,
                "width": 40,
                "fields": fields,
                "is_bigendian": False,
                "point_step": 16,
                "row_step": 640,
                "data": np.frombuffer(points.tobytes(), dtype=np.uint8),
                "is_dense": True,
            },
        )
        for stamp_ns in WORLD.stamps_ns.tolist()
    ]
    world = written.World(n_scans=8, n_beams=12, with_scans=False, extra=clouds)
    return written.write_bag1(folder / "a.bag", world)


def _folder(folder: Path) -> Path:
    return written.write_bag2(folder / "a", WORLD)


def _plain_mcap(folder: Path) -> Path:
    """Neither checksums nor compression, so that wrong bytes reach the messages."""
    return written.write_mcap(folder / "a.mcap", WORLD, "ros2", **_PLAIN)


def _packed_folder(folder: Path, mode: CompressionMode) -> Path:
    """A folder whose messages, or whose files, are packed."""
    return written.write_bag2(folder / "a", WORLD, mode=mode)


def _bare_mcap(folder: Path) -> Path:
    """An MCAP file without chunks, with an attachment and metadata."""

    def add(writer: McapWriter) -> None:
        writer.add_attachment(1, 1, "notes.txt", "text/plain", b"a note")
        writer.add_metadata("robot", {"name": "Rhino"})

    return written.write_mcap(folder / "a.mcap", FEW, "ros2", prepare=add, use_chunking=False, **_PLAIN)


def _bare_db3(folder: Path) -> None:
    lone = written.lone_file(written.write_bag2(folder / "b", FEW), ".db3")
    shutil.move(lone, folder / "a.db3")
    shutil.rmtree(folder / "b")


def _zip(folder: Path) -> None:
    """A .zip that holds a folder of a bag."""
    inner = written.write_bag2(folder / "a", FEW)
    with zipfile.ZipFile(folder / "a.zip", "w") as archive:
        for path in sorted(inner.iterdir()):
            archive.write(path, f"a/{path.name}")
    shutil.rmtree(inner)


SAMPLES: dict[str, Callable[[Path], object]] = {
    "ros1": lambda folder: written.write_bag1(folder / "a.bag", WORLD),
    "ros1 cloud": _cloud,
    "db3": lambda folder: (
        shutil.move(written.lone_file(written.write_bag2(folder / "b", WORLD), ".db3"), folder / "a.db3")
        and shutil.rmtree(folder / "b")
    ),
    "folder": _folder,
    "folder of packed messages": lambda folder: _packed_folder(folder, CompressionMode.MESSAGE),
    "folder of packed files": lambda folder: _packed_folder(folder, CompressionMode.FILE),
    "folder of mcap": lambda folder: written.write_bag2(folder / "a", WORLD, StoragePlugin.MCAP),
    "mcap plain": _plain_mcap,
    "mcap ros2": lambda folder: written.write_mcap(folder / "a.mcap", WORLD, "ros2"),
    "mcap ros1": lambda folder: written.write_mcap(folder / "a.mcap", WORLD, "ros1", "ros1", **_PLAIN),
    "foxglove json": lambda folder: write_foxglove(folder / "a.mcap", WORLD, "json", **_PLAIN),
    "foxglove protobuf": lambda folder: write_foxglove(folder / "a.mcap", WORLD, "protobuf", **_PLAIN),
    "unchunked": lambda folder: write_foxglove(
        folder / "a.mcap", WORLD, "protobuf", use_chunking=False, enable_crcs=False
    ),
    "carmen": _carmen,
    "wean": _wean,
}
INSIDE: dict[str, tuple[Callable[[Path], object], str]] = {
    "rows of tables": (_bare_db3, "rows"),
    "records": (_bare_mcap, "records"),
    "records with chunks": (_plain_mcap, "records"),
    "definitions": (_bare_mcap, "definitions"),
    "members": (_zip, "members"),
}
"""Recordings that are taken apart, so that what they hold is damaged, and how."""
