"""The states of all sub-maps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

from dynmap_cli.arrays import F64
from dynmap_cli.clustering.sequences import SequenceParams
from dynmap_cli.clustering.settings import ClusteringSettings
from dynmap_cli.clustering.states import StateParams, learn_states
from dynmap_cli.counting.em import FilterParams
from dynmap_cli.counting.evidence import EvidenceParams
from dynmap_cli.domain.patches import PatchSet, Visit
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.progress import Tick, no_tick


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
