"""Formats of recordings, told by the first bytes of a file and not by its name."""

from __future__ import annotations

import re
from pathlib import Path

from dynmap_cli.errors import LogError
from dynmap_cli.files.damage import reason
from dynmap_cli.ingest.containers.foreign import foreign
from dynmap_cli.ingest.text.text_lines import BYTE_ORDER_MARK
from dynmap_cli.printable import printable

KNOWN = (
    "CARMEN text, Wean Hall text, ROS 1 bag, ROS 2 bag (folder, .db3 or .mcap), MCAP of ROS 1 or Foxglove, "
    "each plain, .gz, .bz2, .xz, .zst or in a .zip"
)
_MAGIC = (
    (b"#ROSBAG V2.0", "ros1"),
    (b"\x89MCAP0\r\n", "mcap"),
    (b"SQLite format 3\x00", "db3"),
    (b"\x1f\x8b", "gzip"),
    (b"BZh", "bzip2"),
    (b"\xfd7zXZ\x00", "xz"),
    (b"\x28\xb5\x2f\xfd", "zstd"),
    # Frames to be skipped, as pzstd puts them before each of its own.
    *((bytes([0x50 + number]) + b"\x2a\x4d\x18", "zstd") for number in range(16)),
    (b"PK\x03\x04", "zip"),
    (b"PK\x05\x06", "zip"),
)
_CARMEN = re.compile(
    rb"^(#.*CARMEN|(FLASER|RLASER|ROBOTLASER\d|RAWLASER\d|ODOM|PARAM|SYNC)[ \t])", re.MULTILINE
)
_WEAN = re.compile(rb"^[OL]( -?[0-9.]+){4}", re.MULTILINE)
HEAD_BYTES = 1 << 16
"""As many of the first bytes as a format is told by."""
_LEAST_PRINTABLE = 0.9


def kind_of(path: Path, name: str) -> str:
    """Tell a format from the first bytes of a file.

    Raises
    ------
    LogError
        If the file is empty, of an old format that is not read, or unknown.
    """
    try:
        with path.open("rb") as stream:
            head = stream.read(HEAD_BYTES)
    except OSError as err:
        msg = f"{name}: cannot be read ({reason(err)})"
        raise LogError(msg) from err
    return kind_of_head(head, name)


def kind_of_head(head: bytes, name: str) -> str:
    """Tell a format from its first bytes."""
    if not head:
        msg = f"{name}: the file is empty"
        raise LogError(msg)
    for magic, kind in _MAGIC:
        if head.startswith(magic):
            return kind
    if head.startswith((b"#ROSRECORD", b"#ROSBAG")):
        version = printable(head.split(b"\n", 1)[0].decode("ascii", "replace").strip()[:40])
        msg = (
            f"{name}: '{version}' is a bag format older than '#ROSBAG V2.0', which is not read. "
            "Convert it with the rosbag of its time."
        )
        raise LogError(msg)
    text = head.removeprefix(BYTE_ORDER_MARK)
    if _is_text(text):
        if _CARMEN.search(text):
            return "carmen"
        if _WEAN.search(text):
            return "wean"
    what = foreign(text) or f"not a known recording (it starts with {head[:16]!r})."
    msg = f"{name}: {what} Known are: {KNOWN}."
    raise LogError(msg)


def _is_text(head: bytes) -> bool:
    """Whether bytes are text, apart from the null bytes that unclean shutdowns leave in files."""
    rest = head.replace(b"\x00", b"")
    printable = sum(32 <= byte < 127 or byte in b"\t\r\n" for byte in rest)
    return bool(rest) and printable >= _LEAST_PRINTABLE * len(rest)
