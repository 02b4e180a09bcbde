"""More recordings for a run: the columns of the others are kept, all that follows from them is made again."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from shutil import copyfile
from typing import Any

from dynmap_cli.clustering.stage import STAGE as CLUSTER
from dynmap_cli.config import Config, config_of
from dynmap_cli.errors import ArtifactError, ConfigError, LogError
from dynmap_cli.files.atomic import scratch_folder
from dynmap_cli.files.damage import reason
from dynmap_cli.files.documents import parse_yaml, read_text
from dynmap_cli.files.edits import NAME as EDITS
from dynmap_cli.files.known import remember
from dynmap_cli.files.lock import writing
from dynmap_cli.files.manifest import Manifest, manifest_path, read_manifest
from dynmap_cli.files.publishing import SWAPPED_IN, finish_swap
from dynmap_cli.given import check_recordings, digests_of
from dynmap_cli.ingest.stage import STAGE as INGEST
from dynmap_cli.runs.consistency import check_finished
from dynmap_cli.runs.floor_plan import STAGE_PLACES, STAGES
from dynmap_cli.runs.pipeline import StageResult, context_of, run_stage, write_run_yaml

_log = logging.getLogger(__name__)


def update(run_dir: Path, recordings: Sequence[Path], *, threads: int) -> list[StageResult]:
    """Add recordings to a finished run, with the settings it was made with.

    What is made is what `build` makes of all recordings, but sub-maps and patches keep their numbers. It is made beside
    the run and takes its place when all of it is done: a recording that does not fit changes nothing.

    Parameters
    ----------
    run_dir : Path
    recordings : sequence of Path
    threads : int

    Raises
    ------
    LogError
        If a recording does not fit on the map of the run.
    ArtifactError
        If the run is not finished.
    """
    check_recordings(recordings)
    if not run_dir.is_dir():
        msg = f"{run_dir}: no such run directory. Run `dynmap build LOG -o {run_dir}` first."
        raise ArtifactError(msg)
    with writing(run_dir):
        finish_swap(run_dir, STAGE_PLACES)
        config = settings_of(run_dir)
        new = _not_there(run_dir, recordings)
        if not new:
            # What an interrupted update left undone is done now.
            context = context_of(run_dir, config, threads, ())
            results = [_as_it_is(run_dir), *(run_stage(stage, context, force=False) for stage in STAGES[1:])]
        else:
            check_finished(run_dir, STAGES[: STAGES.index(CLUSTER) + 1])
            results = _made_beside(run_dir, new, config, threads)
        write_run_yaml(run_dir, config)
        return results


def _made_beside(run_dir: Path, new: Sequence[Path], config: Config, threads: int) -> list[StageResult]:
    """Run all stages in a scratch run, then put their files in the place of those of the run."""
    with scratch_folder(run_dir / "update") as beside:
        remember(run_dir, beside)
        if (run_dir / EDITS).is_file():
            copyfile(run_dir / EDITS, beside / EDITS)
        context = replace(
            context_of(beside, config, threads, tuple(new)), earlier_scans=run_dir / INGEST.folder
        )
        results = [run_stage(stage, context, force=True) for stage in STAGES]
        # From here on the update counts as made; what interrupts it is made good by the next command.
        beside.rename(run_dir / SWAPPED_IN)
    finish_swap(run_dir, STAGE_PLACES)
    return [
        replace(result, folder=run_dir / stage.folder) for stage, result in zip(STAGES, results, strict=True)
    ]


def settings_of(run_dir: Path) -> Config:
    """The settings that a run was made with: of its stages by their manifests, the others as run.yaml notes them.

    Raises
    ------
    ConfigError
        If this version does not allow one of them.
    """
    noted = [(str(run_dir / "run.yaml"), _noted_settings(run_dir))]
    for stage in STAGES:
        done = read_manifest(run_dir / stage.folder, stage.name)
        if done is not None and stage.section in Config.model_fields:
            words = {f"{stage.section}.{key}": value for key, value in done.settings.items()}
            noted.append((str(manifest_path(run_dir / stage.folder, stage.name)), words))
    try:
        return config_of(noted).config
    except ConfigError as err:
        remedy = (
            "Correct it in this file, nothing of the run has to be made again"
            if str(err).startswith(noted[0][0])
            else f"Another version of dynmap made {run_dir}; run `dynmap build LOG -o {run_dir} --force`"
        )
        msg = f"{err}. {remedy}."
        raise ConfigError(msg) from err


def _noted_settings(run_dir: Path) -> dict[str, Any]:
    """Seed and settings of `localize` in run.yaml; where it cannot be read, a warning says so."""
    path = run_dir / "run.yaml"
    try:
        settings = parse_yaml(read_text(path))["settings"]
        words = {f"localization.{key}": value for key, value in settings["localization"].items()}
        return {"seed": settings["seed"], **words}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as err:
        _log.warning(
            "%s: cannot be read (%s); seed and settings of localize are the defaults", path, reason(err)
        )
        return {}


def _ingested(run_dir: Path) -> Manifest:
    """What the run was made from."""
    done = read_manifest(run_dir / INGEST.folder, INGEST.name)
    if done is None:
        msg = f"{run_dir}: no recording was read here. Run `dynmap build LOG -o {run_dir}` first."
        raise ArtifactError(msg)
    return done


def _not_there(run_dir: Path, recordings: Sequence[Path]) -> list[Path]:
    """The recordings that the run was not made from."""
    there = set(_ingested(run_dir).inputs.values())
    new = []
    for path, digest in digests_of(recordings, LogError).items():
        if digest in there:
            _log.info("%s: is in %s already", path, run_dir)
        else:
            new.append(Path(path))
    return new


def _as_it_is(run_dir: Path) -> StageResult:
    return StageResult(INGEST.name, ran=False, manifest=_ingested(run_dir), folder=run_dir / INGEST.folder)
