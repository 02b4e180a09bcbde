"""The floor plan: the stages, in order, and the rules by which they are run, skipped and published."""

from __future__ import annotations

import logging
import platform
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import yaml

from dynmap_cli import __version__
from dynmap_cli.clustering.stage import STAGE as CLUSTER
from dynmap_cli.compiling import announce_compilation
from dynmap_cli.config import Config
from dynmap_cli.errors import ArtifactError, LogError
from dynmap_cli.files import edits, known
from dynmap_cli.files.atomic import discard_scratch, replacing, scratch_folder
from dynmap_cli.files.damage import DAMAGE
from dynmap_cli.files.documents import parse_yaml, read_text
from dynmap_cli.files.lock import reading, writing
from dynmap_cli.files.manifest import (
    Manifest,
    damaged,
    read_manifest,
    sha256_of,
)
from dynmap_cli.files.pgm import image_of
from dynmap_cli.files.publishing import finish_swap, publish, read_manifest_or_none
from dynmap_cli.files.space import check_space
from dynmap_cli.given import check_recordings, digests_of
from dynmap_cli.ingest.stage import STAGE as INGEST
from dynmap_cli.mapping.stage import STAGE as MAP
from dynmap_cli.printable import printable
from dynmap_cli.report.stage import STAGE as REPORT
from dynmap_cli.reruns import check_same_recordings, why_again
from dynmap_cli.segmentation.stage import STAGE as SEGMENT
from dynmap_cli.stage import Stage, StageContext

_log = logging.getLogger(__name__)

STAGES = (INGEST, MAP, SEGMENT, CLUSTER, REPORT)
"""What `dynmap build` runs, in this order; each reads only what earlier ones wrote."""
STAGE_PLACES = tuple((stage.folder, stage.name) for stage in STAGES)
"""Folder and name of each, as `finish_swap` wants them."""


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
    names = [stage.name for stage in STAGES]
    forced = 0 if force else len(names) if force_from is None else names.index(force_from)
    context = context_of(run_dir, config, threads, tuple(recordings))
    check_recordings(recordings)
    results = []
    with writing(run_dir, is_output=True):
        finish_swap(run_dir, STAGE_PLACES)
        if force:
            _forget_others(run_dir, recordings)
        else:
            keep_recordings(run_dir, recordings)
        for number, stage in enumerate(STAGES):
            results.append(run_stage(stage, context, force=number >= forced))
            _note_run(results[-1], run_dir, config)
    return results


def _forget_others(run_dir: Path, recordings: Sequence[Path]) -> None:
    """Forget numbers of before; corrections by hand, and the numbers they need, only if of other recordings."""
    if (run_dir / edits.NAME).is_file():
        done = read_manifest_or_none(run_dir / INGEST.folder, INGEST.name)
        if done and sorted(done.inputs.values()) == sorted(digests_of(recordings, LogError).values()):
            return
        aside = (run_dir / edits.NAME).replace(run_dir / f"{edits.NAME}.old")
        _log.warning(
            "warning: the corrections by hand were made for other recordings, they are now in %s", aside
        )
    known.forget(run_dir)


def run_one(
    run_dir: Path, name: str, config: Config, *, threads: int, force: bool, recordings: Sequence[Path] = ()
) -> StageResult:
    """Run a single stage of a run directory."""
    stage = next(stage for stage in STAGES if stage.name == name)
    if stage is INGEST:
        check_recordings(recordings)
    elif not run_dir.is_dir():
        msg = (
            f"{run_dir}: no such run directory. Run `dynmap ingest LOG -o {run_dir}` or `dynmap build` first."
        )
        raise ArtifactError(msg)
    with writing(run_dir, is_output=stage is INGEST):
        finish_swap(run_dir, STAGE_PLACES)
        if stage is INGEST and not force:
            keep_recordings(run_dir, recordings)
        result = run_stage(stage, context_of(run_dir, config, threads, tuple(recordings)), force=force)
        _note_run(result, run_dir, config)
    return result


@contextmanager
def finished_run(run_dir: Path, stages: Sequence[Stage], remedy: str = "") -> Iterator[None]:
    """Hold a run for reading; these stages are done, from one another's files, which are as they were written."""
    if not run_dir.is_dir():
        msg = f"{run_dir}: no such run directory. {remedy or f'Run `dynmap build LOG -o {run_dir}` first.'}"
        raise ArtifactError(msg)
    with reading(run_dir):
        check_finished(run_dir, stages)
        yield


def check_finished(run_dir: Path, stages: Sequence[Stage]) -> None:
    """Refuse a run in which a stage is not done, or was made from other files than those of the run."""
    for stage in stages:
        _outputs_of(run_dir / stage.folder, stage)
    _check_made(run_dir, stages)
    _check_edits(run_dir, stages)


