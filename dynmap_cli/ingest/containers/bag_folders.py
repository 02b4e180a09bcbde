"""Folders of ROS 2 bags: metadata are held against the files that are there, and packed files unpacked with a bound."""

from __future__ import annotations

import filecmp
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from dynmap_cli.files.damage import DAMAGE, reason
from dynmap_cli.files.documents import parse_yaml, read_text
from dynmap_cli.ingest.containers.db3_journals import join_journals, journals_of
from dynmap_cli.ingest.containers.remarks import Remark
from dynmap_cli.ingest.containers.streams import copy_limited, packed_head, unpacked_file
from dynmap_cli.printable import printable

METADATA = "metadata.yaml"
_INFORMATION = "rosbag2_bagfile_information"
_MOST_METADATA_BYTES, _FEW_METADATA_BYTES = 1 << 19, 1 << 16
"""What is read, for YAML takes 10 s for a MB; and what is read a second time, by rosbags, as it is."""
_PART = re.compile(r"(.*?)(_\d+)?\.(db3|mcap)(\.zstd?)?", re.DOTALL)
"""Recording, number of the part, storage, packing."""
_SUFFIXES = {"sqlite3": ".db3", "mcap": ".mcap"}
_STORAGE_MAGICS = (b"SQLite format 3\x00", b"\x89MCAP0\r\n")
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_LATEST_VERSION = 9
"""Of metadata that the library reads; later ones add keys, and it is the storage that holds the messages."""
_KEYS = (
    "relative_file_paths",
    "storage_identifier",
    "topics_with_message_count",
    "duration",
    "starting_time",
    "message_count",
)
"""Without which it reads none."""
_MOST_SHOWN = 3


@dataclass(frozen=True, slots=True)
class PlainFolder:
    """A folder that can be read: as it is, or made in the scratch folder.

    Attributes
    ----------
    path : Path
    damage : str
        What is wrong with metadata or files; "" where nothing is.
    said : tuple of Remark
        What was done to read it, or is not read.
    """

    path: Path
    damage: str = ""
    said: tuple[Remark, ...] = ()


@dataclass(slots=True)
class _Content:
    """Storage files of a folder that are to be read, in order, and what is said of them."""

    information: dict[str, Any] = field(default_factory=dict)
    stated: list[str] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    whys: list[str] = field(default_factory=list)
    said: list[Remark] = field(default_factory=list)


def plain_folder(path: Path, folder: Path, limit_bytes: int, name: str) -> PlainFolder:
    """The folder as it is, or one in *folder* (made here) with plain files that are there, and metadata that fit them.

    Metadata that are no plain YAML count as damage, for they may take rosbags for ever. Files that they do not list
    are read where they are parts of the same recording, as its last one is after a crash.

    Parameters
    ----------
    path : Path
        With a metadata.yaml.
    folder : Path
        Where a copy may be made; in the scratch folder.
    limit_bytes : int
        The most that may be unpacked.
    name : str
        For messages.

    Raises
    ------
    LogError
        If it unpacks to more.
    """
    there = sorted((one.name for one in path.iterdir() if _is_storage(one)), key=_by_number)
    content = _content(path, there)
    packed = {one for one in content.names if _is_packed(path / one)}
    with_journals = {one for one in content.names if journals_of(path / one)}
    has_others = set(there) != set(content.names)
    if not (packed or with_journals or has_others) and _is_readable(path, content):
        return PlainFolder(path, "; ".join(content.whys))
    folder.mkdir()
    plain = []
    for one in content.names:
        target, source = folder / _plain_name(one, content.information), path / one
        if one in packed:
            head = packed_head(source, "zstd", len(_STORAGE_MAGICS[0]))
            if head and not head.startswith(_STORAGE_MAGICS):
                content.whys.append(f"{printable(one)} does not unpack to a storage file and is not read")
                continue
            copied, why = copy_limited(unpacked_file(source, "zstd"), target, limit_bytes, name)
            content.whys += [f"{printable(one)} is damaged or cut off: {why}"] if why else []
        elif one in with_journals:
            copied, told = join_journals(source, target, limit_bytes)
            content.said += told
        else:
            copied = 0
            target.symlink_to(source.resolve())
        limit_bytes -= copied
        plain.append(target.name)
    if content.information:
        written = yaml.safe_dump({_INFORMATION: _fitting(content.information, plain)})
        (folder / METADATA).write_text(written, encoding="utf-8")
    return PlainFolder(folder, "; ".join(content.whys), tuple(content.said))


def stated_messages(path: Path) -> int:
    """How many messages a folder holds by its metadata; 0 where they do not say."""
    try:
        content = parse_yaml(read_text(path / METADATA, _MOST_METADATA_BYTES))
        return max(int(content[_INFORMATION]["message_count"]), 0)
    except DAMAGE:
        return 0


