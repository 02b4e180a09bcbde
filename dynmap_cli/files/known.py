"""known/: the sub-maps and patches of a run before its last update or edit, by which those of now keep their numbers.

They are as they were found, without the corrections by hand, so that what was corrected is found again.
"""

from __future__ import annotations

import shutil
from pathlib import Path

from dynmap_cli.domain.patches import PatchSet
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.files.manifest import sha256_of
from dynmap_cli.files.patch_archive import read_patches
from dynmap_cli.files.submaps import read_submaps

FOLDER = "known"
FOUND = "found"
"""Folder in submaps/ and name in patches/ of what was found, where it was corrected by hand."""
FOUND_PATCHES = f"{FOUND}.zip"
_PATCHES = "patches.zip"
_REMEDY = "Take the folder known/ away; sub-maps and states are then numbered anew."


def remember(run_dir: Path, into: Path) -> None:
    """Copy the sub-maps and patches of a run, as they were found, into known/ of another folder."""
    known = into / FOLDER
    shutil.rmtree(known, ignore_errors=True)
    known.mkdir(parents=True)
    for path in found_submaps(run_dir).iterdir():
        if path.suffix in (".yaml", ".pgm"):
            shutil.copyfile(path, known / path.name)
    shutil.copyfile(found_patches(run_dir), known / _PATCHES)


def found_submaps(run_dir: Path) -> Path:
    """Folder of the sub-maps of a run as they were found, before they were corrected by hand."""
    submaps = run_dir / "submaps"
    return submaps / FOUND if (submaps / FOUND / "submaps.yaml").is_file() else submaps


def found_patches(run_dir: Path) -> Path:
    """Archive of the patches of a run as they were learned, before they were corrected by hand."""
    patches = run_dir / "patches"
    return patches / FOUND_PATCHES if (patches / FOUND_PATCHES).is_file() else patches / _PATCHES


def forget(run_dir: Path) -> None:
    """Take known/ away."""
    shutil.rmtree(run_dir / FOLDER, ignore_errors=True)


def known_digests(run_dir: Path) -> dict[str, str]:
    """Digest of the folder, by its name; nothing where nothing is known."""
    folder = run_dir / FOLDER
    return {f"{FOLDER}/": sha256_of(folder)} if folder.is_dir() else {}


def read_known_submaps(run_dir: Path) -> tuple[SubMap, ...]:
    """Sub-maps of before; none where nothing is known."""
    folder = run_dir / FOLDER
    return read_submaps(folder, _REMEDY) if folder.is_dir() else ()


def read_known_patches(run_dir: Path) -> tuple[PatchSet, ...]:
    """States of before; none where nothing is known."""
    folder = run_dir / FOLDER
    return read_patches(folder / _PATCHES, _REMEDY) if folder.is_dir() else ()
