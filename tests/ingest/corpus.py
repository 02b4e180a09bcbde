"""The same drive in every variant of every container, and which of its scans a part of a file holds whole."""

from __future__ import annotations

import bz2
import gzip
import lzma
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import yaml
import zstandard
from mcap.writer import CompressionType, IndexType
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from tests.ingest.written import (
    PERIOD_NS,
    START_NS,
    World,
    carmen_line,
    lone_file,
    write_bag1,
    write_bag2,
    write_mcap,
)
from tests.ingest.written_foxglove import write_foxglove

WORLD = World(n_scans=60, n_beams=40, step_rad=0.05)
_CHUNK_BYTES = 4000
_PAGE_BYTES = 4096
_CHUNK, _MESSAGE = 6, 5
_ODD_CM = 7


def _bag1(how: str) -> Callable[[Path], Path]:
    """A ROS 1 bag of small chunks."""

    def write(folder: Path) -> Path:
        def prepare(writer: Bag1Writer) -> None:
            writer.chunk_threshold = _CHUNK_BYTES
            if how:
                writer.set_compression(Bag1Writer.CompressionFormat[how.upper()])

        return write_bag1(folder / "a.bag", WORLD, prepare)

    return write


def _unindexed_bag1(folder: Path) -> Path:
    """A bag that was not closed: the header does not say where its index is, and there is none."""
    path = _bag1("")(folder)
    data = bytearray(path.read_bytes())
    at = data.index(b"index_pos=") + len(b"index_pos=")
    end = int.from_bytes(data[at : at + 8], "little")
    data[at : at + 8] = bytes(8)
    path.write_bytes(data[:end])
    return path


def _bag2(plugin: StoragePlugin, mode: CompressionMode = CompressionMode.NONE) -> Callable[[Path], Path]:
    """A ROS 2 bag folder."""
    return lambda folder: write_bag2(folder / "a", WORLD, plugin, mode)


def _lone(plugin: StoragePlugin, suffix: str, mode: CompressionMode = CompressionMode.NONE) -> Any:
    """The one file of a ROS 2 bag, without its metadata."""
    return lambda folder: lone_file(write_bag2(folder / "a", WORLD, plugin, mode), suffix)


def _split(suffix: str, plugin: StoragePlugin, *, has_metadata: bool) -> Callable[[Path], Path]:
    """A ROS 2 bag that was split in the middle."""

    def write(folder: Path) -> Path:
        half = World(n_scans=30, n_beams=40, step_rad=0.05)
        second = World(
            n_scans=30, n_beams=40, step_rad=0.05, start_ns=START_NS + 30 * PERIOD_NS, start_m=1.5, skipped=30
        )
        first = write_bag2(folder / "a", half, plugin)
        other = write_bag2(folder / "b", second, plugin)
        names = []
        for number, part in enumerate((first, other)):
            names.append(f"a_{number}{suffix}")
            next(part.glob(f"*{suffix}")).rename(first / names[-1])
        said = yaml.safe_load((first / "metadata.yaml").read_text())
        content = said["rosbag2_bagfile_information"]
        content["relative_file_paths"] = names
        content["message_count"] *= 2
        content["duration"]["nanoseconds"] = 60 * PERIOD_NS
        for topic in content["topics_with_message_count"]:
            topic["message_count"] *= 2
        content["files"] = [
            {
                "path": name,
                "starting_time": {"nanoseconds_since_epoch": START_NS + 30 * number * PERIOD_NS},
                "duration": {"nanoseconds": 30 * PERIOD_NS},
                "message_count": content["message_count"] // 2,
            }
            for number, name in enumerate(names)
        ]
        (first / "metadata.yaml").write_text(yaml.safe_dump(said))
        if not has_metadata:
            (first / "metadata.yaml").unlink()
        return first

    return write


def _mcap(profile: str, encoding: str = "cdr", **options: Any) -> Callable[[Path], Path]:
    return lambda folder: write_mcap(folder / "a.mcap", WORLD, profile, encoding, **options)


def _foxglove(encoding: str, profile: str = "", **options: Any) -> Callable[[Path], Path]:
    return lambda folder: write_foxglove(folder / "a.mcap", WORLD, encoding, profile, **options)


def text_ranges_m() -> np.ndarray:
    """What a text log says of the ranges: centimetres, and a code for no return."""
    return np.round(np.nan_to_num(WORLD.ranges_m, nan=1.5, posinf=81.83), 2)


def _carmen(folder: Path) -> Path:
    lines = [
        carmen_line(ranges, pose, pose, f"{1000 + 0.1 * number:.6f}")
        for number, (ranges, pose) in enumerate(zip(text_ranges_m(), WORLD.poses, strict=True))
    ]
    path = folder / "a.log"
    path.write_text("".join(lines))
    return path


