"""The areas that change: contradictions, growing, merging."""

from __future__ import annotations

import math

import numpy as np

from dynmap_cli.arrays import F64
from dynmap_cli.counting.evidence import EvidenceParams
from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.errors import ConfigError
from dynmap_cli.progress import Tick, no_tick
from dynmap_cli.segmentation.contradictions import Contradictions, find_contradictions
from dynmap_cli.segmentation.dependence import dependent_regions
from dynmap_cli.segmentation.groups import changed_as_one
from dynmap_cli.segmentation.recurring import with_recurring
from dynmap_cli.segmentation.regions import RegionParams, grow_components, make_submaps, merge_regions
from dynmap_cli.segmentation.settings import SegmentationSettings, margin_cells


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

    Cells that windows contradict (contested) are put together to components, of which those stay that changed as one.
    What comes back to the same spot without its cells contradicting one another (recurring) makes components, too.
    Components near one another merge; each group becomes a sub-map, the rectangle around it with a margin.

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
