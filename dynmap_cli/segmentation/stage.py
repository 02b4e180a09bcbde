"""The door of the room: scans and their path -> sub-maps, the areas that change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from dynmap_cli.domain.corrections import Addition
from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.files.counting_map import read_map_frame
from dynmap_cli.files.edits import NAME as EDITS
from dynmap_cli.files.edits import read_edits
from dynmap_cli.files.known import FOUND, found_submaps, read_known_submaps
from dynmap_cli.files.manifest import read_manifest
from dynmap_cli.files.registered import read_registered
from dynmap_cli.files.submaps import read_submaps, write_submaps
from dynmap_cli.progress import progress
from dynmap_cli.segmentation.settings import margin_cells
from dynmap_cli.stage import Stage, StageContext

_PLACES_PER_LINE = 5
_BYTES_PER_CELL = 2


def needs(context: StageContext) -> tuple[str, int]:
    """Room for the masks, which overlap where sub-maps were corrected by hand."""
    n_cells = (context.run_dir / "map" / "map.pgm").stat().st_size
    return f"the masks of areas on a map of {n_cells} cells", _BYTES_PER_CELL * n_cells


def run(context: StageContext) -> dict[str, Any]:
    """Find the sub-maps, give them the numbers of before, correct them by hand, write submaps/."""
    from dynmap_cli.counting.looks import time_windows
    from dynmap_cli.segmentation.finding import find_submaps
    from dynmap_cli.segmentation.numbering import keep_numbers

    settings = context.config.segmentation
    log, trajectory = read_registered(context.scans_dir, context.run_dir / "map")
    frame = read_map_frame(context.run_dir / "map" / "reflectance.npz")
    windows = len(time_windows(log, settings.window_s))
    with progress("segment", windows, "windows") as tick:
        submaps, found = find_submaps(log, trajectory.poses, frame, settings, tick, threads=context.threads)
    taken = [one.submap_id for one in read_edits(context.run_dir) if isinstance(one, Addition)]
    submaps = keep_numbers(submaps, read_known_submaps(context.run_dir), taken)
    return {
        **_write_corrected(context, submaps, frame),
        "contested_cells": int(found.contested.sum()),
        "windows": found.windows.count,
        "windows_needed": found.windows_needed,
    }


def correct(context: StageContext) -> dict[str, Any]:
    """Correct the sub-maps that were found before, where only the corrections changed since then."""
    done = read_manifest(context.run_dir / STAGE.folder, STAGE.name)
    frame = read_map_frame(context.run_dir / "map" / "reflectance.npz")
    submaps = read_submaps(found_submaps(context.run_dir))
    return {**(done.summary if done else {}), **_write_corrected(context, submaps, frame)}


def _write_corrected(context: StageContext, submaps: tuple[SubMap, ...], frame: GridFrame) -> dict[str, Any]:
    """Correct sub-maps by hand and write them; those that were found too, where there is a correction."""
    from dynmap_cli.segmentation.corrections import apply_corrections

    settings = context.config.segmentation
    corrections = read_edits(context.run_dir)
    lines: list[str] = []
    if corrections:
        write_submaps(context.out_dir / FOUND, submaps)
        submaps, lines = apply_corrections(
            submaps, corrections, frame, margin_cells(settings, frame.resolution_m)
        )
    write_submaps(context.out_dir, submaps)
    return {
        "submaps": len(submaps),
        "area_m2": round(_area_m2(submaps), 3),
        "lines": [*describe(submaps), *lines],
    }


def describe(submaps: tuple[SubMap, ...]) -> list[str]:
    """Say what was found, for people."""
    if not submaps:
        return ["no sub-map: no area was seen in two states well enough"]
    places = [
        f"{submap.called} at {submap.place} {submap.size_m[0]:.1f} x {submap.size_m[1]:.1f} m"
        for submap in submaps
    ]
    head = f"{len(submaps)} sub-map{'s' * (len(submaps) != 1)}, {_area_m2(submaps):.1f} m2: "
    rows = [", ".join(places[k : k + _PLACES_PER_LINE]) for k in range(0, len(places), _PLACES_PER_LINE)]
    return [head + rows[0], *rows[1:]]


def _area_m2(submaps: Sequence[SubMap]) -> float:
    """Of all together, with the digits that files have, so that those which were read say the same."""
    return sum(round(submap.area_m2, 9) for submap in submaps)


STAGE = Stage(
    name="segment",
    title="finding areas that change",
    section="segmentation",
    folder="submaps",
    reads=("scans/", "map/", "known/", EDITS),
    writes=("submaps/",),
    run=run,
    needs=needs,
)

CORRECT = replace(STAGE, title="correcting areas that change", run=correct, has_kernels=False)
"""The same stage where only corrections by hand changed since it was run: nothing is looked for again."""
