"""From a path to plain recordings: unpacks .gz, .bz2, .xz and .zip; tells formats apart by content, not by name."""

from __future__ import annotations

import bz2
import gzip
import lzma
import re
import shutil
import stat
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from dynmap_cli.errors import LogError
from dynmap_cli.files.damage import reason

KNOWN = (
    "CARMEN text, Wean Hall text, ROS 1 bag, ROS 2 bag (folder, .db3 or .mcap), "
    "each plain, .gz, .bz2, .xz or in a .zip"
)
_MAGIC = (
    (b"#ROSBAG V2.0", "ros1"),
    (b"\x89MCAP0\r\n", "mcap"),
    (b"SQLite format 3\x00", "db3"),
    (b"\x1f\x8b", "gzip"),
    (b"BZh", "bzip2"),
    (b"\xfd7zXZ\x00", "xz"),
    (b"PK\x03\x04", "zip"),
    (b"PK\x05\x06", "zip"),
)
_COMPRESSED = {"gzip", "bzip2", "xz"}
_SUFFIXES = {"ros1": ".bag", "db3": ".db3", "mcap": ".mcap"}
_CARMEN = re.compile(
    rb"^(#.*CARMEN|(FLASER|RLASER|ROBOTLASER\d|RAWLASER\d|ODOM|PARAM|SYNC)[ \t])", re.MULTILINE
)
_WEAN = re.compile(rb"^[OL]( -?[0-9.]+){4}", re.MULTILINE)
_HEAD_BYTES = 1 << 16
_BLOCK_BYTES = 1 << 20
_LONGEST_SHOWN = 200
_LEAST_PRINTABLE = 0.9
_MOST_LAYERS, _MOST_MEMBERS = 5, 10_000
_UNPACK_ERRORS = (
    EOFError,
    OSError,
    ValueError,
    OverflowError,
    MemoryError,
    zlib.error,
    lzma.LZMAError,
    zipfile.BadZipFile,
    RuntimeError,  # encrypted members
    NotImplementedError,  # unknown compression
)


@dataclass(frozen=True, slots=True)
class Source:
    """A plain file or folder to read.

    Attributes
    ----------
    name : str
        The path as the operator gave it: two recordings may have one file name.
    kind : str
        "carmen", "wean", "ros1", "ros2" (folder), "db3" or "mcap".
    path : Path
        Where the unpacked content is; bags have the suffix of their kind.
    """

    name: str
    kind: str
    path: Path


def find_sources(path: Path, scratch: Path, limit_bytes: int) -> list[Source]:
    """Recordings at *path*, unpacked into *scratch* where need be.

    Parameters
    ----------
    path : Path
        A file, a ROS 2 bag folder, or a folder of recordings.
    scratch : Path
        Private folder for what is unpacked.
    limit_bytes : int
        The most that may be unpacked from one file.

    Raises
    ------
    LogError
        If there is nothing to read, or nothing that is known.
    """
    check_path(path)
    if not path.is_dir():
        return [_source_of_file(path, str(path), scratch, limit_bytes)]
    if (path / "metadata.yaml").is_file():
        return [Source(str(path), "ros2", path)]
    files = sorted(inner for inner in path.iterdir() if inner.is_file() and _looks_like_recording(inner))
    if not files:
        msg = f"{path}: a folder without recordings and without metadata.yaml. Known are: {KNOWN}."
        raise LogError(msg)
    return [_source_of_file(inner, str(inner), scratch, limit_bytes) for inner in files]


