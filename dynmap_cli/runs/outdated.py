"""Results in the folder of a run that were made with maps it has no more: they stay, and it is said."""

from __future__ import annotations

from pathlib import Path

from dynmap_cli.clustering.stage import STAGE as CLUSTER
from dynmap_cli.errors import ArtifactError
from dynmap_cli.files.areas_digest import KEY, areas_digest
from dynmap_cli.files.manifest import Manifest
from dynmap_cli.files.publishing import read_manifest_or_none
from dynmap_cli.mapping.stage import STAGE as MAP

_RESULTS = (("localization", "localize"), ("comparison", "compare"))
"""Folder in the run that holds them by name, and the verb that makes them."""


def outdated_results(run_dir: Path) -> list[str]:
    """Say of each result in a run, in one line, whether it was made with other maps: localizations, comparisons, table.

    A sub-map that got another name is no other map.
    """
    now = {
        stage.folder: read_manifest_or_none(run_dir / stage.folder, stage.name) for stage in (MAP, CLUSTER)
    }
    lines = []
    for folder, verb in _RESULTS:
        for path in sorted((run_dir / folder).glob(f"*/{verb}.manifest.json")):
            made = read_manifest_or_none(path.parent, verb)
            if made is not None and _is_of_other_maps(made, now, run_dir):
                lines.append(
                    f"warning: {folder}/{path.parent.name}: made with an older map than is there now; "
                    f"run `dynmap {verb} {run_dir} LOG` again"
                )
    if _is_timeline_stale(run_dir):
        lines.append(
            f"warning: timeline: shows other visits or states than are there now; run `dynmap timeline {run_dir}` again"
        )
    return lines


def _is_of_other_maps(made: Manifest, now: dict[str, Manifest | None], run_dir: Path) -> bool:
    """Whether a result was made from another map, or from other areas, than those of the run."""
    if _differs(made, MAP.folder, now[MAP.folder]):
        return True
    if not _differs(made, CLUSTER.folder, now[CLUSTER.folder]):
        return False
    try:
        return made.summary.get(KEY) != areas_digest(run_dir / CLUSTER.folder / "patches.zip")
    except ArtifactError:
        return True


def _differs(made: Manifest, folder: str, source: Manifest | None) -> bool:
    """Whether a result was made from other files of a folder than the stage wrote last."""
    then = {name: digest for name, digest in made.inputs.items() if name.startswith(f"{folder}/")}
    written = {} if source is None else source.outputs
    return then != {f"{folder}/{name}": digest for name, digest in written.items()}


def _is_timeline_stale(run_dir: Path) -> bool:
    """Whether the table in timeline/ is not that of the visits of now; it has no manifest, but is made of them only."""
    from dynmap_cli.files.patch_archive import read_visits
    from dynmap_cli.history.stage import TABLE_NAME
    from dynmap_cli.history.timeline import as_csv

    try:
        shown = (run_dir / "timeline" / TABLE_NAME).read_bytes()
    except OSError:
        return False
    try:
        return shown != as_csv(read_visits(run_dir / CLUSTER.folder / "patches.zip"))
    except ArtifactError:
        return False
