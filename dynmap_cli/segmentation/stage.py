"""The door of the room."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dynmap_cli.arrays import F64
from dynmap_cli.counting.evidence import EvidenceParams
from dynmap_cli.counting.looks import time_windows
from dynmap_cli.domain.corrections import Addition
from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.errors import ConfigError
from dynmap_cli.files.counting_map import read_map_frame
from dynmap_cli.files.edits import NAME as EDITS
from dynmap_cli.files.edits import read_edits
from dynmap_cli.files.known import FOUND, read_known_submaps
from dynmap_cli.files.registered import read_registered
from dynmap_cli.files.submaps import write_submaps
from dynmap_cli.progress import Tick, no_tick, progress
from dynmap_cli.segmentation.contradictions import Contradictions, find_contradictions
from dynmap_cli.segmentation.corrections import apply_corrections
from dynmap_cli.segmentation.dependence import dependent_regions
from dynmap_cli.segmentation.groups import changed_as_one
from dynmap_cli.segmentation.numbering import keep_numbers
from dynmap_cli.segmentation.recurring import with_recurring
from dynmap_cli.segmentation.regions import RegionParams, grow_components, make_submaps, merge_regions
from dynmap_cli.segmentation.settings import SegmentationSettings
from dynmap_cli.stage import Stage, StageContext

_PLACES_PER_LINE = 5
_BYTES_PER_CELL = 2


def find_submaps(
    log: ScanLog,
    poses: F64,
    frame: GridFrame,
    settings: SegmentationSettings,
    on_window: Tick = no_tick,
    *,
    threads: int = 1,
) -> tuple[tuple[SubMap, ...], Contradictions]:
    """Find the areas that change (paper, 1.3.1): contradictions, growing, merging.

    Parameters
    ----------
    log : ScanLog
    poses : (n_scans, 3) float64
        map_from_robot.
    frame : GridFrame
    settings : SegmentationSettings
    on_window : Tick
    threads : int
    """
    evidence = evidence_params(settings)
    found = find_contradictions(log, poses, frame, settings.window_s, evidence, on_window, threads=threads)
    params = region_params(settings, frame.resolution_m)
    components = changed_as_one(found, grow_components(found.contested, params), params.min_cells)
    recurring = found.recurring(components)
    components += grow_components(recurring, params)
    dependent = None
    if settings.merge == "dependent":
        dependent = dependent_regions(found, components, params.min_cells)
    groups = merge_regions(components, found.standing, params, dependent)
    cells = [np.concatenate([components[k] for k in group]) for group in groups]
    return with_recurring(make_submaps(cells, frame, params.margin), recurring), found


def evidence_params(settings: SegmentationSettings) -> EvidenceParams:
    """What counts as evidence of a contradiction."""
    return EvidenceParams(
        max_range_m=settings.max_range_m,
        min_crossing_rad=math.radians(settings.min_crossing_deg),
        support_cells=settings.support_cells,
    )


def margin_cells(settings: SegmentationSettings, resolution_m: float) -> int:
    """Border of a rectangle around its contested cells."""
    return math.ceil(settings.margin_m / resolution_m - 1e-9)


def region_params(settings: SegmentationSettings, resolution_m: float) -> RegionParams:
    """Turn lengths into cells."""
    margin = margin_cells(settings, resolution_m)
    max_area = settings.max_area_m2 / resolution_m**2
    least = (2 * margin + 1) ** 2
    if least > max_area:
        msg = (
            f"segmentation.max_area_m2: {settings.max_area_m2:g} is less than one cell of {resolution_m:g} m with "
            f"its margin; at least {least * resolution_m**2:.3g} is needed, or a smaller segmentation.margin_m."
        )
        raise ConfigError(msg)
    return RegionParams(
        settings.growth_cells, settings.min_cells, margin, max_area, settings.max_range_m / resolution_m
    )


def needs(context: StageContext) -> tuple[str, int]:
    """Room for the masks, which overlap where sub-maps were corrected by hand."""
    n_cells = (context.run_dir / "map" / "map.pgm").stat().st_size
    return f"the masks of areas on a map of {n_cells} cells", _BYTES_PER_CELL * n_cells


def run(context: StageContext) -> dict[str, Any]:
    """Read, call, write."""
    settings = context.config.segmentation
    log, trajectory = read_registered(context.scans_dir, context.run_dir / "map")
    frame = read_map_frame(context.run_dir / "map" / "reflectance.npz")
    windows = len(time_windows(log, settings.window_s))
    with progress("segment", windows, "windows") as tick:
        submaps, found = find_submaps(log, trajectory.poses, frame, settings, tick, threads=context.threads)
    corrections = read_edits(context.run_dir)
    taken = [one.submap_id for one in corrections if isinstance(one, Addition)]
    submaps = keep_numbers(submaps, read_known_submaps(context.run_dir), taken)
    lines: list[str] = []
    if corrections:
        write_submaps(context.out_dir / FOUND, submaps)
        submaps, lines = apply_corrections(
            submaps, corrections, frame, margin_cells(settings, frame.resolution_m)
        )
    write_submaps(context.out_dir, submaps)
    area = sum(submap.area_m2 for submap in submaps)
    return {
        "submaps": len(submaps),
        "area_m2": round(area, 3),
        "contested_cells": int(found.contested.sum()),
        "windows": found.windows.count,
        "windows_needed": found.windows_needed,
        "lines": [*describe(submaps), *lines],
    }


def describe(submaps: tuple[SubMap, ...]) -> list[str]:
    """Say what was found, for people."""
    if not submaps:
        return ["no sub-map: no area was seen in two states well enough"]
    area = sum(submap.area_m2 for submap in submaps)
    places = [
        f"{submap.called} at {submap.place} {submap.size_m[0]:.1f} x {submap.size_m[1]:.1f} m"
        for submap in submaps
    ]
    head = f"{len(submaps)} sub-map{'s' * (len(submaps) != 1)}, {area:.1f} m2: "
    rows = [", ".join(places[k : k + _PLACES_PER_LINE]) for k in range(0, len(places), _PLACES_PER_LINE)]
    return [head + rows[0], *rows[1:]]


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
