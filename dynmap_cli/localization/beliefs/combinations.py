"""Combinations of the states of objects: which there can be, and what they look like."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynmap_cli.arrays import B1, F32, F64, I64
from dynmap_cli.domain.patches import FREE_REFLECTANCE, OFF, ON, ChangingObject, PatchSet, Visit

SOLID_REFLECTANCE = 0.25
"""Cells of a patch that reflect at least this share of the beams are solid: a thin wall whose visits lie
half a cell apart shares its hits between two cells."""
MAX_COMBINATIONS = 32
"""As many are tried for what depends on one another; of five objects all."""


def on_in_patches(patch_set: PatchSet) -> F64:
    """Whether each object is on in each patch (n_patches, n_objects): 1, 0, or NaN where it knows none of its cells.

    On is an object of whose known cells half are solid.
    """
    found = np.full((len(patch_set.patches), len(patch_set.objects)), np.nan)
    for number, thing in enumerate(patch_set.objects):
        values = np.stack([patch.reflectance[thing.cells] for patch in patch_set.patches]).astype(np.float64)
        known = np.isfinite(values)
        solid = (np.where(known, values, 0.0) >= SOLID_REFLECTANCE).sum(axis=1)
        found[:, number] = np.where(known.any(axis=1), 2 * solid >= known.sum(axis=1), np.nan)
    return found


def on_in_visits(objects: Sequence[ChangingObject], visits: Sequence[Visit]) -> F64:
    """Whether each object was on in each visit (n_visits, n_objects): 1, 0, or NaN = unknown."""
    value = {ON: 1.0, OFF: 0.0}
    rows = [
        [value.get(thing.states.get(visit.sequence, ""), np.nan) for thing in objects] for visit in visits
    ]
    return np.array(rows, dtype=np.float64).reshape(len(visits), len(objects))


def is_compatible(combinations: F64, others: F64) -> B1:
    """(n, m) whether combinations (n, n_objects) and others (m, n_objects) agree in what both know."""
    first, second = combinations[:, None], others[None]
    return np.asarray(((first == second) | np.isnan(first) | np.isnan(second)).all(axis=2))


def possible_combinations(seen: F64) -> F64:
    """Combinations (n, n_objects) of 1 and 0: those that were seen, then those that differ from them least.

    Parameters
    ----------
    seen : (m, n_objects) float64
        1, 0, or NaN = unknown; rows that know all objects are combinations.

    Returns
    -------
    (n, n_objects) float64
        At most `MAX_COMBINATIONS`, or all that were seen; among those that differ in as many objects, first those in
        whose favour the shares of the single objects speak.
    """
    n_objects = seen.shape[1]
    if n_objects == 0:
        return np.empty((0, 0))
    known = np.isfinite(seen)
    share = (np.where(known, seen, 0.0).sum(axis=0) + 0.5) / (known.sum(axis=0) + 1.0)
    complete = {tuple(row) for row in seen[known.all(axis=1)].tolist()}
    level = sorted(complete) or [tuple((share >= 0.5).astype(np.float64).tolist())]
    found = dict.fromkeys(level)
    most = max(MAX_COMBINATIONS, len(found))
    while level and len(found) < most:
        flipped = {(*row[:k], 1.0 - row[k], *row[k + 1 :]) for row in level for k in range(n_objects)}
        level = sorted(flipped - found.keys(), key=lambda row: (-_log_probability(np.array(row), share), row))
        found.update(dict.fromkeys(level[: most - len(found)]))
    return np.array(list(found))


def _log_probability(on: F64, share: F64) -> float:
    """Of a combination (n_objects,) of objects that are on by these shares, each for itself."""
    return round(float(np.log(np.where(on == 1.0, share, 1.0 - share)).sum()), 9)


def switches_of(is_on: F64) -> I64:
    """For each object the pairs of states that differ in nothing else; where there are none, all with it on and off.

    Parameters
    ----------
    is_on : (n_states, n_objects) float64
        1, 0, or NaN where a state knows nothing of an object.

    Returns
    -------
    (n_pairs, 3) int64
        Object, state with it on, state with it off; by objects.
    """
    found = [np.empty((0, 3), dtype=np.int64)]
    for number in range(is_on.shape[1]):
        others = np.delete(is_on, number, axis=1)
        on, off = (np.flatnonzero(is_on[:, number] == value) for value in (1.0, 0.0))
        same = (others[on][:, None] == others[off][None]).all(axis=2)
        first, second = np.nonzero(same if same.any() else np.ones_like(same))
        found.append(np.column_stack([np.full(first.size, number), on[first], off[second]]).astype(np.int64))
    return np.concatenate(found)


def composed(patch_set: PatchSet, nearest: I64, group: I64, on: F64) -> F32:
    """What the cells nearest to some objects look like (rows, cols) with these in given states; NaN elsewhere.

    Each cell is as in the mean of the patches with the object nearest to it in that state, and of all where these do
    not know it: what goes with an object, as the leaf of a door that is open, is beside it. The cells of an object are
    solid where it is on and free where it is off also if no patch shows that.

    Parameters
    ----------
    patch_set : PatchSet
    nearest : (rows, cols) int64
        Of `nearest_object`.
    group : (k,) int64
        Indices of the objects.
    on : (k,) float64
        1 or 0.
    """
    values = np.stack([patch.reflectance for patch in patch_set.patches]).astype(np.float64)
    support = np.array([max(patch.support, 1) for patch in patch_set.patches], dtype=np.float64)
    in_patches = on_in_patches(patch_set)
    every, looks = _mean(values, support), np.full(nearest.shape, np.nan)
    for index, value in zip(group.tolist(), on.tolist(), strict=True):
        shows = in_patches[:, index] == value
        mean, region = _mean(values[shows], support[shows]), nearest == index
        looks[region] = np.where(np.isnan(mean), every, mean)[region]
        cells = patch_set.objects[index].cells
        looks[cells] = (
            np.fmax(mean[cells], SOLID_REFLECTANCE)
            if value == 1.0
            else np.fmin(mean[cells], FREE_REFLECTANCE)
        )
    return looks.astype(np.float32)


def _mean(values: F64, weights: F64) -> F64:
    """Weighted mean over the first axis of what is known; NaN where nothing is."""
    known = np.isfinite(values)
    total = np.tensordot(weights, known, axes=1)
    sums = np.tensordot(weights, np.where(known, values, 0.0), axes=1)
    return np.asarray(np.where(total > 0.0, sums / np.maximum(total, 1e-9), np.nan))
