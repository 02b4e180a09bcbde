"""Corrections by hand of the states that were learned."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dynmap_cli.arrays import F32
from dynmap_cli.clustering.hours import with_shares_by_hour
from dynmap_cli.domain.corrections import Correction, Merge, describe, find_place
from dynmap_cli.domain.patches import Patch, PatchSet, Visit, cells_that_vary
from dynmap_cli.domain.staying import stay_probability
from dynmap_cli.domain.submaps import SubMap


def apply_corrections(
    patch_sets: Sequence[PatchSet],
    visits: Sequence[Visit],
    submaps: Sequence[SubMap],
    corrections: Sequence[Correction],
) -> tuple[tuple[PatchSet, ...], tuple[Visit, ...], list[str]]:
    """Merge states, in the order in which it was said.

    Parameters
    ----------
    patch_sets, visits
        As learned, with their numbers.
    submaps : sequence of SubMap
    corrections : sequence of Correction
        Those of sub-maps are passed over.

    Returns
    -------
    tuple of PatchSet
    tuple of Visit
    list of str
        What was done, and warnings about what could not be done.
    """
    by_id = {patch_set.submap_id: patch_set for patch_set in patch_sets}
    seen, lines = tuple(visits), []
    for number, correction in enumerate(corrections, start=1):
        if not isinstance(correction, Merge):
            continue
        words = f"correction {number}: {describe(correction)}"
        submap = find_place(correction.place, submaps)
        patch_set = by_id.get(submap.submap_id) if submap else None
        there = {patch.patch_id for patch in patch_set.patches} if patch_set else set()
        missing = sorted(set(correction.states) - there)
        if patch_set is not None and len(there & set(correction.states)) > 1:
            by_id[patch_set.submap_id], seen = merge_states(patch_set, seen, correction.states)
        if missing:
            words = f"warning: {words}, but of these there is no {', '.join(map(str, missing))} any more"
        lines.append(words)
    return tuple(by_id.values()), seen, lines


def merge_states(
    patch_set: PatchSet, visits: Sequence[Visit], states: Sequence[int]
) -> tuple[PatchSet, tuple[Visit, ...]]:
    """Make one state of several: it has their visits, the lowest number and the mean map weighted by support.

    Parameters
    ----------
    patch_set : PatchSet
    visits : sequence of Visit
        Of this and other sub-maps. A membership stays that of the state the visit was assigned to.
    states : sequence of int
        Those that the sub-map does not have are passed over; two at least it has.
    """
    merged = [patch for patch in patch_set.patches if patch.patch_id in states]
    number = min(patch.patch_id for patch in merged)
    one = Patch(number, sum(patch.support for patch in merged), _mean_map(merged))
    others = [patch for patch in patch_set.patches if patch.patch_id not in states]
    patches = tuple(sorted([one, *others], key=lambda patch: patch.patch_id))
    seen = tuple(
        replace(visit, patch=number)
        if visit.submap_id == patch_set.submap_id and visit.patch in states
        else visit
        for visit in visits
    )
    own = [visit for visit in seen if visit.submap_id == patch_set.submap_id]
    patches = with_shares_by_hour(patches, own)
    stay = stay_probability(own, len(patches))
    varying = cells_that_vary(patches)
    return replace(patch_set, patches=patches, varying=varying, stay_probability=stay), seen


def _mean_map(patches: Sequence[Patch]) -> F32:
    """Mean reflectance weighted by support; NaN where no patch knows the cell."""
    values = np.stack([patch.reflectance for patch in patches]).astype(np.float64)
    support = np.array([patch.support for patch in patches], dtype=np.float64)
    weights = support[:, None, None] * ~np.isnan(values)
    total = weights.sum(axis=0)
    mean = np.full(total.shape, np.nan)
    np.divide((weights * np.nan_to_num(values)).sum(axis=0), total, out=mean, where=total > 0)
    return mean.astype(np.float32)