def _content(path: Path, there: list[str]) -> _Content:
    """Hold the metadata of a folder against the storage files that are there."""
    try:
        content = parse_yaml(read_text(path / METADATA, _MOST_METADATA_BYTES))
    except (OSError, ValueError) as err:
        return _Content(names=there, whys=[f"its {METADATA} cannot be read: {reason(err)}"])
    try:
        information = dict(content[_INFORMATION])
        stated = [Path(str(one)).name for one in information["relative_file_paths"]]
    except DAMAGE as err:
        return _Content(names=there, whys=[f"its {METADATA} does not say what it should: {reason(err)}"])
    found = _Content(information, stated)
    listed = list(dict.fromkeys(stated))
    found.names = [one for one in listed if one in there or (path / one).is_file()]
    missing = [one for one in listed if one not in found.names]
    if missing and len(there) == len(listed):
        # They were renamed.
        found.names = there
        return found
    if missing:
        found.whys.append(f"its {METADATA} lists {_shown(missing)}, not there as a file")
    unlisted = [one for one in there if one not in found.names]
    parts = [one for one in _parts_among(unlisted, found.names) if not _is_copy(path, one, found.names)]
    if parts:
        found.whys.append(
            f"{_shown(parts)} of the same recording, not listed in its {METADATA}, read all the same"
        )
        found.names = sorted([*found.names, *parts], key=_by_number)
    others = [one for one in unlisted if one not in parts]
    if others:
        found.said.append(Remark(f"{_shown(others)} beside it, not listed in its {METADATA}, not read"))
    return found


def _parts_among(unlisted: Sequence[str], listed: Sequence[str]) -> list[str]:
    """Files named like those that are listed, with another number near theirs; the plain one of two of a number."""
    known = {_part_of(one)[0] for one in listed}
    numbers = {_part_of(one) for one in listed}
    last = max((int(number[1:] or 0) for _, number in numbers), default=0) + len(unlisted)
    parts = []
    for one in sorted(unlisted, key=_is_named_packed):
        part = _part_of(one)
        if part[0] in known and part not in numbers and int(part[1][1:] or 0) <= last:
            numbers.add(part)
            parts.append(one)
    return parts


def _is_copy(path: Path, name: str, listed: Sequence[str]) -> bool:
    """Whether a file of a folder has the same content as one that is listed."""
    return any(
        (path / other).is_file() and filecmp.cmp(path / name, path / other, shallow=False) for other in listed
    )


def _part_of(name: str) -> tuple[str, str]:
    """Recording that a file belongs to by its name, and the number of its part."""
    match = _PART.fullmatch(name)
    return (match[1], match[2] or "") if match else (name, "")


def _is_named_packed(name: str) -> bool:
    match = _PART.fullmatch(name)
    return bool(match and match[4])


def _by_number(name: str) -> tuple[int, str]:
    return len(name), name


def _shown(names: Iterable[str]) -> str:
    """A few names, and how many others."""
    known = list(names)
    left = f" and {len(known) - _MOST_SHOWN} others" if len(known) > _MOST_SHOWN else ""
    return f"{len(known)} storage files ({', '.join(map(printable, known[:_MOST_SHOWN]))}{left})"


def _is_storage(file: Path) -> bool:
    return _PART.fullmatch(file.name) is not None and file.is_file()


def _is_packed(file: Path) -> bool:
    """Whether a file is packed, whatever name and metadata say."""
    try:
        with file.open("rb") as stream:
            return stream.read(len(_ZSTD_MAGIC)) == _ZSTD_MAGIC
    except OSError:
        return False


def _is_readable(path: Path, content: _Content) -> bool:
    """Whether rosbags can be given the folder as it is, or nothing better can be made of it."""
    information = content.information
    if not information.keys() >= set(_KEYS):
        return True
    version = information.get("version")
    return (
        type(version) is int
        and 0 < version <= _LATEST_VERSION
        and content.stated == content.names
        and str(information.get("compression_mode")).lower() != "file"
        and (path / METADATA).stat().st_size <= _FEW_METADATA_BYTES
    )


def _plain_name(name: str, information: dict[str, Any]) -> str:
    """Name of a storage file when it is unpacked, by which it is told what it is."""
    bare = name.removesuffix(".zstd").removesuffix(".zst")
    if Path(bare).suffix in _SUFFIXES.values():
        return bare
    return f"{bare}{_SUFFIXES.get(str(information.get('storage_identifier')), '.db3')}"


def _fitting(information: dict[str, Any], names: list[str]) -> dict[str, Any]:
    """Metadata of files that are plain; of a version that is read, for it is the storage that holds the messages."""
    version = information.get("version")
    is_known = type(version) is int and 0 < version <= _LATEST_VERSION
    fitting = {key: information[key] for key in _KEYS if key in information}
    if str(information.get("compression_mode")).lower() == "message":
        fitting |= {key: information.get(key) for key in ("compression_mode", "compression_format")}
    return {**fitting, "relative_file_paths": names, "version": version if is_known else _LATEST_VERSION}
