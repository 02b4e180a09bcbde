"""How what was made takes its place: file by file, the manifest last; after an interruption it goes on where it was."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from shutil import rmtree

from dynmap_cli.errors import ArtifactError
from dynmap_cli.files import known
from dynmap_cli.files.manifest import Manifest, manifest_path, read_manifest, write_manifest

SWAPPED_IN = ".update.made"
"""A whole run that was made beside another, until all of it has taken the other's place."""


def publish(part: Path, folder: Path, manifest: Manifest) -> None:
    """Move the files of a stage to their place; the manifest is taken away first and written last.

    Files that an interrupted call moved already are left where they are. What there will be no more goes while the
    manifest still names it, so that nothing stays for ever that no manifest knows of.
    """
    previous = read_manifest_or_none(folder, manifest.stage)
    for name in previous.outputs if previous else ():
        if name not in manifest.outputs:
            (folder / name).unlink(missing_ok=True)
            with suppress(OSError):
                # Of a folder inside this one whose last file it was; others are not empty.
                if (folder / name).parent != folder:
                    (folder / name).parent.rmdir()
    manifest_path(folder, manifest.stage).unlink(missing_ok=True)
    for name in manifest.outputs:
        if (part / name).exists():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (part / name).replace(folder / name)
    write_manifest(folder, manifest)


def read_manifest_or_none(folder: Path, stage: str) -> Manifest | None:
    """Read a manifest that is about to be replaced; a damaged one counts as none."""
    try:
        return read_manifest(folder, stage)
    except ArtifactError:
        return None


def finish_swap(run_dir: Path, stages: Sequence[tuple[str, str]]) -> None:
    """Put the files of a run that was made beside another into their places, also if that was interrupted before.

    What was not made to the end is taken away.

    Parameters
    ----------
    run_dir : Path
    stages : sequence of (str, str)
        Folder and name of each stage, in order.
    """
    rmtree(run_dir / ".update.part", ignore_errors=True)
    made = run_dir / SWAPPED_IN
    if not made.is_dir():
        return
    if (made / known.FOLDER).is_dir():
        known.forget(run_dir)
        (made / known.FOLDER).rename(run_dir / known.FOLDER)
    for folder, name in stages:
        manifest = read_manifest(made / folder, name)
        if manifest is not None:
            publish(made / folder, run_dir / folder, manifest)
    rmtree(made)