def wean_ranges_cm() -> np.ndarray:
    """(60, 180) whole centimetres."""
    return 100 + (np.arange(60)[:, None] * 37 + np.arange(180) * _ODD_CM) % 600


def _wean(folder: Path) -> Path:
    lines = []
    for number, ranges in enumerate(wean_ranges_cm()):
        x, stamp = 5 * number, f"{0.1 * number:.6f}"
        lines.append(f"O {x} 0 0.3 {stamp}\n")
        lines.append(f"L {x} 0 0.3 {x} 0 0.3 {' '.join(map(str, ranges))} {stamp}\n")
    path = folder / "a.log"
    path.write_text("".join(lines))
    return path


_PACKERS: dict[str, Callable[[bytes], bytes]] = {
    "gz": gzip.compress,
    "bz2": bz2.compress,
    "xz": lzma.compress,
    "zst": lambda data: zstandard.ZstdCompressor(write_checksum=True).compress(data),
}


def _packed(write: Callable[[Path], Path], how: str) -> Callable[[Path], Path]:
    def pack(folder: Path) -> Path:
        path = write(folder)
        target = folder / f"packed.{how}"
        if how == "zip":
            with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
                for inner in [path] if path.is_file() else sorted(path.iterdir()):
                    archive.write(inner, inner.relative_to(folder))
        else:
            target.write_bytes(_PACKERS[how](path.read_bytes()))
        return target

    return pack


_SQLITE, _MCAP = StoragePlugin.SQLITE3, StoragePlugin.MCAP
FILES: dict[str, Callable[[Path], Path]] = {
    "ros1": _bag1(""),
    "ros1 bz2": _bag1("bz2"),
    "ros1 lz4": _bag1("lz4"),
    "ros1 unindexed": _unindexed_bag1,
    "db3": _lone(_SQLITE, ".db3"),
    "db3 of packed messages": _lone(_SQLITE, ".db3", CompressionMode.MESSAGE),
    "mcap ros2": _mcap("ros2"),
    "mcap ros2 lz4": _mcap("ros2", compression=CompressionType.LZ4),
    "mcap ros2 none": _mcap("ros2", compression=CompressionType.NONE),
    "mcap blank": _mcap(""),
    "mcap ros1": _mcap("ros1", "ros1"),
    "mcap unchunked": _mcap("ros2", use_chunking=False),
    "mcap unindexed": _mcap("ros2", index_types=IndexType.NONE),
    "mcap without summary": _mcap(
        "ros2",
        index_types=IndexType.NONE,
        repeat_channels=False,
        repeat_schemas=False,
        use_statistics=False,
        use_summary_offsets=False,
    ),
    "foxglove json": _foxglove("json"),
    "foxglove protobuf": _foxglove("protobuf", "ros2"),
    "foxglove unchunked": _foxglove("protobuf", use_chunking=False),
    "carmen": _carmen,
    "wean": _wean,
    **{f"carmen {how}": _packed(_carmen, how) for how in (*_PACKERS, "zip")},
    "wean gz": _packed(_wean, "gz"),
    **{f"ros1 in {how}": _packed(_bag1(""), how) for how in (*_PACKERS, "zip")},
    **{f"mcap in {how}": _packed(_mcap("ros2"), how) for how in ("gz", "zst", "zip")},
    "db3 in zst": _packed(_lone(_SQLITE, ".db3"), "zst"),
}
"""Single files, which are also cut and damaged."""
FOLDERS: dict[str, Callable[[Path], Path]] = {
    "folder db3": _bag2(_SQLITE),
    "folder mcap": _bag2(_MCAP),
    "folder db3, packed file": _bag2(_SQLITE, CompressionMode.FILE),
    "folder db3, packed messages": _bag2(_SQLITE, CompressionMode.MESSAGE),
    "folder mcap, packed file": _bag2(_MCAP, CompressionMode.FILE),
    "folder db3, split": _split(".db3", _SQLITE, has_metadata=True),
    "folder mcap, split": _split(".mcap", _MCAP, has_metadata=True),
    "folder db3, split, no metadata": _split(".db3", _SQLITE, has_metadata=False),
    "folder mcap, split, no metadata": _split(".mcap", _MCAP, has_metadata=False),
    "lone packed db3": _lone(_SQLITE, ".db3.zstd", CompressionMode.FILE),
    "lone packed mcap": _lone(_MCAP, ".mcap.zstd", CompressionMode.FILE),
    "folder in zip": _packed(_bag2(_SQLITE), "zip"),
}


