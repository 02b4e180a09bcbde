"""The door of the room."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from dynmap_cli.arrays import F64
from dynmap_cli.clustering.corrections import apply_corrections
from dynmap_cli.clustering.numbering import keep_numbers
from dynmap_cli.clustering.sequences import SequenceParams
from dynmap_cli.clustering.settings import ClusteringSettings
from dynmap_cli.clustering.states import StateParams, describe, learn_states
from dynmap_cli.counting.em import FilterParams
from dynmap_cli.counting.evidence import EvidenceParams
from dynmap_cli.domain.corrections import Merge
from dynmap_cli.domain.patches import PatchSet, Visit
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.files.edits import NAME as EDITS
from dynmap_cli.files.edits import read_edits
from dynmap_cli.files.known import FOUND_PATCHES, read_known_patches
from dynmap_cli.files.patch_archive import write_patches
from dynmap_cli.files.registered import read_registered
from dynmap_cli.files.submaps import read_submaps
from dynmap_cli.progress import Tick, no_tick, progress
from dynmap_cli.stage import Stage, StageContext

_BYTES_PER_CELL, _LEAST_BYTES = 10, 100_000


def learn_patch_map(
    log: ScanLog,
    poses: F64,
    submaps: Sequence[SubMap],
    settings: ClusteringSettings,
    *,
    threads: int = 1,
    on_submap: Tick = no_tick,
) -> tuple[tuple[PatchSet, ...], tuple[Visit, ...]]:
    """Learn the states of all sub-maps; the same for any number of threads.

    Parameters
    ----------
    log : ScanLog
    poses : (n_scans, 3) float64
        map_from_robot.
    submaps : sequence of SubMap
    settings : ClusteringSettings
    threads : int
    on_submap : Tick

    Returns
    -------
    tuple of PatchSet
        Of the sub-maps whose states were seen.
    tuple of Visit
        Of all sub-maps.
    """
    params = StateParams(
        SequenceParams(settings.near_m, settings.sequence_s, settings.gap_s, settings.min_scans),
        EvidenceParams(
            max_range_m=settings.max_range_m, min_crossing_rad=math.radians(settings.min_crossing_deg)
        ),
        FilterParams(static_prior=settings.static_prior, usable_range_m=settings.max_range_m),
        settings.min_known_share,
        settings.max_states,
        settings.min_cells,
    )
    patch_sets: list[PatchSet] = []
    visits: list[Visit] = []
    with ThreadPoolExecutor(max_workers=max(1, threads)) as pool:
        for patch_set, seen in pool.map(lambda submap: learn_states(log, poses, submap, params), submaps):
            patch_sets += [patch_set] if patch_set else []
            visits += seen
            on_submap()
    return tuple(patch_sets), tuple(visits)


def needs(context: StageContext) -> tuple[str, int]:
    """Room for an image and a table of each state, in patches.zip and in that of before corrections."""
    submaps, most = read_submaps(context.run_dir / "submaps"), context.config.clustering.max_states
    n_cells = sum(submap.owned.size for submap in submaps)
    return f"up to {most} states of {len(submaps)} sub-maps", _LEAST_BYTES + _BYTES_PER_CELL * n_cells * most


def run(context: StageContext) -> dict[str, Any]:
    """Read, call, write."""
    log, trajectory = read_registered(context.scans_dir, context.run_dir / "map")
    submaps = read_submaps(context.run_dir / "submaps")
    with progress("cluster", len(submaps), "sub-maps") as tick:
        patch_sets, visits = learn_patch_map(
            log,
            trajectory.poses,
            submaps,
            context.config.clustering,
            threads=context.threads,
            on_submap=tick,
        )
    patch_sets, visits = keep_numbers(patch_sets, visits, read_known_patches(context.run_dir))
    corrections = read_edits(context.run_dir)
    lines: list[str] = []
    if any(isinstance(one, Merge) for one in corrections):
        write_patches(context.out_dir / FOUND_PATCHES, submaps, patch_sets, visits)
        patch_sets, visits, lines = apply_corrections(patch_sets, visits, submaps, corrections)
    write_patches(context.out_dir / "patches.zip", submaps, patch_sets, visits)
    return {
        "submaps": len(submaps),
        "submaps_with_states": len(patch_sets),
        "patches": sum(len(patch_set.patches) for patch_set in patch_sets),
        "objects": sum(len(patch_set.objects) for patch_set in patch_sets),
        "visits": len(visits),
        "visits_assigned": sum(visit.patch is not None for visit in visits),
        "lines": [
            *(describe(patch_sets, visits) or ["no states to learn: there is no sub-map"]),
            *lines,
        ],
    }


STAGE = Stage(
    name="cluster",
    title="learning the states of each area",
    section="clustering",
    folder="patches",
    reads=("scans/", "map/", "submaps/", "known/", EDITS),
    writes=("patches/patches.zip",),
    run=run,
    needs=needs,
)
