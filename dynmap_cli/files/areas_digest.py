"""What of patches.zip tells where a robot is and how the areas are; names that people gave them do not."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from dynmap_cli.errors import ArtifactError
from dynmap_cli.files.damage import DAMAGE, reason
from dynmap_cli.files.documents import as_text, parse_json
from dynmap_cli.files.patch_manifest import MANIFEST
from dynmap_cli.files.zip_archive import ZipArchive

KEY = "areas_sha256"
"""Under this name results keep the digest of the areas they were made with, in their summary."""
_MOST_BYTES = 1 << 30


def areas_digest(path: Path) -> str:
    """The sha256 of all that is in patches.zip but for the names of sub-maps.

    Raises
    ------
    ArtifactError
        If the archive is missing or damaged.
    """
    digest = hashlib.sha256()
    try:
        archive = ZipArchive(path)
        try:
            for name in archive.names():
                content = archive.member(name, _MOST_BYTES)
                if name == MANIFEST:
                    content = _without_names(content)
                digest.update(f"{name}\0{len(content)}\0".encode() + content)
        finally:
            archive.close()
    except DAMAGE as err:
        msg = (
            f"{path}: not a readable patch archive ({reason(err)}). Run `dynmap cluster` again with --force."
        )
        raise ArtifactError(msg) from err
    return digest.hexdigest()


def _without_names(content: bytes) -> bytes:
    """The manifest with sub-maps that nobody gave a name."""
    manifest = parse_json(as_text(content, MANIFEST))
    for entry in manifest["submaps"]:
        entry.pop("name", None)
    return json.dumps(manifest, sort_keys=True).encode()
