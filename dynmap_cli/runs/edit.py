"""Corrections by hand: written into the run, and applied by the stages whenever they run again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dynmap_cli.clustering.stage import CORRECT as CORRECT_STATES
from dynmap_cli.clustering.stage import STAGE as CLUSTER
from dynmap_cli.config import Config
from dynmap_cli.domain.corrections import Addition, Correction, Drop, Merge, Name, Place, describe
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.errors import ArtifactError, ConfigError
from dynmap_cli.files.atomic import scratch_folder
from dynmap_cli.files.counting_map import read_map_frame
from dynmap_cli.files.damage import reason
from dynmap_cli.files.edits import check_name, read_edits, read_polygon, write_edits
from dynmap_cli.files.known import FOLDER, forget, remember
from dynmap_cli.files.lock import reading, writing
from dynmap_cli.files.patch_archive import read_patches
from dynmap_cli.files.publishing import finish_swap
from dynmap_cli.files.scan_log import read_scan_log
from dynmap_cli.files.submaps import read_submaps
from dynmap_cli.ingest.stage import STAGE as INGEST
from dynmap_cli.mapping.stage import STAGE as MAP
from dynmap_cli.report.stage import STAGE as REPORT
from dynmap_cli.runs.consistency import check_finished
from dynmap_cli.runs.floor_plan import STAGE_PLACES
from dynmap_cli.runs.pipeline import StageResult, context_of, is_up_to_date, run_stage, write_run_yaml
from dynmap_cli.runs.update import settings_of
from dynmap_cli.segmentation.corrections import added_submap
from dynmap_cli.segmentation.settings import margin_cells
from dynmap_cli.segmentation.stage import CORRECT as CORRECT_SUBMAPS
from dynmap_cli.segmentation.stage import STAGE as SEGMENT
from dynmap_cli.stage import Stage


@dataclass(frozen=True, slots=True)
class Wishes:
    """What is to be corrected, as it was asked for; it is taken up in this order.

    Attributes
    ----------
    undo : int or None
        Number of the correction that is taken back, from 1.
    polygons : tuple of Path
        Files with the corners of areas to add.
    merges : tuple of (int, tuple of int)
        Sub-map, and states of it that are one.
    names : tuple of (int, str)
        Sub-map, and what it is called.
    drops : tuple of int
        Sub-maps that are none.
    """

    undo: int | None = None
    polygons: tuple[Path, ...] = ()
    merges: tuple[tuple[int, tuple[int, ...]], ...] = ()
    names: tuple[tuple[int, str], ...] = ()
    drops: tuple[int, ...] = ()


def edit(run_dir: Path, wishes: Wishes, *, threads: int) -> tuple[tuple[Correction, ...], list[StageResult]]:
    """Record corrections in a run, and run the stages that depend on them; without any, those that are out of date.

    Parameters
    ----------
    run_dir : Path
    wishes : Wishes
    threads : int

    Returns
    -------
    tuple of Correction
        All corrections of the run, in order.
    list of StageResult
        Of segment, cluster and report.

    Raises
    ------
    ConfigError
        If a sub-map, a state or a correction is not there, or a polygon or a name is none; nothing is changed then.
    ArtifactError
        If the run is not finished.
    """
    _check_there(run_dir)
    with writing(run_dir):
        finish_swap(run_dir, STAGE_PLACES)
        check_finished(run_dir, (INGEST, MAP))
        read_scan_log(
            run_dir / INGEST.folder
        )  # refuses a run whose scans were taken away before anything is written
        config = settings_of(run_dir)
        before = read_edits(run_dir)
        context = context_of(run_dir, config, threads, ())
        results = []
        if not all(is_up_to_date(stage, context) for stage in (SEGMENT, CLUSTER)):
            # What is corrected are the sub-maps and states of now.
            results = [run_stage(stage, context, force=False) for stage in (SEGMENT, CLUSTER)]
        corrections = _corrected(run_dir, before, wishes, config)
        if corrections != before or (corrections and not (run_dir / FOLDER).is_dir()):
            _record(run_dir, corrections)
            results = [run_stage(stage, context, force=False) for stage in _again(before, corrections)]
        stages = (REPORT,) if results else (SEGMENT, CLUSTER, REPORT)
        results += [run_stage(stage, context, force=False) for stage in stages]
        write_run_yaml(run_dir, config)
    return corrections, results


def corrections_of(run_dir: Path) -> tuple[Correction, ...]:
    """All corrections of a run, in order."""
    _check_there(run_dir)
    with reading(run_dir):
        return read_edits(run_dir)


def list_lines(corrections: Sequence[Correction]) -> list[str]:
    """A line for each, with its number."""
    lines = [f"correction {number}: {describe(one)}" for number, one in enumerate(corrections, start=1)]
    return lines or ["no correction"]


def _check_there(run_dir: Path) -> None:
    """Refuse a run that is not there, before a lock makes its folder."""
    if not run_dir.is_dir():
        msg = f"{run_dir}: no such run directory. Run `dynmap build LOG -o {run_dir}` first."
        raise ArtifactError(msg)


def _record(run_dir: Path, corrections: Sequence[Correction]) -> None:
    """Write edits.yaml, and remember what was found, so that numbers stay whatever is found later."""
    with scratch_folder(run_dir / "edit") as beside:
        remember(run_dir, beside)
        forget(run_dir)
        (beside / FOLDER).rename(run_dir / FOLDER)
    write_edits(run_dir, corrections)


def _again(before: Sequence[Correction], now: Sequence[Correction]) -> tuple[Stage, Stage]:
    """The stages that corrections make run again: what they leave as it is, is neither looked for nor learned again.

    Which areas there are, and so whose states are learned, depends on those that are dropped or added by hand only.
    """
    areas = [[one for one in some if isinstance(one, Drop | Addition)] for some in (before, now)]
    return CORRECT_SUBMAPS, CORRECT_STATES if areas[0] == areas[1] else CLUSTER


def _corrected(
    run_dir: Path, before: tuple[Correction, ...], wishes: Wishes, config: Config
) -> tuple[Correction, ...]:
    """The corrections of before with those that are asked for; refuses what makes no sense in this run."""
    corrections = list(before)
    if wishes.undo is not None:
        if not 1 <= wishes.undo <= len(corrections):
            there = f"there are 1 to {len(corrections)}" if corrections else "there is none"
            msg = f"--undo {wishes.undo}: no such correction; {there}. `dynmap edit {run_dir} --list` shows them."
            raise ConfigError(msg)
        del corrections[wishes.undo - 1]
    submaps = {submap.submap_id: submap for submap in read_submaps(run_dir / SEGMENT.folder)}
    for path in wishes.polygons:
        addition, submap = _added(run_dir, path, [*submaps, *map(_number_of, before)], config)
        submaps[submap.submap_id] = submap
        corrections.append(addition)
    patch_sets = read_patches(run_dir / CLUSTER.folder / "patches.zip")
    states = {one.submap_id: [patch.patch_id for patch in one.patches] for one in patch_sets}
    for number, merged in wishes.merges:
        place = _place(run_dir, f"--merge {number}:{','.join(map(str, merged))}", number, submaps)
        corrections.append(Merge(place, _states(number, merged, states.get(number, []))))
        states[number] = [state for state in states[number] if state not in merged or state == min(merged)]
    for number, name in wishes.names:
        try:
            words = check_name(name)
        except ValueError as err:
            msg = f"--name {number}: {err}"
            raise ConfigError(msg) from err
        corrections.append(Name(_place(run_dir, f"--name {number}", number, submaps), words))
    for number in wishes.drops:
        corrections.append(Drop(_place(run_dir, f"--drop {number}", number, submaps)))
        del submaps[number]
    return tuple(corrections)


def _number_of(correction: Correction) -> int:
    """The sub-map that a correction is about."""
    return correction.submap_id if isinstance(correction, Addition) else correction.place.submap_id


def _added(run_dir: Path, path: Path, numbers: Sequence[int], config: Config) -> tuple[Addition, SubMap]:
    """A new area with a number that no sub-map has or had."""
    frame = read_map_frame(run_dir / MAP.folder / "reflectance.npz")
    try:
        addition = Addition(max(numbers, default=-1) + 1, read_polygon(path))
    except (OSError, ValueError) as err:
        msg = (
            f"{path}: not a polygon ({reason(err)}). Give three or more lines `x,y`, metres in the map frame."
        )
        raise ConfigError(msg) from err
    submap = added_submap(addition, frame, margin_cells(config.segmentation, frame.resolution_m))
    if submap is None:
        left, bottom = frame.origin_x_m, frame.origin_y_m
        right, top = left + frame.cols * frame.resolution_m, bottom + frame.rows * frame.resolution_m
        msg = (
            f"{path}: no cell of the map lies in this polygon; the map is x {left:.1f} to {right:.1f}, "
            f"y {bottom:.1f} to {top:.1f} m."
        )
        raise ConfigError(msg)
    cap_m2 = config.segmentation.max_area_m2
    if submap.area_m2 > cap_m2:
        msg = (
            f"{path}: its rectangle has {submap.area_m2:.1f} m2, a sub-map at most {cap_m2:g} m2 "
            "(segmentation.max_area_m2). Give several smaller ones."
        )
        raise ConfigError(msg)
    return addition, submap


def _place(run_dir: Path, option: str, number: int, submaps: dict[int, SubMap]) -> Place:
    """The sub-map of a number, and where it is."""
    if number not in submaps:
        there = f"there are {', '.join(map(str, sorted(submaps)))}" if submaps else "there is none"
        msg = f"{option}: no sub-map {number}; {there}. `dynmap timeline {run_dir}` lists them."
        raise ConfigError(msg)
    return Place(number, submaps[number].rectangle)


def _states(number: int, merged: Sequence[int], there: Sequence[int]) -> tuple[int, ...]:
    """Two states or more, all of which the sub-map has."""
    missing = sorted(set(merged) - set(there))
    if missing or len(set(merged)) < 2:
        states = f"has states {', '.join(map(str, there))}" if there else "has no states"
        what = f"no state {missing[0]}" if missing else "two states or more are needed"
        msg = f"--merge {number}:{','.join(map(str, merged))}: {what}; sub-map {number} {states}."
        raise ConfigError(msg)
    return tuple(sorted(set(merged)))
