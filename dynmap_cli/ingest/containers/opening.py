"""From a path to plain recordings: unpacks .gz, .bz2, .xz, .zst and .zip, and brings in what lies beside them."""

from __future__ import annotations

import stat
import zipfile
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path

from dynmap_cli.errors import LogError
from dynmap_cli.files.damage import reason
from dynmap_cli.ingest.containers.bag_folders import plain_folder
from dynmap_cli.ingest.containers.db3_journals import (
    is_named_journal,
    join_journals,
    journals_of,
    odd_journals,
)
from dynmap_cli.ingest.containers.formats import HEAD_BYTES, KNOWN, kind_of, kind_of_head
from dynmap_cli.ingest.containers.remarks import Remark
from dynmap_cli.ingest.containers.streams import (
    STREAM_KINDS,
    DamagedStreamError,
    copy_limited,
    packed_head,
    unpacked_file,
)
from dynmap_cli.ingest.containers.zip_members import Member, members_of, members_without_list
from dynmap_cli.ingest.raw.recording import file_name
from dynmap_cli.printable import printable

_SUFFIXES = {"ros1": ".bag", "db3": ".db3", "mcap": ".mcap"}
_NAMED_AS_RECORDINGS = frozenset({".bag", ".active", ".db3", ".mcap"})
_BELONGING = ("metadata.yaml", "-wal", "-journal")
_LONGEST_SHOWN = 200
_NO_TEXT = "its name is no UTF-8 text; rename it"
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
    said : tuple of Remark
        What else is to be said of it: what was done to read it, or lies beside it and is not read.
    lost : tuple of str
        Recordings beside it, in one folder, that cannot be read, and why.
    """

    name: str
    kind: str
    path: Path
    damage: str = ""
    said: tuple[Remark, ...] = ()
    lost: tuple[str, ...] = ()


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
    files, lost = _recordings_in(path)
    if not files:
        bags = sorted(inner.parent for inner in path.glob("*/metadata.yaml") if inner.is_file())
        if len(bags) == 1:
            return find_sources(bags[0], scratch, limit_bytes)
        names = ", ".join(bag.name for bag in bags[:5])
        inside = f" It holds {len(bags)} bag folders ({names}): pass those you mean." if bags else ""
        if (path / "run.yaml").is_file():
            msg = f"{path}: a run directory, which dynmap made of recordings, and none itself. Pass those."
            raise LogError(msg)
        msg = f"{path}: a folder without recordings and without metadata.yaml. Known are: {KNOWN}.{inside}"
        raise LogError(msg)
    return _sources_of_files(files, lost, scratch, limit_bytes)


def _recordings_in(path: Path) -> tuple[list[Path], list[str]]:
    """Files of a folder that are recordings; and those that are named like one and are none, with the reason."""
    files, lost = [], []
    for inner in sorted(path.iterdir()):
        why = _why_no_recording(inner) if inner.is_file() else "no regular file"
        why = why or ("" if _can_be_opened(inner) else _NO_TEXT)
        if not why:
            files.append(inner)
        elif _is_named_recording(inner) or why == _NO_TEXT:
            lost.append(f"{printable(inner.name)}: {why}; it is not read")
    return files, lost


def _sources_of_files(files: list[Path], lost: list[str], scratch: Path, limit_bytes: int) -> list[Source]:
    """Recordings of one folder that can be unpacked; the first knows of those that cannot.

    Raises
    ------
    LogError
        If there is none.
    """
    sources: list[Source] = []
    refusal: LogError | None = None
    for file in files:
        try:
            sources.append(_source_of_file(file, str(file), scratch, limit_bytes))
        except LogError as err:
            if len(files) == 1:
                raise
            refusal = refusal or err
            lost.append(str(err).replace(str(file), printable(file.name), 1))
    if refusal is not None and not sources:
        raise refusal
    return [replace(sources[0], lost=tuple(lost)), *sources[1:]]


def check_path(path: Path) -> None:
    """Refuse what is neither a regular file nor a folder of them: reading a pipe or a device may never end.

    Raises
    ------
    LogError
        If it is missing, cannot be looked at, is of another kind, or its name is no text.
    """
    try:
        mode = path.stat().st_mode
        inner = sorted(path.iterdir()) if stat.S_ISDIR(mode) else []
        # Of a folder that may be listed and not entered nothing can be looked at.
        is_bag = any(found.name == "metadata.yaml" for found in inner) or (path / "metadata.yaml").is_file()
        odd = [
            found
            for found in inner
            if is_bag and not (found.is_file() or found.is_dir() or is_named_journal(found))
        ]
    except FileNotFoundError as err:
        msg = f"{path}: no such file or folder"
        raise LogError(msg) from err
    except (OSError, ValueError) as err:
        shown = str(path) if len(str(path)) <= _LONGEST_SHOWN else f"{str(path)[:_LONGEST_SHOWN]}..."
        msg = f"{shown}: cannot be read ({reason(err)})"
        raise LogError(msg) from err
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        odd = [path]
    for found in (path, *(found for found in inner if is_bag and _is_named_recording(found))):
        if not _can_be_opened(found):
            msg = f"{found}: {_NO_TEXT}"
            raise LogError(msg)
    if odd:
        msg = f"{odd[0]}: neither a regular file nor a folder. Copy the recording into a file first."
        raise LogError(msg)


def _is_named_recording(file: Path) -> bool:
    return any(suffix in _NAMED_AS_RECORDINGS for suffix in file.suffixes)


def _can_be_opened(path: Path) -> bool:
    """Whether SQLite can open a .db3 by its name, which takes UTF-8; others are read whatever they are called."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        return path.suffix != ".db3"
    return True


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
        _refuse_packed_rest(path, name, kind)
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
    said = odd_journals(path) if kind == "db3" else []
    if kind == "db3" and journals_of(path):
        joined = _new_folder(scratch) / "recording.db3"
        said += join_journals(path, joined, limit_bytes)[1]
        return Source(name, kind, joined, damage, tuple(said))
    return Source(name, kind, _with_suffix(path, kind, scratch), damage, tuple(said))