def scans_within(variant: str, data: bytes, n_bytes: int) -> int:
    """How many scans the first bytes of a file of a variant hold whole; found without the readers of dynmap."""
    inner, _, how = variant.partition(" in ")
    if not how and variant.split(maxsplit=1)[0] in {"carmen", "wean"}:
        inner, _, how = variant.partition(" ")
    if not how:
        return sum(end <= n_bytes for end in scan_ends(inner, data))
    whole, part = unpacked(data, how), unpacked(data[:n_bytes], how)
    kind = {"mcap": "mcap ros2"}.get(inner, inner)
    return sum(end <= len(part) for end in scan_ends(kind, whole))


def unpacked(data: bytes, how: str) -> bytes:
    """What the libraries make of the start of a packed file."""
    if how == "zip":
        at = 30 + int.from_bytes(data[26:28], "little") + int.from_bytes(data[28:30], "little")
        return zlib.decompressobj(-15).decompress(data[at:]) if len(data) > at else b""
    decoder: Any = {
        "gz": lambda: zlib.decompressobj(31),
        "bz2": bz2.BZ2Decompressor,
        "xz": lzma.LZMADecompressor,
        "zst": lambda: zstandard.ZstdDecompressor().decompressobj(),
    }[how]()
    return bytes(decoder.decompress(data))


def scan_ends(variant: str, data: bytes) -> list[int]:
    """Where the part of a file ends that holds each scan whole: the message itself, its block, its line or its page."""
    if variant in {"carmen", "wean"}:
        starts = b"F" if variant == "carmen" else b"L"
        ends = [at + 1 for at, byte in enumerate(data) if byte == ord("\n")]
        return [
            end for start, end in zip([0, *ends], ends, strict=False) if data[start : start + 1] == starts
        ]
    if variant.startswith("ros1"):
        return _bag1_ends(data)
    if variant.startswith("db3"):
        if "messages" in variant:
            # The rows are packed; of a database that is cut the last page is not counted upon.
            return [len(data)] * WORLD.n_scans
        ends = [data.find(ranges.tobytes()) + ranges.nbytes for ranges in WORLD.ranges_m]
        return [-(-end // _PAGE_BYTES) * _PAGE_BYTES for end in ends]
    return _mcap_ends(data)


def _bag1_ends(data: bytes) -> list[int]:
    """Ends of the chunks of a ROS 1 bag, once for each scan in them; in plain chunks of the scans themselves."""
    ends: list[int] = []
    at = 13
    while at + 4 <= len(data):
        head_bytes = int.from_bytes(data[at : at + 4], "little")
        head = data[at + 4 : at + 4 + head_bytes]
        at += 4 + head_bytes
        size = int.from_bytes(data[at : at + 4], "little")
        content = data[at + 4 : at + 4 + size]
        at += 4 + size
        if b"compression=bz2" in head:
            content = bz2.decompress(content)
        elif b"compression=lz4" in head:
            content = lz4.frame.decompress(content)
        if b"compression=" in head:
            places = [content.find(ranges.tobytes()) for ranges in WORLD.ranges_m]
            is_plain = b"compression=none" in head
            ends += [
                at - len(content) + place + WORLD.ranges_m[0].nbytes + 4 if is_plain else at
                for place in places
                if place >= 0
            ]
    return ends


def _mcap_ends(data: bytes) -> list[int]:
    """Ends of the chunks of an MCAP file, once for each scan in them, or of the scans themselves."""
    ends, at = [], 8
    while at < len(data) - 8:
        op, size = data[at], int.from_bytes(data[at + 1 : at + 9], "little")
        at += 9 + size
        content = data[at - size : at]
        if op == _CHUNK:
            name_bytes = int.from_bytes(content[28:32], "little")
            name, packed = content[32 : 32 + name_bytes], content[40 + name_bytes :]
            if name == b"zstd":
                packed = zstandard.ZstdDecompressor().decompressobj().decompress(packed)
            elif name == b"lz4":
                packed = lz4.frame.decompress(packed)
            ends += [at] * _number_of_scans(packed)
        elif op == _MESSAGE and _is_scan(content):
            ends.append(at)
    return ends


def _number_of_scans(records: bytes) -> int:
    """Scans among the records of a chunk."""
    at, count = 0, 0
    while at < len(records):
        size = int.from_bytes(records[at + 1 : at + 9], "little")
        count += records[at] == _MESSAGE and _is_scan(records[at + 9 :])
        at += 9 + size
    return count


def _is_scan(content: bytes) -> bool:
    """Whether a message was recorded a microsecond after its stamp, as only scans are here."""
    return (int.from_bytes(content[6:14], "little") - START_NS) % PERIOD_NS == 1000
