"""The stages run one after another: the rules by which they are run, skipped and published."""

from __future__ import annotations

import logging
import platform
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import yaml

from dynmap_cli import __version__
from dynmap_cli.compiling import announce_compilation
from dynmap_cli.config import Config
from dynmap_cli.errors import ArtifactError, LogError
from dynmap_cli.files import edits, known
from dynmap_cli.files.atomic import discard_scratch, replacing, scratch_folder
from dynmap_cli.files.damage import DAMAGE
from dynmap_cli.files.documents import parse_yaml, read_text
from dynmap_cli.files.lock import writing
from dynmap_cli.files.manifest import (
    Manifest,
    read_manifest,
    sha256_of,
)
from dynmap_cli.files.pgm import image_of
from dynmap_cli.files.publishing import finish_swap, publish, read_manifest_or_none
from dynmap_cli.files.space import check_space
from dynmap_cli.given import check_apart, check_recordings, digests_of
from dynmap_cli.ingest.stage import STAGE as INGEST
from dynmap_cli.printable import printable
from dynmap_cli.runs.consistency import check_chain, output_digests, refuse_other_recordings
from dynmap_cli.runs.floor_plan import STAGE_PLACES, STAGES, read_by
from dynmap_cli.runs.reruns import why_again
from dynmap_cli.stage import Stage, StageContext

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class StageResult:
    """What a stage found.

    Attributes
    ----------
    stage : str
    ran : bool
        False where the result on disk was up to date.
    manifest : Manifest
    folder : Path
        Where its files are.
    """

    stage: str
    ran: bool
    manifest: Manifest
    folder: Path


def build(
    run_dir: Path,
    recordings: Sequence[Path],
    config: Config,
    *,
    threads: int,
    force: bool = False,
    force_from: str | None = None,
) -> list[StageResult]:
    """Run all stages on recordings; those whose inputs and settings did not change are skipped.

    Parameters
    ----------
    run_dir : Path
        The run directory; made if it is missing.
    recordings : sequence of Path
        Files or folders, in time order.
    config : Config
    threads : int
    force : bool
        Run every stage, and replace a run that was made from other recordings.
    force_from : str, optional
        Name of the first stage that is run in any case.

    Raises
    ------
    ArtifactError
        If the run was made from other recordings.
    """
    first_forced = len(STAGES)
    if force:
        first_forced = 0
    elif force_from is not None:
        first_forced = [stage.name for stage in STAGES].index(force_from)
    context = context_of(run_dir, config, threads, tuple(recordings))
    check_recordings(recordings)
    check_apart(run_dir, recordings)
    results = []
    with writing(run_dir, is_output=True):
        finish_swap(run_dir, STAGE_PLACES)
        if force:
            _forget_numbers(run_dir, recordings)
        else:
            refuse_other_recordings(run_dir, recordings)
        for number, stage in enumerate(STAGES):
            results.append(run_stage(stage, context, force=number >= first_forced))
            _note_run(results[-1], run_dir, config)
    return results


def run_one(
    run_dir: Path, name: str, config: Config, *, threads: int, force: bool, recordings: Sequence[Path] = ()
) -> StageResult:
    """Run a single stage of a run directory, by its *name*; only `ingest` is given *recordings*."""
    stage = next(stage for stage in STAGES if stage.name == name)
    if stage is INGEST:
        check_recordings(recordings)
        check_apart(run_dir, recordings)
    elif not run_dir.is_dir():
        msg = (
            f"{run_dir}: no such run directory. Run `dynmap ingest LOG -o {run_dir}` or `dynmap build` first."
        )
        raise ArtifactError(msg)
    with writing(run_dir, is_output=stage is INGEST):
        finish_swap(run_dir, STAGE_PLACES)
        if stage is INGEST and not force:
            refuse_other_recordings(run_dir, recordings)
        result = run_stage(stage, context_of(run_dir, config, threads, tuple(recordings)), force=force)
        _note_run(result, run_dir, config)
    return result


def run_stage(stage: Stage, context: StageContext, *, force: bool, target: Path | None = None) -> StageResult:
    """Run a stage unless its result is up to date; publish its files, the manifest last.

    The work writes into a scratch folder, so a failure leaves earlier results as they were.

    Parameters
    ----------
    stage : Stage
    context : StageContext
        Its `out_dir` is replaced by the scratch folder.
    force : bool
        Run it also where its result is up to date.
    target : Path, optional
        Where its files go; without it the stage's own folder in the run.
    """
    folder = target or (context.run_dir / stage.folder if stage.folder else context.run_dir)
    settings = {**_settings_of(stage, context.config), **context.options}
    done = None if force else read_manifest(folder, stage.name)
    inputs = _input_digests(stage, context)
    if done is not None:
        why = why_again(done, stage.section, settings, inputs, folder)
        if not why:
            _log.info("%s: up to date", stage.name)
            discard_scratch(folder / stage.name)
            return StageResult(stage.name, ran=False, manifest=done, folder=folder)
        _log.info("%s: runs again, %s", stage.name, why)
    _log.info("%s: %s", stage.name, stage.title)
    if stage.has_kernels:
        announce_compilation()
    if stage.needs is not None:
        check_space(stage.name, *stage.needs(context), folder)
    started = time.process_time()
    with scratch_folder(folder / stage.name) as part:
        summary = stage.run(replace(context, out_dir=part))
        outputs = {
            path.relative_to(part).as_posix(): sha256_of(path)
            for path in sorted(part.rglob("*"))
            if path.is_file()
        }
        # They go to terminals, and names of others stand in them.
        summary["lines"] = [printable(line) for line in summary.get("lines", ())]
        manifest = Manifest(
            stage=stage.name,
            settings=settings,
            inputs=inputs,
            outputs=outputs,
            summary=summary,
            seconds=round(time.process_time() - started, 3),
            dynmap_version=__version__,
        )
        publish(part, folder, manifest)
    return StageResult(stage.name, ran=True, manifest=manifest, folder=folder)


