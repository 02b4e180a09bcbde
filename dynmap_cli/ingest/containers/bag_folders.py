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
        packed = [path / str(place) for place in information["relative_file_paths"]]
    except DAMAGE:
        # Of another version, or broken: rosbags says what is wrong.
        return path, ""
    is_packed = str(information.get("compression_mode")).lower() == "file"
    if not is_packed or not all(one.suffix == _PACKED_SUFFIX and one.is_file() for one in packed):
        return path, ""
    folder.mkdir()
    whys = []
    for one in packed:
        copied, why = copy_limited(unpacked_file(one, "zstd"), folder / one.stem, limit_bytes, name)
        limit_bytes -= copied
        whys += [f"{one.name} is damaged or cut off: {why}"] if why else []
    (folder / _METADATA).write_text(yaml.safe_dump({_INFORMATION: _unpacked(information)}), encoding="utf-8")
    return folder, "; ".join(whys)


def _unpacked(information: dict[str, Any]) -> dict[str, Any]:
    """Metadata of a bag whose files were unpacked."""
    names = [Path(str(place)).stem for place in information["relative_file_paths"]]
    changed = {**information, "relative_file_paths": names, "compression_mode": "", "compression_format": ""}
    changed.pop("files", None)
    return changed