def check_path(path: Path) -> None:
    """Refuse what is neither a regular file nor a folder of them: reading a pipe or a device may never end.

    Raises
    ------
    LogError
        If it is missing, cannot be looked at, or is of another kind.
    """
    try:
        mode = path.stat().st_mode
        inner = sorted(path.iterdir()) if stat.S_ISDIR(mode) else []
        is_bag = any(found.name == "metadata.yaml" for found in inner)
        odd = [found for found in inner if is_bag and not (found.is_file() or found.is_dir())]
    except FileNotFoundError as err:
        msg = f"{path}: no such file or folder"
        raise LogError(msg) from err
    except (OSError, ValueError) as err:
        shown = str(path) if len(str(path)) <= _LONGEST_SHOWN else f"{str(path)[:_LONGEST_SHOWN]}..."
        msg = f"{shown}: cannot be read ({reason(err)})"
        raise LogError(msg) from err
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        odd = [path]
    if odd:
        msg = f"{odd[0]}: neither a regular file nor a folder. Copy the recording into a file first."
        raise LogError(msg)


def _source_of_file(path: Path, name: str, scratch: Path, limit_bytes: int, layers: int = 0) -> Source:
    """Unpack a file until something plain is left."""
    kind = kind_of(path, name)
    if layers > _MOST_LAYERS:
        msg = f"{name}: packed more than {_MOST_LAYERS} times over. Unpack it and pass the recording inside."
        raise LogError(msg)
    if kind == "zip":
        return _source_in_zip(path, name, scratch, limit_bytes, layers)
    if kind in _COMPRESSED:
        target = _new_folder(scratch) / "unpacked"
        try:
            with _decompressed(path, kind) as stream:
                _copy_limited(stream, target, limit_bytes, name)
        except _UNPACK_ERRORS as err:
            raise _cannot_unpack(name, kind, err) from err
        return _source_of_file(target, name, scratch, limit_bytes, layers + 1)
    return Source(name, kind, _with_suffix(path, kind, scratch))


def _with_suffix(path: Path, kind: str, scratch: Path) -> Path:
    """The file under a name that ends as its kind wants it, for rosbags goes by the name."""
    suffix = _SUFFIXES.get(kind, path.suffix)
    if path.suffix == suffix:
        return path
    link = _new_folder(scratch) / f"recording{suffix}"
    link.symlink_to(path.resolve())
    return link


def _decompressed(path: Path, kind: str) -> gzip.GzipFile | bz2.BZ2File | lzma.LZMAFile:
    """Open a compressed file."""
    if kind == "xz":
        return lzma.LZMAFile(path)
    return gzip.GzipFile(path) if kind == "gzip" else bz2.BZ2File(path)


def kind_of(path: Path, name: str) -> str:
    """Tell a format from the first bytes of a file.

    Raises
    ------
    LogError
        If the file is empty, of an old format that is not read, or unknown.
    """
    try:
        with path.open("rb") as stream:
            head = stream.read(_HEAD_BYTES)
    except OSError as err:
        msg = f"{name}: cannot be read ({reason(err)})"
        raise LogError(msg) from err
    return _kind_of_head(head, name)


def _kind_of_head(head: bytes, name: str) -> str:
    """Tell a format from its first bytes."""
    if not head:
        msg = f"{name}: the file is empty"
        raise LogError(msg)
    for magic, kind in _MAGIC:
        if head.startswith(magic):
            return kind
    if head.startswith((b"#ROSRECORD", b"#ROSBAG")):
        version = head.split(b"\n", 1)[0].decode("ascii", "replace").strip()[:40]
        msg = (
            f"{name}: '{version}' is a bag format older than '#ROSBAG V2.0', which is not read. "
            "Convert it with the rosbag of its time."
        )
        raise LogError(msg)
    if _is_text(head):
        if _CARMEN.search(head):
            return "carmen"
        if _WEAN.search(head):
            return "wean"
    msg = f"{name}: not a known recording (it starts with {head[:16]!r}). Known are: {KNOWN}."
    raise LogError(msg)


def _is_text(head: bytes) -> bool:
    """Whether bytes are text, apart from the null bytes that unclean shutdowns leave in files."""
    rest = head.replace(b"\x00", b"")
    printable = sum(32 <= byte < 127 or byte in b"\t\r\n" for byte in rest)
    return bool(rest) and printable >= _LEAST_PRINTABLE * len(rest)


