"""A belief per object: sub-maps taken apart into the objects that change in them.

A sub-map with n objects takes up to 2^n states, of which a few were mapped. The objects are n pairs of states, each
cell of the sub-map belongs to the nearest of them, and what was never seen together can still be believed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from dynmap_cli.arrays import B1, F32, F64, I64
from dynmap_cli.domain.patches import FREE_REFLECTANCE, OFF, ON, ChangingObject, Patch, PatchSet, Visit
from dynmap_cli.domain.staying import stay_probability
from dynmap_cli.localization.map_pool import SOLID_REFLECTANCE


@dataclass(frozen=True, slots=True)
class Part:
    """What has a belief of its own.

    Attributes
    ----------
    states : PatchSet
        What it looks like: the sub-map itself, or the cells nearest to an object with patch 0 = off and 1 = on.
    thing : ChangingObject or None
        The object, None = a whole sub-map.
    """

    states: PatchSet
    thing: ChangingObject | None = None


def whole_parts(patch_sets: Sequence[PatchSet]) -> tuple[Part, ...]:
    """One belief for each sub-map that has a patch."""
    return tuple(Part(patch_set) for patch_set in patch_sets if patch_set.patches)


def object_parts(patch_sets: Sequence[PatchSet], visits: Sequence[Visit]) -> tuple[Part, ...]:
    """One belief for each object, and for each sub-map in which no object is known.

    Parameters
    ----------
    patch_sets : sequence of PatchSet
    visits : sequence of Visit
        Of all sub-maps; their times say how long the objects keep their states.
    """
    parts: list[Part] = []
    for whole in whole_parts(patch_sets):
        own = {visit.sequence: visit for visit in visits if visit.submap_id == whole.states.submap_id}
        split = _split(whole.states, own)
        parts += split if split else [whole]
    return tuple(parts)


def on_shares(thing: ChangingObject, patches: Sequence[Patch]) -> F64:
    """Share of an object's known cells that is solid in each patch (n_patches,); NaN = it knows none of them."""
    values = np.stack([patch.reflectance[thing.cells] for patch in patches]).astype(np.float64)
    known = np.isfinite(values)
    solid = (np.where(known, values, 0.0) >= SOLID_REFLECTANCE).sum(axis=1)
    return np.where(known.any(axis=1), solid / np.maximum(known.sum(axis=1), 1), np.nan)


def on_probabilities(thing: ChangingObject, patches: Sequence[Patch]) -> F64:
    """Probability that an object is on in each patch (n_patches,): 1 or 0, and 0.5 where a patch knows none of it."""
    share = on_shares(thing, patches)
    return np.asarray(np.where(np.isnan(share), 0.5, share >= 0.5))


def _split(patch_set: PatchSet, visits: dict[int, Visit]) -> list[Part]:
    """The objects of one sub-map that own a cell some patch knows."""
    known = np.isfinite([patch.reflectance for patch in patch_set.patches]).any(axis=0)
    nearest = nearest_object(patch_set)
    parts = []
    for number, thing in enumerate(patch_set.objects):
        region = known & (nearest == number)
        if region.any():
            parts.append(Part(_two_states(patch_set, thing, region, visits), thing))
    return parts


def nearest_object(patch_set: PatchSet) -> I64:
    """Index of the object that is nearest to each cell (rows, cols); -1 where there are none."""
    index = np.full(patch_set.frame.shape, -1, dtype=np.int64)
    for number, thing in enumerate(patch_set.objects):
        index[thing.cells] = number
    if not patch_set.objects:
        return index
    rows, cols = ndimage.distance_transform_edt(index < 0, return_distances=False, return_indices=True)
    return np.asarray(index[rows, cols])


def _two_states(patch_set: PatchSet, thing: ChangingObject, region: B1, visits: dict[int, Visit]) -> PatchSet:
    """Off and on as the states of the cells (rows, cols) nearest to an object."""
    rows, cols = (np.flatnonzero(region.any(axis=axis)) for axis in (1, 0))
    row, col = int(rows[0]), int(cols[0])
    frame = patch_set.frame.window(row, col, int(rows[-1]) - row + 1, int(cols[-1]) - col + 1)
    window = (slice(row, row + frame.rows), slice(col, col + frame.cols))
    off, on = (np.where(region, values, np.nan)[window] for values in _reflectances(patch_set, thing))
    seen = [
        replace(visits[number], patch=int(state == ON))
        for number, state in thing.states.items()
        if state in (OFF, ON) and number in visits
    ]
    return PatchSet(
        patch_set.submap_id,
        frame,
        thing.cells[window],
        tuple(
            Patch(number, thing.count(state), values.astype(np.float32), hours)
            for number, (state, values, hours) in enumerate(
                zip((OFF, ON), (off, on), _shares_by_hour(patch_set, thing), strict=True)
            )
        ),
        stay_probability(seen, 2),
    )


def _reflectances(patch_set: PatchSet, thing: ChangingObject) -> tuple[F32, F32]:
    """What the sub-map looks like (rows, cols) with an object off, and on; elsewhere as in the mean of the patches.

    The cells of an object have the mean of the patches with it in that state; they are solid where it is on and free
    where it is off also if no patch shows that.
    """
    values = np.stack([patch.reflectance for patch in patch_set.patches]).astype(np.float64)
    support = np.array([max(patch.support, 1) for patch in patch_set.patches], dtype=np.float64)
    share = on_shares(thing, patch_set.patches)
    mean = _mean(values, support)
    off, on = mean.copy(), mean.copy()
    cells = thing.cells
    off[cells] = np.fmin(_mean(values[share < 0.5], support[share < 0.5])[cells], FREE_REFLECTANCE)
    on[cells] = np.fmax(_mean(values[share >= 0.5], support[share >= 0.5])[cells], SOLID_REFLECTANCE)
    return off.astype(np.float32), on.astype(np.float32)


def _mean(values: F64, weights: F64) -> F64:
    """Weighted mean over the first axis of what is known; NaN where nothing is."""
    known = np.isfinite(values)
    total = np.tensordot(weights, known, axes=1)
    sums = np.tensordot(weights, np.where(known, values, 0.0), axes=1)
    return np.asarray(np.where(total > 0.0, sums / np.maximum(total, 1e-9), np.nan))


def _shares_by_hour(
    patch_set: PatchSet, thing: ChangingObject
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Probability of off and of on by hour of the day, from that of the patches; empty where that is not known."""
    if not all(patch.share_by_hour for patch in patch_set.patches):
        return (), ()
    shares = on_probabilities(thing, patch_set.patches) @ np.array(
        [patch.share_by_hour for patch in patch_set.patches]
    )
    return tuple((1.0 - shares).tolist()), tuple(shares.tolist())
