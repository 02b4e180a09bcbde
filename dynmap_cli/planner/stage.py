"""The door of the room: a finished run -> map.pgm and mask.pgm with their YAML."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dynmap_cli.arrays import I8
from dynmap_cli.domain.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from dynmap_cli.domain.patches import PatchSet, Visit
from dynmap_cli.domain.points import point_for_people
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.domain.times import readable_time
from dynmap_cli.errors import ArtifactError, ConfigError
from dynmap_cli.files.atomic import scratch_folder
from dynmap_cli.files.patch_archive import read_patches, read_visits
from dynmap_cli.files.pgm import read_map, write_map
from dynmap_cli.files.submaps import read_submaps
from dynmap_cli.files.trajectory import format_stamp
from dynmap_cli.planner.choice import OPEN, UNION, Choice, StateRule, choose_states
from dynmap_cli.planner.painting import combined, mask_of, painted

MAP_NAME, MASK_NAME = "map", "mask"
_FILES = tuple(f"{name}.{suffix}" for name in (MAP_NAME, MASK_NAME) for suffix in ("pgm", "yaml"))
"""The YAML after its image, so that whoever sees the YAML finds both."""


def check_output(out_dir: Path, *, force: bool) -> None:
    """Refuse a folder of a run, and one whose files would be replaced."""
    if out_dir.is_dir() and any(out_dir.glob("*.manifest.json")):
        msg = f"{out_dir}: holds files of a run, which must stay as they are. Choose another output."
        raise ArtifactError(msg)
    there = [name for name in _FILES if (out_dir / name).exists()]
    if there and not force:
        msg = f"{out_dir / there[0]}: exists already. Pass --force to replace it, or choose another output."
        raise ArtifactError(msg)


def export_map(run_dir: Path, out_dir: Path, rule: StateRule) -> dict[str, Any]:
    """Write the map with every sub-map in the state of the rule, and the mask of all sub-maps.

    Parameters
    ----------
    run_dir : Path
        A run that is done up to `cluster`.
    out_dir : Path
        Made if it is missing.
    rule : StateRule
    """
    grid, _ = read_map(run_dir / "map" / "map.yaml")
    submaps = read_submaps(run_dir / "submaps")
    archive = run_dir / "patches" / "patches.zip"
    patch_sets = {patch_set.submap_id: patch_set for patch_set in read_patches(archive)}
    visits = read_visits(archive)
    _check_time(rule, visits)
    cells, rows = grid.cells, []
    for submap in submaps:
        choice = choose_states(rule, [visit for visit in visits if visit.submap_id == submap.submap_id])
        changed = 0
        if choice.states:
            state = _state_cells(rule, choice, patch_sets[submap.submap_id])
            cells, changed = painted(cells, submap, state)
        rows.append(_row(submap, choice, changed))
    _write(out_dir, OccupancyGrid(grid.frame, cells), mask_of(grid.frame, submaps))
    return {
        "state": rule.kind,
        "submaps": rows,
        "map": str(out_dir / f"{MAP_NAME}.yaml"),
        "mask": str(out_dir / f"{MASK_NAME}.yaml"),
        "lines": [_line(row) for row in rows] or ["no sub-map: the mask is empty"],
    }


def _check_time(rule: StateRule, visits: Sequence[Visit]) -> None:
    """Refuse a time before everything."""
    if rule.stamp_ns is None or not visits:
        return
    first, last = min(visit.start_ns for visit in visits), max(visit.end_ns for visit in visits)
    if rule.stamp_ns < first:
        msg = (
            f"--state at={format_stamp(rule.stamp_ns)}: before the first visit of a sub-map; visits are from "
            f"{readable_time(first)} ({format_stamp(first)}) to {readable_time(last)} ({format_stamp(last)}). "
            "Give a time from then on, or another state."
        )
        raise ConfigError(msg)


def _state_cells(rule: StateRule, choice: Choice, patch_set: PatchSet) -> I8:
    """(rows, cols) what is painted of a sub-map: the cells that vary.

    What is the same in all states is in the mean map, drawn from more beams than those of the visits.
    """
    states = {patch.patch_id: patch.cells for patch in patch_set.patches}
    if rule.kind in (OPEN, UNION):
        cells = combined(list(states.values()), FREE if rule.kind == OPEN else OCCUPIED)
    else:
        cells = states[choice.states[0]]
    cells[~patch_set.varying] = UNKNOWN
    return cells


def _row(submap: SubMap, choice: Choice, changed: int) -> dict[str, Any]:
    """What was done with a sub-map."""
    return {
        "submap": submap.submap_id,
        "name": submap.name or None,
        "center_m": list(submap.center_m),
        "states": list(choice.states),
        "seen_s": None if choice.seen_ns is None else format_stamp(choice.seen_ns),
        "why": choice.why,
        "changed_cells": changed,
    }


def _line(row: dict[str, Any]) -> str:
    """The same as a sentence."""
    name = f" ({row['name']})" if row["name"] else ""
    head = f"sub-map {row['submap']}{name} at {point_for_people(*row['center_m'])}: "
    if not row["states"]:
        return f"{head}{row['why']}; the mean map stays"
    names = ", ".join(map(str, row["states"]))
    state = f"state{'s' * (len(row['states']) != 1)} {names}"
    changed = row["changed_cells"]
    cells = f"{changed} cell{'s differ' if changed != 1 else ' differs'} from" if changed else "as in"
    return f"{head}{state}, {row['why']}; {cells} the mean map"


def _write(out_dir: Path, grid: OccupancyGrid, mask: OccupancyGrid) -> None:
    """Write both pairs beside the folder first."""
    folder = out_dir.resolve()
    with scratch_folder(folder) as part:
        write_map(part, MAP_NAME, grid)
        write_map(part, MASK_NAME, mask)
        folder.mkdir(parents=True, exist_ok=True)
        for name in _FILES:
            (part / name).replace(folder / name)