def _looks_like_recording(path: Path) -> bool:
    """Whether a file in a folder is of a known format; others lie beside recordings and are passed over."""
    try:
        kind = kind_of(path, path.name)
        if kind in _COMPRESSED:
            with _decompressed(path, kind) as stream:
                kind = _kind_of_head(stream.read(_HEAD_BYTES), path.name)
    except (LogError, *_UNPACK_ERRORS):
        return False
    return kind != "zip" or path.suffix == ".zip"


def _source_in_zip(path: Path, name: str, scratch: Path, limit_bytes: int, layers: int) -> Source:
    """The one recording inside a .zip."""
    folder = _new_folder(scratch)
    try:
        with zipfile.ZipFile(path) as archive:
            members = [m for m in archive.infolist() if not m.is_dir() and "__MACOSX" not in m.filename]
            _refuse_unsafe(members, folder, name)
            left = limit_bytes
            for member in members:
                target = folder / member.filename
                target.parent.mkdir(parents=True, exist_ok=True)
                with archive.open(member) as stream:
                    left -= _copy_limited(stream, target, left, name)
    except _UNPACK_ERRORS as err:
        raise _cannot_unpack(name, "zip", err) from err
    folders = sorted({found.parent for found in folder.rglob("metadata.yaml")})
    files = sorted(inner for inner in folder.rglob("*") if inner.is_file() and _looks_like_recording(inner))
    loose = [inner for inner in files if inner.parent not in folders]
    found = [*folders, *loose]
    if len(found) != 1:
        inside = ", ".join(str(inner.relative_to(folder)) for inner in found[:5]) or "none"
        msg = (
            f"{name}: a .zip must hold exactly one recording, found {len(found)} ({inside}). "
            "Unpack it and pass the one you mean."
        )
        raise LogError(msg)
    if folders:
        return Source(name, "ros2", folders[0])
    return _source_of_file(loose[0], name, scratch, limit_bytes, layers + 1)


def _refuse_unsafe(members: list[zipfile.ZipInfo], folder: Path, name: str) -> None:
    """Refuse member names that would be written outside *folder*, and more members than a recording has."""
    if len(members) > _MOST_MEMBERS:
        msg = f"{name}: holds {len(members)} files (at most {_MOST_MEMBERS}). Unpack it and pass the recording inside."
        raise LogError(msg)
    root = folder.resolve()
    for member in members:
        if not (root / member.filename).resolve().is_relative_to(root):
            msg = f"{name}: holds the unsafe path '{member.filename}', so it is not unpacked"
            raise LogError(msg)


def _copy_limited(
    stream: IO[bytes] | gzip.GzipFile | bz2.BZ2File | lzma.LZMAFile, target: Path, limit_bytes: int, name: str
) -> int:
    """Copy a stream to a file and count its bytes; stops at the limit and before the disk is full."""
    copied = 0
    with target.open("wb") as out:
        while block := stream.read(_BLOCK_BYTES):
            copied += len(block)
            if copied > min(limit_bytes, shutil.disk_usage(target.parent).free + copied - _BLOCK_BYTES):
                msg = (
                    f"{name}: unpacks to more than {limit_bytes / 2**30:.1f} GiB or than the disk holds. "
                    "Unpack it yourself or raise ingest.max_unpacked_gib."
                )
                raise LogError(msg)
            out.write(block)
    return copied


def _new_folder(scratch: Path) -> Path:
    """Make a fresh folder inside *scratch*."""
    folder = scratch / str(sum(1 for _ in scratch.iterdir()))
    folder.mkdir()
    return folder


def _cannot_unpack(name: str, kind: str, err: BaseException) -> LogError:
    """One line for a damaged archive."""
    return LogError(
        f"{name}: the {kind} file is damaged or cut off ({reason(err)}). Copy it again from the robot."
    )
