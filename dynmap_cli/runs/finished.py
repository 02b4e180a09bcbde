"""What a finished run is used for: to localize in it, to clean recordings, to plan on it, to look into it."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from dynmap_cli.clustering.stage import STAGE as CLUSTER
from dynmap_cli.comparison import stage as comparison
from dynmap_cli.config import Config
from dynmap_cli.errors import ArtifactError
from dynmap_cli.export.stage import check_output, clean_to_file
from dynmap_cli.files.lock import writing
from dynmap_cli.files.manifest import manifest_path
from dynmap_cli.files.patch_archive import read_names, read_patches
from dynmap_cli.files.pgm import image_of, read_map
from dynmap_cli.given import check_apart, check_recordings
from dynmap_cli.history import stage as history
from dynmap_cli.ingest.stage import STAGE as INGEST
from dynmap_cli.localization.stage import STAGE as LOCALIZE
from dynmap_cli.mapping.stage import STAGE as MAP
from dynmap_cli.planner import stage as planner
from dynmap_cli.planner.choice import StateRule
from dynmap_cli.runs.consistency import finished_run, refuse_other_recordings
from dynmap_cli.runs.floor_plan import STAGES
from dynmap_cli.runs.pipeline import StageResult, context_of, run_stage
from dynmap_cli.segmentation.stage import STAGE as SEGMENT
from dynmap_cli.stage import StageContext


def localize(
    run_dir: Path | None,
    recordings: Sequence[Path],
    out_dir: Path,
    config: Config,
    *,
    threads: int,
    force: bool,
    map_yaml: Path | None = None,
) -> list[StageResult]:
    """Localize recordings in the maps of a run, or in any map_server map.

    The columns of the recording go to `<out_dir>/scans`, the results straight into *out_dir*.
    """
    _check_no_run(out_dir)
    check_recordings(recordings)
    check_apart(out_dir, recordings)
    context = replace(
        context_of(run_dir or out_dir, config, threads, ()),
        scans_dir=out_dir / INGEST.folder,
        map_yaml=map_yaml,
    )
    with ExitStack() as locks:
        if run_dir is not None:
            # A run whose scans were taken away to save space can still be localized in.
            locks.enter_context(finished_run(run_dir, (MAP, CLUSTER)))
        if map_yaml is not None:
            image_of(map_yaml)  # refuses what is no map before a long recording is read
        locks.enter_context(writing(out_dir, is_output=True))
        if not force:
            refuse_other_recordings(out_dir, recordings)
        ingested = run_stage(INGEST, context_of(out_dir, config, threads, tuple(recordings)), force=force)
        return [ingested, run_stage(_LOCALIZE_AND_DRAW, context, force=force, target=out_dir)]


def _localize_and_draw(context: StageContext) -> dict[str, Any]:
    """The work of the stage, and a picture of what it wrote."""
    from dynmap_cli.report.localized import NAME, draw_localized

    summary = LOCALIZE.run(context)
    archive = context.run_dir / CLUSTER.folder / "patches.zip"
    is_plain = context.map_yaml is not None
    grid, _ = read_map(context.map_yaml or context.run_dir / MAP.folder / "map.yaml")
    picture = draw_localized(
        grid,
        () if is_plain else read_patches(archive),
        {} if is_plain else read_names(archive),
        context.out_dir,
        summary["places_to_update"],
    )
    picture.save(context.out_dir / NAME)
    return summary


_LOCALIZE_AND_DRAW = replace(LOCALIZE, run=_localize_and_draw, writes=(*LOCALIZE.writes, "localization.png"))


def compare(
    run_dir: Path,
    recordings: Sequence[Path],
    out_dir: Path,
    config: Config,
    truth: comparison.TruthFiles,
    *,
    most_states: int,
    threads: int,
    force: bool,
) -> list[StageResult]:
    """Localize recordings in the patch map of a run and in maps without it; their columns go to `<out_dir>/scans`."""
    _check_no_run(out_dir)
    check_recordings(recordings)
    check_apart(out_dir, recordings)
    context = replace(
        context_of(run_dir, config, threads, ()),
        scans_dir=out_dir / INGEST.folder,
        beside=truth.paths(),
        options={
            "--states": most_states,
            "--truth": str(truth.recording or ""),
            "--map-truth": str(truth.mapped or ""),
        },
    )
    with finished_run(run_dir, (MAP, SEGMENT, CLUSTER)), writing(out_dir, is_output=True):
        if not force:
            refuse_other_recordings(out_dir, recordings)
        ingested = run_stage(INGEST, context_of(out_dir, config, threads, tuple(recordings)), force=force)
        compared = run_stage(comparison.stage_of(truth, most_states), context, force=force, target=out_dir)
        return [ingested, compared]


_FOLDERS_OF_A_RUN = {"scans", "map", "submaps", "patches", "figures", "known", "timeline"}


def _check_no_run(out_dir: Path) -> None:
    """Refuse an output folder that holds a run."""
    if manifest_path(out_dir / MAP.folder, MAP.name).exists():
        msg = f"{out_dir}: is a run directory, its scans would be replaced. Choose another output."
        raise ArtifactError(msg)
    above = out_dir.resolve().parent
    if manifest_path(above / MAP.folder, MAP.name).exists() and out_dir.resolve().name in _FOLDERS_OF_A_RUN:
        msg = f"{out_dir}: is a part of the run {above}. Choose another output."
        raise ArtifactError(msg)


def clean(
    recordings: Sequence[Path],
    out_path: Path,
    config: Config,
    *,
    run_dir: Path | None,
    keep_changing: bool,
    is_label: bool,
    force: bool,
    threads: int,
) -> dict[str, Any]:
    """Write recordings without the beams that hit something that moves; without *run_dir* they are mapped first."""
    check_recordings(recordings)
    check_output(out_path, recordings, force=force)
    stages = STAGES[: STAGES.index(CLUSTER if keep_changing else MAP) + 1]
    with ExitStack() as stack:
        if run_dir is None:
            run_dir = Path(stack.enter_context(TemporaryDirectory(prefix="dynmap-")))
            context = context_of(run_dir, config, threads, tuple(recordings))
            for stage in stages:
                run_stage(stage, context, force=False)
        else:
            remedy = "Leave out --run to have the recordings mapped first."
            stack.enter_context(finished_run(run_dir, stages, remedy))
        return clean_to_file(
            run_dir, recordings, out_path, config.ingest, keep_changing=keep_changing, is_label=is_label
        )


def export_map(run_dir: Path, out_dir: Path, rule: StateRule, *, force: bool) -> dict[str, Any]:
    """Write the map with each sub-map in the state of a rule, and the mask of all sub-maps."""
    with finished_run(run_dir, (MAP, SEGMENT, CLUSTER)):
        planner.check_output(out_dir, force=force)
        return planner.export_map(run_dir, out_dir, rule)


def write_timeline(run_dir: Path, out_dir: Path) -> dict[str, Any]:
    """Write which state each sub-map was seen in, and when."""
    with finished_run(run_dir, (MAP, SEGMENT, CLUSTER)):
        return history.write_timeline(run_dir, out_dir)


def explain(run_dir: Path, submap_id: int) -> dict[str, Any]:
    """Tell why an area is a sub-map, who saw what of it, and which states that makes."""
    with finished_run(run_dir, (INGEST, MAP, SEGMENT, CLUSTER)):
        return history.explain(run_dir, submap_id)
