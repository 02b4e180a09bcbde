"""What has a belief of its own: the parts of sub-maps that change independently of one another.

A sub-map with n objects takes up to 2^n states, of which a few were mapped. Its objects stay together in one part
unless the visits show that they are free of one another: most sub-maps were visited a few times, and then one cupboard
in two places looks like two boxes. So a part can also take states that were never mapped; that they were not mapped
counts against them, see `prior_by_hour`, but what beams show decides.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage
from scipy.sparse.csgraph import connected_components

from dynmap_cli.arrays import F64, I64
from dynmap_cli.domain.dependence import are_free
from dynmap_cli.domain.patches import Patch, PatchSet, Visit
from dynmap_cli.domain.staying import stay_probability
from dynmap_cli.localization.beliefs.combinations import (
    composed,
    is_compatible,
    on_in_patches,
    on_in_visits,
    possible_combinations,
)


@dataclass(frozen=True, slots=True)
class Part:
    """What has a belief of its own.

    Attributes
    ----------
    states : PatchSet
        What it looks like: the sub-map itself, or some of its objects with the cells nearest to them. States without
        support were never seen.
    shown : (n_states, n_patches) float64
        Whether each patch of the whole sub-map can be what is there if the part is in this state. In a sub-map of one
        part the rows add up to 1, or to 0 for a state that was never mapped.
    """

    states: PatchSet
    shown: F64

    @property
    def on_probabilities(self) -> F64:
        """Whether each object is on in each state (n_states, n_objects): 1 or 0; 0.5 where a state does not know."""
        is_on = on_in_patches(self.states)
        return np.where(np.isnan(is_on), 0.5, is_on)


def whole_parts(patch_sets: Sequence[PatchSet]) -> tuple[Part, ...]:
    """One belief for each sub-map that has a patch, in the states that were mapped."""
    return tuple(
        Part(patch_set, np.eye(len(patch_set.patches))) for patch_set in patch_sets if patch_set.patches
    )


def believed_parts(patch_sets: Sequence[PatchSet], visits: Sequence[Visit], states: str) -> tuple[Part, ...]:
    """What has a belief of its own under the setting `states`; particles have whole patches, as in the paper."""
    return whole_parts(patch_sets) if states == "sampled" else independent_parts(patch_sets, visits)


def independent_parts(patch_sets: Sequence[PatchSet], visits: Sequence[Visit]) -> tuple[Part, ...]:
    """One belief for what depends on one another in each sub-map, also in states that were never mapped.

    Parameters
    ----------
    patch_sets : sequence of PatchSet
    visits : sequence of Visit
        Of all sub-maps; their times say how long the parts keep their states.
    """
    parts: list[Part] = []
    for whole in whole_parts(patch_sets):
        patch_set = whole.states
        own = [visit for visit in visits if visit.submap_id == patch_set.submap_id]
        groups = _groups(patch_set, own)
        if len(groups) < 2:
            parts.append(_with_states_never_mapped(whole, own))
        else:
            parts += _split(patch_set, groups, own)
    return tuple(parts)


def nearest_object(patch_set: PatchSet) -> I64:
    """Index of the object that is nearest to each cell (rows, cols); -1 where there are none."""
    index = np.full(patch_set.frame.shape, -1, dtype=np.int64)
    for number, thing in enumerate(patch_set.objects):
        index[thing.cells] = number
    if not patch_set.objects:
        return index
    rows, cols = ndimage.distance_transform_edt(index < 0, return_distances=False, return_indices=True)
    return np.asarray(index[rows, cols])


def _groups(patch_set: PatchSet, visits: Sequence[Visit]) -> list[I64]:
    """Indices of the objects that may depend on one another, directly or by others between them."""
    seen = on_in_visits(patch_set.objects, visits)
    free = are_free((seen == 1.0).astype(np.int64), (seen == 0.0).astype(np.int64))
    count, label = connected_components(~free, directed=False)
    return [np.flatnonzero(label == number) for number in range(count)]


def _with_states_never_mapped(whole: Part, visits: Sequence[Visit]) -> Part:
    """A sub-map with the patches it has, and the combinations of its objects that none of them shows."""
    patch_set = whole.states
    in_patches, in_visits = on_in_patches(patch_set), on_in_visits(patch_set.objects, visits)
    combinations = possible_combinations(np.vstack([in_patches, in_visits]))
    exactly = (combinations[:, None] == in_patches[None]).all(axis=2)
    never = combinations[~exactly.any(axis=1)]
    if not never.size:
        return whole
    patch_index = {patch.patch_id: number for number, patch in enumerate(patch_set.patches)}
    n_patches = len(patch_index)
    of_visit = {
        visit.sequence: patch_index[visit.patch] if visit.patch in patch_index else n_patches + number
        for visit, number in zip(visits, _state_of(in_visits, never), strict=True)
        if visit.patch in patch_index or number >= 0
    }
    nearest = nearest_object(patch_set)
    everything = np.arange(len(patch_set.objects))
    next_id = max(patch_index) + 1
    states = tuple(
        Patch(
            next_id + number,
            _count(of_visit, n_patches + number),
            composed(patch_set, nearest, everything, on),
        )
        for number, on in enumerate(never)
    )
    fits = is_compatible(never, in_patches).astype(np.float64)
    return Part(
        _lasting(replace(patch_set, patches=patch_set.patches + states), of_visit, visits),
        np.vstack([whole.shown, fits / np.maximum(fits.sum(axis=1, keepdims=True), 1.0)]),
    )


def _split(patch_set: PatchSet, groups: Sequence[I64], visits: Sequence[Visit]) -> list[Part]:
    """The groups of objects of one sub-map that own a cell some patch knows."""
    known = np.isfinite([patch.reflectance for patch in patch_set.patches]).any(axis=0)
    nearest = nearest_object(patch_set)
    regions = [known & np.isin(nearest, group) for group in groups]
    return [
        _part_of(patch_set, np.where(region, nearest, -1), group, visits)
        for group, region in zip(groups, regions, strict=True)
        if region.any()
    ]


def _part_of(patch_set: PatchSet, nearest: I64, group: I64, visits: Sequence[Visit]) -> Part:
    """Some objects with the cells nearest to them, by the index (rows, cols) of the nearest of them; -1 = none."""
    rows, cols = (np.flatnonzero((nearest >= 0).any(axis=axis)) for axis in (1, 0))
    row, col = int(rows[0]), int(cols[0])
    frame = patch_set.frame.window(row, col, int(rows[-1]) - row + 1, int(cols[-1]) - col + 1)
    window = (slice(row, row + frame.rows), slice(col, col + frame.cols))
    objects = tuple(patch_set.objects[number] for number in group.tolist())
    in_patches, in_visits = on_in_patches(patch_set)[:, group], on_in_visits(objects, visits)
    combinations = possible_combinations(np.vstack([in_patches, in_visits]))
    of_visit = {
        visit.sequence: number
        for visit, number in zip(visits, _state_of(in_visits, combinations), strict=True)
        if number >= 0
    }
    fits = is_compatible(combinations, in_patches).astype(np.float64)
    states = PatchSet(
        patch_set.submap_id,
        frame,
        np.logical_or.reduce([thing.cells for thing in objects])[window],
        tuple(
            Patch(
                number,
                _count(of_visit, number),
                composed(patch_set, nearest, group, on)[window],
                _share_by_hour(patch_set, fits[number]),
            )
            for number, on in enumerate(combinations)
        ),
        1.0,
        objects=tuple(replace(thing, cells=thing.cells[window]) for thing in objects),
    )
    return Part(_lasting(states, of_visit, visits), fits)


def _lasting(states: PatchSet, of_visit: Mapping[int, int], visits: Sequence[Visit]) -> PatchSet:
    """How long these states last, by the state of each visit."""
    seen = [replace(v, patch=of_visit[v.sequence]) for v in visits if v.sequence in of_visit]
    return replace(states, stay_probability=stay_probability(seen, len(states.patches)))


def _state_of(in_visits: F64, combinations: F64) -> list[int]:
    """Which combination each visit saw; -1 = none of them, or it did not see all objects."""
    same = (in_visits[:, None] == combinations[None]).all(axis=2)
    return np.where(same.any(axis=1), same.argmax(axis=1), -1).tolist() if same.size else [-1] * len(same)


def _count(of_visit: Mapping[int, int], number: int) -> int:
    """How many visits saw a state."""
    return sum(seen == number for seen in of_visit.values())


def _share_by_hour(patch_set: PatchSet, fits: F64) -> tuple[float, ...]:
    """Probability by hour of the day of what the patches (n_patches,) fit; empty where theirs is not known."""
    if not all(patch.share_by_hour for patch in patch_set.patches):
        return ()
    shares = fits @ np.array([patch.share_by_hour for patch in patch_set.patches])
    return tuple(np.minimum(shares, 1.0).tolist())
