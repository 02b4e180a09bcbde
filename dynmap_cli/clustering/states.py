"""The states of one sub-map: from its observation sequences to patches and visits (paper, 1.3.2)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynmap_cli.arrays import B1, F32, F64, I64
from dynmap_cli.clustering.hours import with_shares_by_hour
from dynmap_cli.clustering.local_maps import (
    LocalMaps,
    Vectors,
    align,
    build_local_maps,
    varying_vectors,
)
from dynmap_cli.clustering.model_selection import assign, choose_clusters, fitting_states
from dynmap_cli.clustering.objects import find_objects
from dynmap_cli.clustering.sequences import SequenceParams, cut_sequences
from dynmap_cli.clustering.shifted_states import lay_over_same_state
from dynmap_cli.clustering.spots import join_spots
from dynmap_cli.counting.em import FilterParams
from dynmap_cli.counting.evidence import EvidenceParams
from dynmap_cli.domain.patches import Patch, PatchSet, Visit, cells_that_vary
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.domain.staying import stay_probability
from dynmap_cli.domain.submaps import SubMap

_FARTHER = (2.0, 4.0)
_SHIFT_ROUNDS = 2
TOO_LITTLE, MIXED, NO_STATE = "saw too little", "saw the change", "fits no state"


@dataclass(frozen=True, slots=True)
class StateParams:
    """How states are learned.

    Attributes
    ----------
    sequences : SequenceParams
    evidence : EvidenceParams
    filtering : FilterParams
    min_known_share : float
        A visit that knows less of the varying cells founds no state.
    max_states : int
    min_cells : int
        A change of fewer cells is no change.
    """

    sequences: SequenceParams
    evidence: EvidenceParams
    filtering: FilterParams
    min_known_share: float
    max_states: int
    min_cells: int


@dataclass(frozen=True, slots=True)
class Labels:
    """Which state each visit saw.

    Attributes
    ----------
    patch : (n,) int64
        -1 = none.
    membership : (n,) float64
    remarks : tuple of str
        Why there is none.
    bic : tuple of float
        BIC of the models with 1, 2, ... clusters that were tried.
    rounds : tuple of (k, n_cells) float64
        Means of the clusters of each of these models.
    """

    patch: I64
    membership: F64
    remarks: tuple[str, ...]
    bic: tuple[float, ...] = ()
    rounds: tuple[F64, ...] = ()


def learn_states(
    log: ScanLog, poses: F64, submap: SubMap, params: StateParams
) -> tuple[PatchSet | None, tuple[Visit, ...]]:
    """Learn the patches of a sub-map.

    Where the visits all show one state, the change was seen from farther away: visits then reach twice, and four times
    as far, and those are kept that show more than one.

    Parameters
    ----------
    log : ScanLog
    poses : (n_scans, 3) float64
        map_from_robot.
    submap : SubMap
    params : StateParams

    Returns
    -------
    PatchSet or None
        None where no visit saw enough.
    tuple of Visit
        One per observation sequence, in time order.
    """
    nearest = _learn_from(log, poses, submap, params, params.sequences)
    if _shows_change(nearest[0]):
        return nearest
    for factor in _FARTHER:
        cuts = replace(params.sequences, near_m=factor * params.sequences.near_m)
        found = _learn_from(log, poses, submap, params, cuts)
        if _shows_change(found[0]):
            return found
    return nearest


def _shows_change(patch_set: PatchSet | None) -> bool:
    """Whether there is more than one state."""
    return patch_set is not None and len(patch_set.patches) > 1


def _learn_from(
    log: ScanLog, poses: F64, submap: SubMap, params: StateParams, cuts: SequenceParams
) -> tuple[PatchSet | None, tuple[Visit, ...]]:
    """Learn the patches of a sub-map from the visits (observation sequences) that are cut in one way.

    Each visit draws a map of its own; the maps are laid over one another and clustered, and a patch is the mean of the
    maps of one cluster.
    """
    sequences = cut_sequences(log, poses, submap.frame, cuts)
    maps = align(
        build_local_maps(
            log, poses, submap.frame, sequences, params.evidence, params.filtering, params.min_cells
        )
    )
    maps = join_spots(maps, submap.recurring)
    maps, vectors, labels = recognise_states(maps, submap.owned, submap.contested, params)
    visits = tuple(
        _visit(log, submap.submap_id, number, scans, labels) for number, scans in enumerate(sequences)
    )
    if not (labels.patch >= 0).any():
        return None, visits
    patches = tuple(
        Patch(k, int((labels.patch == k).sum()), _mean_map(maps, labels, k, submap.owned))
        for k in range(int(labels.patch.max()) + 1)
    )
    patches = with_shares_by_hour(patches, visits)
    stay = stay_probability(visits, len(patches))
    varying = cells_that_vary(patches)
    rounds = tuple(_on_cells(means, vectors.cells) for means in labels.rounds)
    objects = find_objects(vectors, maps.is_mixed, params.min_cells)
    return PatchSet(
        submap.submap_id, submap.frame, varying, patches, stay, labels.bic, rounds, objects
    ), visits


def recognise_states(
    maps: LocalMaps, owned: B1, contested: B1, params: StateParams
) -> tuple[LocalMaps, Vectors, Labels]:
    """Cluster the maps, and once more where maps of one state turned out to lie beside one another.

    Parameters
    ----------
    maps : LocalMaps
        Laid over one another.
    owned, contested : (rows, cols) bool
        Of the sub-map.
    params : StateParams

    Returns
    -------
    LocalMaps
        As they lie in the end.
    Vectors
    Labels
    """
    vectors = varying_vectors(maps, owned, contested, params.min_cells)
    labels = label_visits(vectors, maps.is_mixed, params)
    for _ in range(_SHIFT_ROUNDS):
        moved = lay_over_same_state(maps, labels.patch, params.min_cells)
        if moved is None:
            break
        maps = moved
        vectors = varying_vectors(maps, owned, contested, params.min_cells)
        labels = label_visits(vectors, maps.is_mixed, params)
    return maps, vectors, labels


def _on_cells(means: F64, cells: B1) -> F32:
    """Means of clusters (k, n_cells) on the grid of the sub-map, (k, rows, cols); NaN elsewhere."""
    grids = np.full((means.shape[0], *cells.shape), np.nan, dtype=np.float32)
    grids[:, cells] = np.clip(means, 0.0, 1.0)
    return grids


def label_visits(vectors: Vectors, is_mixed: B1, params: StateParams) -> Labels:
    """Cluster the visits that know enough, then assign the others where they leave no doubt.

    A visit that fits several states did not see where they differ; it stays open.
    """
    count, n_cells = vectors.values.shape
    known_share = (~np.isnan(vectors.values)).sum(axis=1) / max(n_cells, 1)
    patch, membership = np.full(count, -1, dtype=np.int64), np.full(count, np.nan)
    remarks = np.where(is_mixed, MIXED, "").astype(object)
    if n_cells == 0:
        patch[~is_mixed], membership[~is_mixed] = 0, 1.0
        return Labels(patch, membership, tuple(remarks))
    founds = ~is_mixed & (known_share >= params.min_known_share)
    remarks[~is_mixed & ~founds] = TOO_LITTLE
    if not founds.any():
        return Labels(patch, membership, tuple(remarks))
    founders = replace(vectors, values=vectors.values[founds])
    model = choose_clusters(founders, params.max_states, params.min_cells)
    clusters = model.clusters
    late = np.flatnonzero(remarks == TOO_LITTLE)
    unsure = replace(vectors, values=vectors.values[late])
    for visit, k, share in zip(late, *assign(unsure, clusters, params.min_cells), strict=True):
        if k >= 0:
            patch[visit], membership[visit], remarks[visit] = k, share, ""
    for visit, share in zip(np.flatnonzero(founds), clusters.memberships, strict=True):
        fitting = fitting_states(vectors.values[visit], vectors, clusters, params.min_cells)
        if fitting.size == 1:
            patch[visit], membership[visit] = fitting[0], share[fitting[0]]
        else:
            remarks[visit] = TOO_LITTLE if fitting.size else NO_STATE
    return Labels(_renumbered(patch), membership, tuple(remarks), model.bic, model.rounds)


def _renumbered(patch: I64) -> I64:
    """Number states by their visits, the most frequent first, then the one seen first; -1 stays."""
    used, first, count = np.unique(patch[patch >= 0], return_index=True, return_counts=True)
    rank = np.argsort(np.lexsort((first, -count)))
    number = np.full(patch.shape, -1, dtype=np.int64)
    number[patch >= 0] = rank[np.searchsorted(used, patch[patch >= 0])]
    return number


def _mean_map(maps: LocalMaps, labels: Labels, k: int, owned: B1) -> F32:
    """Mean reflectance of the visits that saw state *k*, weighted with their memberships; NaN where unknown."""
    members = labels.patch == k
    values = maps.reflectance[members].astype(np.float64)
    weights = labels.membership[members][:, None, None] * ~np.isnan(values)
    total = weights.sum(axis=0)
    mean = np.full(total.shape, np.nan)
    np.divide((weights * np.nan_to_num(values)).sum(axis=0), total, out=mean, where=(total > 0) & owned)
    return np.clip(mean, 0.0, 1.0).astype(np.float32)


def _visit(log: ScanLog, submap_id: int, number: int, scans: I64, labels: Labels) -> Visit:
    """One row of the table of visits."""
    has_patch = labels.patch[number] >= 0
    return Visit(
        submap_id=submap_id,
        sequence=number,
        recording=log.recordings[int(log.recording_index[scans[0]])],
        start_ns=int(log.stamps_ns[scans[0]]),
        end_ns=int(log.stamps_ns[scans[-1]]),
        patch=int(labels.patch[number]) if has_patch else None,
        membership=float(labels.membership[number]) if has_patch else math.nan,
        remark=labels.remarks[number],
    )


def describe(
    patch_sets: Sequence[PatchSet], visits: Sequence[Visit], found: Sequence[PatchSet] = ()
) -> list[str]:
    """Say what there is, a sentence per sub-map; *found* is what was learned, before states were merged by hand."""
    learned = {patch_set.submap_id: len(patch_set.patches) for patch_set in found}
    by_id = {patch_set.submap_id: patch_set for patch_set in patch_sets}
    lines = []
    for number in sorted({visit.submap_id for visit in visits} | set(by_id)):
        own = [visit for visit in visits if visit.submap_id == number]
        patches = by_id[number].patches if number in by_id else ()
        supports = ", ".join(str(patch.support) for patch in patches)
        open_ones = [visit.remark for visit in own if visit.patch is None]
        counts = [
            f"{open_ones.count(why)} {why}" for why in (TOO_LITTLE, MIXED, NO_STATE) if why in open_ones
        ]
        head = f"{len(patches)} state{'s' * (len(patches) != 1)} in {len(own)} visit{'s' * (len(own) != 1)}"
        before = learned.get(number, len(patches))
        remark = []
        if before > len(patches):
            remark = [f"merged by hand from {before}"]
        elif len(patches) == 1 and len(own) > 1:
            remark = ["none of which saw what changed"]
        lines.append(
            f"sub-map {number}: "
            + ", ".join([head + (f" ({supports})" if supports else ""), *remark, *counts])
        )
    return lines
