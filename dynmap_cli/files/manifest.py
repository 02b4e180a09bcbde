"""The manifest of a stage: what it read, with which settings, what it wrote. Written last: no manifest, not done."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from dynmap_cli.errors import ArtifactError
from dynmap_cli.files.atomic import replacing
from dynmap_cli.files.damage import reason
from dynmap_cli.files.documents import MAX_TABLE_BYTES, parse_json, read_text
from dynmap_cli.files.plain_values import said

FORMAT_VERSION = 1
"""Version of every file between stages; a reader refuses another one and names both."""


@dataclass(frozen=True, slots=True)
class Manifest:
    """What a finished stage leaves behind.

    Attributes
    ----------
    stage : str
    settings : dict
        The settings that the result depends on.
    inputs : dict of str to str
        Name -> sha256 of what was read.
    outputs : dict of str to str
        Path within the folder -> sha256.
    summary : dict
        What the stage found, as plain numbers and words.
    seconds : float
        CPU seconds of the stage.
    dynmap_version : str
    format_version : int
    """

    stage: str
    settings: dict[str, Any]
    inputs: dict[str, str]
    outputs: dict[str, str]
    summary: dict[str, Any]
    seconds: float
    dynmap_version: str
    format_version: int = FORMAT_VERSION


def manifest_path(folder: Path, stage: str) -> Path:
    """Where the manifest of a stage lies."""
    return folder / f"{stage}.manifest.json"


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Write it whole, as the last file of the stage."""
    with replacing(manifest_path(folder, manifest.stage)) as part:
        part.write_text(json.dumps(asdict(manifest), indent=2, sort_keys=True) + "\n", encoding="utf-8")


def read_manifest(folder: Path, stage: str) -> Manifest | None:
    """Read the manifest of a stage, or None where the stage is not done.

    Raises
    ------
    ArtifactError
        If it was written in another format version or is damaged.
    """
    path = manifest_path(folder, stage)
    try:
        content = parse_json(read_text(path, MAX_TABLE_BYTES))
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as err:
        msg = f"{path}: not a readable manifest ({reason(err)}). Run the stage again with --force."
        raise ArtifactError(msg) from err
    found = content.get("format_version") if isinstance(content, dict) else None
    if found != FORMAT_VERSION:
        msg = (
            f"{path}: written in format version {said(found)}, this dynmap reads version {FORMAT_VERSION}. "
            "Build into a new folder, or use the dynmap that wrote it."
        )
        raise ArtifactError(msg)
    try:
        _check_keys(content)
        manifest = Manifest(**content)
        _check(manifest, stage)
    except (TypeError, ValueError) as err:
        msg = f"{path}: not a manifest of dynmap ({reason(err)}). Run the stage again with --force."
        raise ArtifactError(msg) from err
    return manifest


def _check_keys(content: dict[str, Any]) -> None:
    """Refuse a manifest that lacks something, or says more than one does."""
    known = {one.name for one in fields(Manifest)}
    for name in sorted(known ^ content.keys()):
        msg = f"'{name[:60]}' {'is missing' if name in known else 'is not known'}"
        raise ValueError(msg)


def _check(manifest: Manifest, stage: str) -> None:
    """Refuse what no stage writes."""
    for name in ("settings", "inputs", "outputs", "summary"):
        if not isinstance(getattr(manifest, name), dict):
            msg = f"{name} is not a mapping"
            raise ValueError(msg)
    for name in ("inputs", "outputs"):
        if not all(isinstance(digest, str) for digest in getattr(manifest, name).values()):
            msg = f"{name} has values that are not digests"
            raise ValueError(msg)
    for name in manifest.outputs:
        if "\0" in name or Path(name).is_absolute() or ".." in Path(name).parts:
            msg = f"output {name[:60]!r} is not in the folder of the stage"
            raise ValueError(msg)
    lines = manifest.summary.get("lines", [])
    if not isinstance(lines, list) or not all(isinstance(line, str) and line.isprintable() for line in lines):
        msg = "summary.lines is not a list of printable sentences"
        raise ValueError(msg)
    if manifest.stage != stage or not isinstance(manifest.dynmap_version, str):
        msg = f"of stage {str(manifest.stage)[:60]!r}, not '{stage}'"
        raise ValueError(msg)


def sha256_of(path: Path) -> str:
    """Digest of a file, or of all files of a folder with their names."""
    if path.is_dir():
        digest = hashlib.sha256()
        for inner in sorted(p for p in path.rglob("*") if p.is_file()):
            digest.update(os.fsencode(f"{inner.relative_to(path)}\0{sha256_of(inner)}\n"))
        return digest.hexdigest()
    status = path.stat()
    return _sha256_of_file(path, (status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns))


def damaged(folder: Path, manifest: Manifest) -> Path | None:
    """First file of a finished stage that is missing, or is not what the stage wrote."""
    for name, digest in manifest.outputs.items():
        path = folder / name
        try:
            if sha256_of(path) != digest:
                return path
        except OSError:
            return path
    return None


def _sha256_of_file(path: Path, identity: tuple[int, ...]) -> str:
    """Digest of a file, read once as long as it stays the same: several stages ask for it."""
    if identity not in _digests:
        digest = hashlib.sha256()
        with path.open("rb") as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
        _digests[identity] = digest.hexdigest()
    return _digests[identity]


_digests: dict[tuple[int, ...], str] = {}