def is_up_to_date(stage: Stage, context: StageContext) -> bool:
    """Whether `run_stage` would find nothing to do; says nothing."""
    folder = context.run_dir / stage.folder
    done = read_manifest(folder, stage.name)
    settings = {**_settings_of(stage, context.config), **context.options}
    return done is not None and not why_again(
        done, stage.section, settings, _input_digests(stage, context), folder
    )


def context_of(run_dir: Path, config: Config, threads: int, recordings: tuple[Path, ...]) -> StageContext:
    """What every stage of a run directory is given."""
    return StageContext(run_dir, run_dir, config, recordings, threads, scans_dir=run_dir / INGEST.folder)


def _settings_of(stage: Stage, config: Config) -> dict[str, Any]:
    """The settings that the result of a stage depends on."""
    section = getattr(config, stage.section, None)
    settings: dict[str, Any] = {} if section is None else section.model_dump(mode="json")
    if stage.seeded:
        settings["seed"] = config.seed
    return settings


def _input_digests(stage: Stage, context: StageContext) -> dict[str, str]:
    """Digests of what a stage reads: of the recordings, or as the manifests of earlier stages state them."""
    if stage is INGEST:
        return _recording_digests(context)
    inputs = output_digests(context.scans_dir, INGEST)
    if context.map_yaml is not None:
        return inputs | digests_of((context.map_yaml, image_of(context.map_yaml)), ArtifactError)
    if context.scans_dir == context.run_dir / INGEST.folder:
        check_chain(context.run_dir, stage)
    for earlier in read_by(stage):
        if earlier is not INGEST:
            inputs.update(output_digests(context.run_dir / earlier.folder, earlier))
    if f"{known.FOLDER}/" in stage.reads:
        inputs.update(known.known_digests(context.run_dir))
    if edits.NAME in stage.reads:
        inputs.update(edits.edit_digests(context.run_dir))
    return inputs | digests_of(context.beside, ArtifactError)


def _recording_digests(context: StageContext) -> dict[str, str]:
    """Digests of the recordings, and of those that were read before."""
    recordings = digests_of(context.recordings, LogError)
    if context.earlier_scans is None:
        return recordings
    before = read_manifest(context.earlier_scans, INGEST.name)
    return {**(before.inputs if before else {}), **recordings}


def _note_run(result: StageResult, run_dir: Path, config: Config) -> None:
    """Keep run.yaml in step with what was run."""
    if result.ran or not _is_noted(result, run_dir / "run.yaml"):
        write_run_yaml(run_dir, config)


def _is_noted(result: StageResult, path: Path) -> bool:
    """Whether run.yaml says of a finished stage what its manifest says; a killed process may have left it behind."""
    try:
        content = parse_yaml(read_text(path))
        stage = next(stage for stage in STAGES if stage.name == result.stage)
        is_same = content["settings"].get(stage.section, result.manifest.settings) == result.manifest.settings
        return bool(is_same and (stage is not INGEST or content["recordings"] == result.manifest.inputs))
    except DAMAGE:
        return False


def write_run_yaml(run_dir: Path, config: Config) -> None:
    """Write the inputs of a run, the versions, and the settings: of finished stages those they were run with."""
    settings = config.model_dump(mode="json")
    recordings: dict[str, str] = {}
    for stage in STAGES:
        done = read_manifest_or_none(run_dir / stage.folder, stage.name)
        if done is not None and stage.section in settings:
            settings[stage.section] = done.settings
        if done is not None and stage is INGEST:
            recordings = done.inputs
    content = {
        "dynmap": __version__,
        "python": platform.python_version(),
        **{name: version(name) for name in ("numpy", "scipy", "numba")},
        "recordings": recordings,
        "settings": settings,
    }
    with replacing(run_dir / "run.yaml") as part:
        part.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def _forget_numbers(run_dir: Path, recordings: Sequence[Path]) -> None:
    """Let sub-maps be numbered anew, unless corrections by hand of the same recordings mean them by their numbers.

    Corrections that were made for other recordings are put aside.
    """
    if (run_dir / edits.NAME).is_file():
        done = read_manifest_or_none(run_dir / INGEST.folder, INGEST.name)
        if done and sorted(done.inputs.values()) == sorted(digests_of(recordings, LogError).values()):
            return
        aside = (run_dir / edits.NAME).replace(run_dir / f"{edits.NAME}.old")
        _log.warning(
            "warning: the corrections by hand were made for other recordings, they are now in %s", aside
        )
    known.forget(run_dir)
