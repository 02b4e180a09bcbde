"""Whether the results in a run are done, as they were written, and made from one another; else they are refused."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from dynmap_cli.errors import ArtifactError, LogError
from dynmap_cli.files import edits
from dynmap_cli.files.lock import reading
from dynmap_cli.files.manifest import damaged, read_manifest
from dynmap_cli.given import digests_of
from dynmap_cli.ingest.stage import STAGE as INGEST
from dynmap_cli.report.stage import STAGE as REPORT
from dynmap_cli.runs.floor_plan import read_by
from dynmap_cli.runs.reruns import check_same_recordings
from dynmap_cli.stage import Stage

_MOST_NAMED = 3
"""So many runs are named where one of them may have been meant."""


@contextmanager
def finished_run(run_dir: Path, stages: Sequence[Stage], remedy: str = "") -> Iterator[None]:
    """Hold a run for reading; these stages are done, from one another's files, which are as they were written."""
    remedy = remedy or f"Run `dynmap build LOG -o {run_dir}` first."
    if not run_dir.is_dir():
        msg = f"{run_dir}: no such run directory. {remedy}"
        raise ArtifactError(msg)
    if not _is_run(run_dir) and (near := _runs_near(run_dir)):
        msg = f"{run_dir}: no run directory. Did you mean {' or '.join(map(str, near))}?"
        raise ArtifactError(msg)
    with reading(run_dir):
        check_finished(run_dir, stages)
        yield


def _is_run(folder: Path) -> bool:
    """Whether a stage of a run was done here; the folder of a localization has scans, too."""
    return (folder / "run.yaml").is_file()


def _runs_near(folder: Path) -> list[Path]:
    """Runs that may have been meant: the one that holds a folder, or those in it; none if there are many."""
    above = [one for one in list(folder.parents)[:2] if _is_run(one)]
    inside = sorted(path.parent for path in folder.glob("*/run.yaml"))
    return above[:1] or (inside if len(inside) <= _MOST_NAMED else [])


def check_finished(run_dir: Path, stages: Sequence[Stage]) -> None:
    """Refuse a run in which a stage is not done, or was made from other files than those of the run."""
    for stage in stages:
        output_digests(run_dir / stage.folder, stage)
    _check_made(run_dir, stages)
    _check_edits(run_dir, stages)


def check_chain(run_dir: Path, stage: Stage) -> None:
    """Refuse what a stage reads if it was made from other files than those which are there now.

    Only what is there is compared: a run whose scans were taken away to save space can still be localized in.
    """
    _check_made(run_dir, read_by(stage))


def _check_made(run_dir: Path, stages: Sequence[Stage]) -> None:
    """Refuse results of stages that were made from other files than those of the run."""
    done = {earlier: read_manifest(run_dir / earlier.folder, earlier.name) for earlier in read_by(REPORT)}
    for later in stages:
        made = done[later]
        for earlier in read_by(later):
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


def output_digests(folder: Path, stage: Stage) -> dict[str, str]:
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


def refuse_other_recordings(folder: Path, recordings: Sequence[Path]) -> None:
    """Refuse other recordings than those that a folder was made from."""
    done = read_manifest(folder / INGEST.folder, INGEST.name)
    check_same_recordings(folder, done, digests_of(recordings, LogError))