def _check_edits(run_dir: Path, stages: Sequence[Stage]) -> None:
    """Refuse corrections by hand that cannot be read, and results that do not follow those that are there now."""
    edits.read_edits(run_dir)
    now = edits.edit_digests(run_dir)
    for stage in stages:
        done = read_manifest(run_dir / stage.folder, stage.name)
        then = {name: digest for name, digest in (done.inputs if done else now).items() if name == edits.NAME}
        if edits.NAME in stage.reads and now != then:
            msg = (
                f"{run_dir / edits.NAME}: changed since '{stage.name}' was run. Run `dynmap edit {run_dir}`."
            )
            raise ArtifactError(msg)


def run_stage(stage: Stage, context: StageContext, *, force: bool, target: Path | None = None) -> StageResult:
    """Run a stage unless its result is up to date; publish its files, the manifest last.

    The work writes into a scratch folder, so a failure leaves earlier results as they were.
    """
    folder = target or (context.run_dir / stage.folder if stage.folder else context.run_dir)
    settings = {**_settings_of(stage, context.config), **context.options}
    done = None if force else read_manifest(folder, stage.name)
    inputs = _inputs_of(stage, context)
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
        done, stage.section, settings, _inputs_of(stage, context), folder
    )


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


def _inputs_of(stage: Stage, context: StageContext) -> dict[str, str]:
    """Digests of what a stage reads: of the recordings, or as the manifests of earlier stages state them."""
    if stage is INGEST:
        return _recordings_of(context)
    inputs = _outputs_of(context.scans_dir, INGEST)
    if context.map_yaml is not None:
        return inputs | digests_of((context.map_yaml, image_of(context.map_yaml)), ArtifactError)
    if context.scans_dir == context.run_dir / INGEST.folder:
        check_chain(context.run_dir, stage)
    for earlier in _read_by(stage):
        if earlier is not INGEST:
            inputs.update(_outputs_of(context.run_dir / earlier.folder, earlier))
    if f"{known.FOLDER}/" in stage.reads:
        inputs.update(known.known_digests(context.run_dir))
    if edits.NAME in stage.reads:
        inputs.update(edits.edit_digests(context.run_dir))
    return inputs | digests_of(context.beside, ArtifactError)


def _recordings_of(context: StageContext) -> dict[str, str]:
    """Digests of the recordings, and of those that were read before."""
    recordings = digests_of(context.recordings, LogError)
    if context.earlier_scans is None:
        return recordings
    before = read_manifest(context.earlier_scans, INGEST.name)
    return {**(before.inputs if before else {}), **recordings}


def _read_by(stage: Stage) -> list[Stage]:
    """The earlier stages whose files a stage reads."""
    return [
        earlier
        for earlier in STAGES
        if earlier.folder and any(path.startswith(f"{earlier.folder}/") for path in stage.reads)
    ]


def _outputs_of(folder: Path, stage: Stage) -> dict[str, str]:
    """Digests of the files of a finished stage, by their path in the run; the files are still what they were."""
    manifest = read_manifest(folder, stage.name)
    if manifest is None:
        msg = f"{folder}: stage '{stage.name}' is not done here. Run `dynmap build` or `dynmap {stage.name}` first."
        raise ArtifactError(msg)
    path = damaged(folder, manifest)
    if path is not None:
        msg = (
            f"{path}: not what stage '{stage.name}' wrote (missing, changed or damaged). "
            f"Run `dynmap {stage.name}` again with --force."
        )
        raise ArtifactError(msg)
    return {f"{stage.folder}/{name}": digest for name, digest in manifest.outputs.items()}


def check_chain(run_dir: Path, stage: Stage) -> None:
    """Refuse files that were made from others than those which are there now.

    A run whose scans were taken away to save space can still be localized in.
    """
    _check_made(run_dir, _read_by(stage))


def _check_made(run_dir: Path, stages: Sequence[Stage]) -> None:
    """Refuse results of stages that were made from other files than those of the run."""
    done = {earlier: read_manifest(run_dir / earlier.folder, earlier.name) for earlier in _read_by(REPORT)}
    for later in stages:
        made = done[later]
        for earlier in _read_by(later):
            source = done[earlier]
            if made is None or source is None:
                continue
            now = {f"{earlier.folder}/{name}": digest for name, digest in source.outputs.items()}
            then = {name: made.inputs[name] for name in made.inputs if name.startswith(f"{earlier.folder}/")}
            if now != then:
                msg = (
                    f"{run_dir / later.folder}: made from another {earlier.folder}/ than is there now. "
                    f"Run `dynmap {later.name} {run_dir}`, or `dynmap build`, which runs all that is out of date."
                )
                raise ArtifactError(msg)


def keep_recordings(folder: Path, recordings: Sequence[Path]) -> None:
    """Refuse other recordings than those that a folder was made from."""
    done = read_manifest(folder / INGEST.folder, INGEST.name)
    check_same_recordings(folder, done, digests_of(recordings, LogError))