def _refuse_packed_rest(path: Path, name: str, kind: str) -> None:
    """Refuse a packed file that begins like no recording before all of it is unpacked."""
    head = packed_head(path, kind, HEAD_BYTES)
    if len(head) == HEAD_BYTES:
        kind_of_head(head, name)


def _require_known(target: Path, name: str, kind: str, why: str) -> None:
    """Refuse a damaged file of which nothing is left that can be told to be a recording."""
    try:
        kind_of(target, name)
    except LogError as err:
        raise _cannot_unpack(name, kind, why) from err


def _bag_folder(path: Path, name: str, scratch: Path, limit_bytes: int, damage: str = "") -> Source:
    """A ROS 2 bag folder."""
    target = _new_folder(scratch) / file_name(name)
    found = plain_folder(path, target, limit_bytes, name)
    odd = [told for file in sorted(path.glob("*.db3")) for told in odd_journals(file)]
    damage = "; ".join(filter(None, (damage, found.damage)))
    return Source(name, "ros2", _not_named_bag(found.path, scratch), damage, (*found.said, *odd))


def _not_named_bag(folder: Path, scratch: Path) -> Path:
    """The folder under a name that does not end as that of a ROS 1 bag, for rosbags goes by the name."""
    if folder.suffix != ".bag":
        return folder
    link = _new_folder(scratch) / "recording"
    link.symlink_to(folder.resolve())
    return link


def _with_suffix(path: Path, kind: str, scratch: Path) -> Path:
    """The file under a name that ends as its kind wants it, for rosbags goes by the name."""
    suffix = _SUFFIXES.get(kind, path.suffix)
    if path.suffix == suffix:
        return path
    link = _new_folder(scratch) / f"recording{suffix}"
    link.symlink_to(path.resolve())
    return link


def _why_no_recording(path: Path) -> str:
    """Why a file in a folder is of no known format, as many that lie beside recordings are; "" where it is of one."""
    try:
        kind = kind_of(path, path.name)
        if kind in STREAM_KINDS:
            kind = kind_of_head(packed_head(path, kind, HEAD_BYTES), path.name)
    except LogError as err:
        return str(err).removeprefix(f"{path.name}: ").partition(" Known are: ")[0].rstrip(".")
    except _UNPACK_ERRORS as err:
        return reason(err)
    return "a .zip under another name" if kind == "zip" and path.suffix != ".zip" else ""


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
            for member in filter(_may_be_recording, members):
                target = folder / member.name
                target.parent.mkdir(parents=True, exist_ok=True)
                copied, why = copy_limited(member.blocks(), target, left, name)
                left -= copied
                whys += [why] if why else []
        except _UNPACK_ERRORS as err:
            raise _cannot_unpack(name, "zip", reason(err)) from err
    folders = sorted({found.parent for found in folder.rglob("metadata.yaml")})
    files = sorted(inner for inner in folder.rglob("*") if inner.is_file() and not _why_no_recording(inner))
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


def _may_be_recording(member: Member) -> bool:
    """Whether a file in an archive may be a recording or belong to one: not a large one that begins otherwise."""
    if member.name.endswith(_BELONGING):
        return True
    head = b""
    with suppress(DamagedStreamError):
        for block in member.blocks():
            head += block
            if len(head) >= HEAD_BYTES:
                return not _is_unknown(head[:HEAD_BYTES])
    return True


def _is_unknown(head: bytes) -> bool:
    try:
        kind_of_head(head, "")
    except LogError:
        return True
    return False


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
