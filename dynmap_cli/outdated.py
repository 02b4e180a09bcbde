"""Results in the folder of a run that were made with maps it has no more: they stay, and it is said."""

from __future__ import annotations

from pathlib import Path

from dynmap_cli.clustering.stage import STAGE as CLUSTER
from dynmap_cli.files.manifest import Manifest
from dynmap_cli.files.publishing import read_manifest_or_none
from dynmap_cli.mapping.stage import STAGE as MAP

_RESULTS = (("localization", "localize"), ("comparison", "compare"))
"""Folder in the run that holds them by name, and the verb that makes them."""


def outdated_results(run_dir: Path) -> list[str]:
    """Say of each localization and comparison in a run, in one line, whether it was made with other maps."""
    now = {
        stage.folder: read_manifest_or_none(run_dir / stage.folder, stage.name) for stage in (MAP, CLUSTER)
    }
    lines = []
    for folder, verb in _RESULTS:
        for path in sorted((run_dir / folder).glob(f"*/{verb}.manifest.json")):
            made = read_manifest_or_none(path.parent, verb)
            if made is not None and any(_differs(made, name, source) for name, source in now.items()):
                lines.append(
                    f"warning: {folder}/{path.parent.name}: made with an older map than is there now; "
                    f"run `dynmap {verb} {run_dir} LOG` again"
                )
    return lines


def _differs(made: Manifest, folder: str, source: Manifest | None) -> bool:
    """Whether a result was made from other files of a folder than the stage wrote last."""
    then = {name: digest for name, digest in made.inputs.items() if name.startswith(f"{folder}/")}
    written = {} if source is None else source.outputs
    return then != {f"{folder}/{name}": digest for name, digest in written.items()}
