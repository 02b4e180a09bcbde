"""Folders of ROS 2 bags: their metadata are looked at with care, and packed storage files are unpacked with a bound."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from dynmap_cli.files.damage import DAMAGE, reason
from dynmap_cli.files.documents import parse_yaml, read_text
from dynmap_cli.ingest.containers.streams import copy_limited, unpacked_file

_METADATA, _INFORMATION = "metadata.yaml", "rosbag2_bagfile_information"
_PACKED_SUFFIX = ".zstd"
_STORAGE_SUFFIXES = (".mcap", ".db3", f".mcap{_PACKED_SUFFIX}", f".db3{_PACKED_SUFFIX}")
_LATEST_VERSION = 9
"""Of metadata that the library reads; later ones add keys, and it is the storage that holds the messages."""
_KEYS = frozenset(
    {
        "relative_file_paths",
        "storage_identifier",
        "topics_with_message_count",
        "duration",
        "starting_time",
        "message_count",
    }
)
"""Without which it reads none."""


def plain_folder(path: Path, folder: Path, limit_bytes: int, name: str) -> tuple[Path, str]:
    """The folder as it is, or a copy in *folder* (made here) whose storage files are not packed; and what is damaged.

    Metadata that are no plain YAML count as damage, for they may take rosbags for ever.

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
    try:
        content = parse_yaml(read_text(path / _METADATA))
    except (OSError, ValueError) as err:
        return path, f"its {_METADATA} cannot be read: {reason(err)}"
    try:
        information = dict(content[_INFORMATION])
        stated = information["relative_file_paths"]
        information["relative_file_paths"] = _files_of(path, stated)
        packed = [path / str(place) for place in information["relative_file_paths"]]
    except DAMAGE:
        # Of another version, or broken: rosbags says what is wrong.
        return path, ""
    is_packed = str(information.get("compression_mode")).lower() == "file"
    if not is_packed or not all(one.suffix == _PACKED_SUFFIX and one.is_file() for one in packed):
        is_renamed = information["relative_file_paths"] != stated
        return _as_known(path, information, folder, is_renamed=is_renamed), ""
    folder.mkdir()
    whys = []
    for one in packed:
        copied, why = copy_limited(unpacked_file(one, "zstd"), folder / one.stem, limit_bytes, name)
        limit_bytes -= copied
        whys += [f"{one.name} is damaged or cut off: {why}"] if why else []
    (folder / _METADATA).write_text(yaml.safe_dump({_INFORMATION: _unpacked(information)}), encoding="utf-8")
    return folder, "; ".join(whys)


def _files_of(path: Path, stated: list[Any]) -> list[Any]:
    """The storage files that metadata name; those that are there where they were renamed, and are as many."""
    if all((path / Path(str(place)).name).is_file() for place in stated):
        return stated
    found = sorted(
        (one.name for one in path.iterdir() if one.name.endswith(_STORAGE_SUFFIXES) and one.is_file()),
        key=lambda name: (len(name), name),
    )
    return found if len(found) == len(stated) else stated


def _as_known(path: Path, information: dict[str, Any], folder: Path, *, is_renamed: bool) -> Path:
    """The folder as it is, or one in *folder* whose metadata are of a version that is read, with the same files.

    Keys that are not known change nothing: what is needed is there, and numbers are compared with the storage later.
    """
    version = information.get("version")
    is_known = type(version) is int and 0 < version <= _LATEST_VERSION
    files = [path / Path(str(place)).name for place in information["relative_file_paths"]]
    if (is_known and not is_renamed) or not information.keys() >= _KEYS or not all(map(Path.is_file, files)):
        return path
    folder.mkdir()
    for file in files:
        (folder / file.name).symlink_to(file.resolve())
    known = {**information, "version": version if is_known else _LATEST_VERSION}
    (folder / _METADATA).write_text(yaml.safe_dump({_INFORMATION: known}), encoding="utf-8")
    return folder


def _unpacked(information: dict[str, Any]) -> dict[str, Any]:
    """Metadata of a bag whose files were unpacked."""
    names = [Path(str(place)).stem for place in information["relative_file_paths"]]
    changed = {**information, "relative_file_paths": names, "compression_mode": "", "compression_format": ""}
    changed.pop("files", None)
    return changed
