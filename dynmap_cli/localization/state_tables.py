"""What is believed of whole sub-maps and of objects, whichever of the two the filter has a belief of."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from dynmap_cli.arrays import F64
from dynmap_cli.domain.patches import PatchSet
from dynmap_cli.localization.found import StateRow
from dynmap_cli.localization.map_pool import MapPool
from dynmap_cli.localization.object_states import Part, on_probabilities
from dynmap_cli.localization.priors import prior_at
from dynmap_cli.localization.transitions import predict_belief, same_probability

_LEAST = 1e-12


@dataclass(frozen=True, slots=True)
class PatchBelief:
    """Belief in the patches of a sub-map after one scan.

    Attributes
    ----------
    stamp_ns : int
    submap_id : int
    patch_ids : tuple of int
    belief : (n_patches,) float64
    """

    stamp_ns: int
    submap_id: int
    patch_ids: tuple[int, ...]
    belief: F64


@dataclass(frozen=True, slots=True)
class ObjectBelief:
    """Probability that an object is there after one scan.

    Attributes
    ----------
    stamp_ns : int
    submap_id : int
    object_id : int
    probability_on : float
    """

    stamp_ns: int
    submap_id: int
    object_id: int
    probability_on: float


def patch_beliefs(
    rows: Sequence[StateRow], pool: MapPool, parts: Sequence[Part], patch_sets: Sequence[PatchSet]
) -> list[PatchBelief]:
    """Belief in the patches of each sub-map in view, in the order of the rows.

    Objects are independent: P(patch) is proportional to the product over its objects of the probability of the state
    they have in it, over the known patches. An object of the sub-map that is out of view counts with what was last
    believed of it, grown old.

    Parameters
    ----------
    rows : sequence of StateRow
        By time.
    pool : MapPool
        Made of the parts.
    parts : sequence of Part
    patch_sets : sequence of PatchSet
        That the parts were made of.
    """
    whole = {patch_set.submap_id: patch_set for patch_set in patch_sets}
    members: dict[int, list[int]] = {}
    for number, part in enumerate(parts):
        members.setdefault(part.states.submap_id, []).append(number)
    last: dict[int, StateRow] = {}
    found = []
    for stamp_ns, group in groupby(rows, key=lambda row: row.stamp_ns):
        in_view: dict[int, None] = {}
        for row in group:
            last[row.submap] = row
            in_view[parts[row.submap].states.submap_id] = None
        for submap_id in in_view:
            numbers = members[submap_id]
            patch_set = whole[submap_id]
            if parts[numbers[0]].thing is None:
                belief = last[numbers[0]].belief
            else:
                on = np.array([_belief_at(number, stamp_ns, last, pool)[1] for number in numbers])
                belief = _product([parts[number] for number in numbers], on, patch_set)
            patch_ids = tuple(patch.patch_id for patch in patch_set.patches)
            found.append(PatchBelief(stamp_ns, submap_id, patch_ids, belief))
    return found


def object_beliefs(rows: Sequence[StateRow], parts: Sequence[Part]) -> Iterator[ObjectBelief]:
    """Probability that each object in view is there; where sub-maps have beliefs, that of the patches it is on in."""
    for row in rows:
        part = parts[row.submap]
        submap_id = part.states.submap_id
        if part.thing is not None:
            yield ObjectBelief(row.stamp_ns, submap_id, part.thing.object_id, float(row.belief[1]))
            continue
        for thing in part.states.objects:
            probability = float(row.belief @ on_probabilities(thing, part.states.patches))
            yield ObjectBelief(row.stamp_ns, submap_id, thing.object_id, probability)


def _belief_at(number: int, stamp_ns: int, last: Mapping[int, StateRow], pool: MapPool) -> F64:
    """What was last believed of one part, grown old."""
    submap = pool.submaps[number]
    row = last.get(number)
    if row is None:
        return prior_at(submap.prior, stamp_ns)
    seconds = max(stamp_ns - row.stamp_ns, 0) * 1e-9
    return predict_belief(row.belief, same_probability(submap, seconds))


def _product(parts: Sequence[Part], on: F64, patch_set: PatchSet) -> F64:
    """Belief in the patches (n_patches,) from the probability (n_objects,) that each object is there."""
    belief = np.ones(len(patch_set.patches))
    for part, probability in zip(parts, on.tolist(), strict=True):
        if part.thing is not None:
            is_on = on_probabilities(part.thing, patch_set.patches)
            belief *= is_on * probability + (1.0 - is_on) * (1.0 - probability)
    belief = np.maximum(belief, _LEAST)
    return np.asarray(belief / belief.sum())
