"""From a path to plain recordings: unpacks .gz, .bz2, .xz, .zst and .zip; tells formats by content, not by name."""

from __future__ import annotations

import re
import stat
import zipfile
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path

from dynmap_cli.errors import LogError
from dynmap_cli.files.damage import reason
from dynmap_cli.ingest.containers.bag_folders import plain_folder
from dynmap_cli.ingest.containers.foreign import foreign
from dynmap_cli.ingest.containers.streams import STREAM_KINDS, DamagedStreamError, copy_limited, unpacked_file
from dynmap_cli.ingest.containers.zip_members import Member, members_of, members_without_list
from dynmap_cli.ingest.raw.recording import file_name
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
    (b"PK\x03\x04", "zip"),
    (b"PK\x05\x06", "zip"),
)
_SUFFIXES = {"ros1": ".bag", "db3": ".db3", "mcap": ".mcap"}
_CARMEN = re.compile(
    rb"^(#.*CARMEN|(FLASER|RLASER|ROBOTLASER\d|RAWLASER\d|ODOM|PARAM|SYNC)[ \t])", re.MULTILINE
)
_WEAN = re.compile(rb"^[OL]( -?[0-9.]+){4}", re.MULTILINE)
_HEAD_BYTES = 1 << 16
_LONGEST_SHOWN = 200
_LEAST_PRINTABLE = 0.9
_MOST_LAYERS, _MOST_MEMBERS = 5, 10_000
_UNPACK_ERRORS = (
    OSError,
    ValueError,
    OverflowError,
    MemoryError,
    zipfile.BadZipFile,
    DamagedStreamError,
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
    damage : str
        What is wrong with the file that it was unpacked from, or with its metadata; "" where nothing is known to be.
    """

    name: str
    kind: str
    path: Path
    damage: str = ""


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
        return [_bag_folder(path, str(path), scratch, limit_bytes)]
    files = sorted(inner for inner in path.iterdir() if inner.is_file() and _looks_like_recording(inner))
    if not files:
        bags = sorted(inner.parent for inner in path.glob("*/metadata.yaml") if inner.is_file())
        if len(bags) == 1:
            return find_sources(bags[0], scratch, limit_bytes)
        names = ", ".join(bag.name for bag in bags[:5])
        inside = f" It holds {len(bags)} bag folders ({names}): pass those you mean." if bags else ""
        msg = f"{path}: a folder without recordings and without metadata.yaml. Known are: {KNOWN}.{inside}"
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


def _source_of_file(
    path: Path, name: str, scratch: Path, limit_bytes: int, layers: int = 0, damage: str = ""
) -> Source:
    """Unpack a file until something plain is left, as far as it can be."""
    kind = kind_of(path, name)
    if layers > _MOST_LAYERS:
        msg = f"{name}: packed more than {_MOST_LAYERS} times over. Unpack it and pass the recording inside."
        raise LogError(msg)
    if kind == "zip":
        return _source_in_zip(path, name, scratch, limit_bytes, layers, damage)
    if kind in STREAM_KINDS:
        target = _new_folder(scratch) / "unpacked"
        try:
            _, why = copy_limited(unpacked_file(path, kind), target, limit_bytes, name)
        except _UNPACK_ERRORS as err:
            raise _cannot_unpack(name, kind, reason(err)) from err
        if why:
            _require_known(target, name, kind, why)
            why = f"the {kind} file is damaged or cut off: {why}"
            damage = f"{damage}; {why}" if damage else why
        return _source_of_file(target, name, scratch, limit_bytes, layers + 1, damage)
    return Source(name, kind, _with_suffix(path, kind, scratch), damage)


def _require_known(target: Path, name: str, kind: str, why: str) -> None:
    """Refuse a damaged file of which nothing is left that can be told to be a recording."""
    try:
        kind_of(target, name)
    except LogError as err:
        raise _cannot_unpack(name, kind, why) from err


def _bag_folder(path: Path, name: str, scratch: Path, limit_bytes: int, damage: str = "") -> Source:
    """A ROS 2 bag folder."""
    target = _new_folder(scratch) / file_name(name)
    folder, why = plain_folder(path, target, limit_bytes, name)
    return Source(name, "ros2", folder, "; ".join(filter(None, (damage, why))))


def _with_suffix(path: Path, kind: str, scratch: Path) -> Path:
    """The file under a name that ends as its kind wants it, for rosbags goes by the name."""
    suffix = _SUFFIXES.get(kind, path.suffix)
    if path.suffix == suffix:
        return path
    link = _new_folder(scratch) / f"recording{suffix}"
    link.symlink_to(path.resolve())
    return link


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


def _looks_like_recording(path: Path) -> bool:
    """Whether a file in a folder is of a known format; others lie beside recordings and are passed over."""
    try:
        kind = kind_of(path, path.name)
        if kind in STREAM_KINDS:
            head = b""
            with suppress(DamagedStreamError):
                for block in unpacked_file(path, kind):
                    head += block
                    if len(head) >= _HEAD_BYTES:
                        break
            kind = _kind_of_head(head[:_HEAD_BYTES], path.name)
    except (LogError, *_UNPACK_ERRORS):
        return False
    return kind != "zip" or path.suffix == ".zip"


def _source_in_zip(
    path: Path, name: str, scratch: Path, limit_bytes: int, layers: int, damage: str
) -> Source:
    """The one recording inside a .zip."""
    folder = _new_folder(scratch)
    whys: list[str] = []
    with ExitStack() as stack:
        try:
            members = _members(path, stack, whys)
            _refuse_unsafe(members, folder, name)
            left = limit_bytes
            for member in members:
                target = folder / member.name
                target.parent.mkdir(parents=True, exist_ok=True)
                copied, why = copy_limited(member.blocks(), target, left, name)
                left -= copied
                whys += [why] if why else []
        except _UNPACK_ERRORS as err:
            raise _cannot_unpack(name, "zip", reason(err)) from err
    folders = sorted({found.parent for found in folder.rglob("metadata.yaml")})
    files = sorted(inner for inner in folder.rglob("*") if inner.is_file() and _looks_like_recording(inner))
    loose = [inner for inner in files if inner.parent not in folders]
    found = [*folders, *loose]
    if not found and whys:
        raise _cannot_unpack(name, "zip", "; ".join(whys[:3]))
    if len(found) != 1:
        inside = printable(", ".join(str(inner.relative_to(folder)) for inner in found[:5])) or "none"
        msg = (
            f"{name}: a .zip must hold exactly one recording, found {len(found)} ({inside}). "
            "Unpack it and pass the one you mean."
        )
        raise LogError(msg)
    if whys:
        why = f"the zip file is damaged or cut off: {'; '.join(dict.fromkeys(whys))}"
        damage = f"{damage}; {why}" if damage else why
    if folders:
        return _bag_folder(folders[0], name, scratch, left, damage)
    return _source_of_file(loose[0], name, scratch, limit_bytes, layers + 1, damage)


def _members(path: Path, stack: ExitStack, whys: list[str]) -> list[Member]:
    """Files in a .zip; where its list of them is damaged, as they lie in it, and why goes to *whys*."""
    try:
        found = members_of(stack.enter_context(zipfile.ZipFile(path)), path)
    except zipfile.BadZipFile:
        whys.append("the list of its files is missing or damaged")
        found = members_without_list(path)
    return [member for member in found if "__MACOSX" not in member.name]


def _refuse_unsafe(members: Sequence[Member], folder: Path, name: str) -> None:
    """Refuse names that would be written outside *folder* or over one another, and more files than a recording has."""
    if len(members) > _MOST_MEMBERS:
        msg = f"{name}: holds {len(members)} files (at most {_MOST_MEMBERS}). Unpack it and pass the recording inside."
        raise LogError(msg)
    root = folder.resolve()
    for known, count in Counter(member.name for member in members).items():
        if count > 1:
            msg = f"{name}: holds {count} files of the name {known!r:.200}. Unpack it and pass the recording you mean."
            raise LogError(msg)
    for member in members:
        if not (root / member.name).resolve().is_relative_to(root):
            msg = f"{name}: holds the unsafe path {member.name!r:.200}, so it is not unpacked"
            raise LogError(msg)


def _new_folder(scratch: Path) -> Path:
    """Make a fresh folder inside *scratch*."""
    folder = scratch / str(sum(1 for _ in scratch.iterdir()))
    folder.mkdir()
    return folder


def _cannot_unpack(name: str, kind: str, why: str) -> LogError:
    """One line for a damaged archive."""
    return LogError(
        f"{name}: the {kind} file is damaged or cut off ({why}), and no recording can be read from it. "
        "Copy it again from the robot."
    )
