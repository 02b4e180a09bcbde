"""What is believed of whole sub-maps and of objects, from the beliefs in their parts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from dynmap_cli.arrays import F64, I64
from dynmap_cli.domain.patches import NEVER_MAPPED, PatchSet
from dynmap_cli.localization.beliefs.combinations import on_in_patches
from dynmap_cli.localization.beliefs.parts import Part
from dynmap_cli.localization.beliefs.priors import prior_at
from dynmap_cli.localization.beliefs.transitions import predict_belief
from dynmap_cli.localization.found import StateRow
from dynmap_cli.localization.sensing.map_pool import MapPool

_LEAST = 1e-12


@dataclass(frozen=True, slots=True)
class PatchBelief:
    """Belief in the patches of a sub-map after one scan.

    Attributes
    ----------
    stamp_ns : int
    submap_id : int
    patch_ids : tuple of int
        Last `NEVER_MAPPED`, where there can be such states.
    belief : (n,) float64
    description : str
        Where a state that was never mapped is believed most: the patch most like it, and what differs.
    """

    stamp_ns: int
    submap_id: int
    patch_ids: tuple[int, ...]
    belief: F64
    description: str = ""


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

    Parts are independent: P(patch) is the product over its parts of the probability of the states they can have in it.
    A part of the sub-map that is out of view counts with what was last believed of it, grown old.

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
    members: dict[int, list[int]] = {}
    for number, part in enumerate(parts):
        members.setdefault(part.states.submap_id, []).append(number)
    tables = {
        patch_set.submap_id: _Table(patch_set, [parts[number] for number in members[patch_set.submap_id]])
        for patch_set in patch_sets
        if patch_set.submap_id in members
    }
    last: dict[int, StateRow] = {}
    found = []
    for stamp_ns, group in groupby(rows, key=lambda row: row.stamp_ns):
        in_view: dict[int, None] = {}
        for row in group:
            last[row.submap] = row
            in_view[parts[row.submap].states.submap_id] = None
        for submap_id in in_view:
            beliefs = [_belief_at(number, stamp_ns, last, pool) for number in members[submap_id]]
            found.append(tables[submap_id].believed(stamp_ns, beliefs))
    return found


def object_beliefs(rows: Sequence[StateRow], parts: Sequence[Part]) -> Iterator[ObjectBelief]:
    """Probability that each object in view is there: that of the states of its part it is on in."""
    on = [part.on_probabilities for part in parts]
    for row in rows:
        states = parts[row.submap].states
        for number, thing in enumerate(states.objects):
            if row.objects_in_view[number]:
                probability = float(row.belief @ on[row.submap][:, number])
                yield ObjectBelief(row.stamp_ns, states.submap_id, thing.object_id, probability)


class _Table:
    """The patches of one sub-map, and the states of its parts."""

    def __init__(self, patch_set: PatchSet, parts: Sequence[Part]) -> None:
        self._patch_set, self._parts = patch_set, parts
        every = np.concatenate([part.shown for part in parts])
        _, same, counts = np.unique(every, axis=1, return_inverse=True, return_counts=True)
        self._alike: I64 = counts[same.reshape(-1)]
        self._is_mapped = len(parts) == 1 and bool((parts[0].shown.sum(axis=1) > 0.0).all())
        self._patch_ids = tuple(patch.patch_id for patch in patch_set.patches)

    def believed(self, stamp_ns: int, beliefs: Sequence[F64]) -> PatchBelief:
        """Belief in the patches from those in the parts (n_states,) each."""
        shares = [belief @ part.shown for belief, part in zip(beliefs, self._parts, strict=True)]
        belief = np.prod(shares, axis=0) / self._alike
        belief /= max(float(belief.sum()), 1.0)
        submap_id = self._patch_set.submap_id
        if self._is_mapped:
            return PatchBelief(stamp_ns, submap_id, self._patch_ids, belief / max(belief.sum(), _LEAST))
        belief = np.append(belief, max(1.0 - float(belief.sum()), 0.0))
        is_never = bool(belief[-1] >= belief[:-1].max())
        description = self._description(beliefs) if is_never else ""
        return PatchBelief(stamp_ns, submap_id, (*self._patch_ids, NEVER_MAPPED), belief, description)

    def _description(self, beliefs: Sequence[F64]) -> str:
        """The likeliest combination that was never mapped, as the patch that differs from it in the fewest objects."""
        on: dict[int, float] = {}
        for belief, part in zip(beliefs, self._parts, strict=True):
            never = part.shown.sum(axis=1) == 0.0
            allowed = never if len(self._parts) == 1 else np.ones_like(never)
            state = int(np.where(allowed, belief, -1.0).argmax())
            is_on = part.on_probabilities[state].tolist()
            for thing, value in zip(part.states.objects, is_on, strict=True):
                on[thing.object_id] = value
        objects = [number for number, thing in enumerate(self._patch_set.objects) if thing.object_id in on]
        ids = [self._patch_set.objects[number].object_id for number in objects]
        believed = np.array([on[object_id] for object_id in ids])
        in_patches = on_in_patches(self._patch_set)[:, objects]
        differs = (in_patches != believed) & np.isfinite(in_patches)
        nearest = int(differs.sum(axis=1).argmin())
        words = [
            f"{'with' if value == 1.0 else 'without'} object {object_id}"
            for object_id, value, other in zip(ids, believed, differs[nearest], strict=True)
            if other
        ]
        return " ".join([str(self._patch_ids[nearest]), " and ".join(words)]).strip()


def _belief_at(number: int, stamp_ns: int, last: Mapping[int, StateRow], pool: MapPool) -> F64:
    """What was last believed of one part, grown old."""
    submap = pool.submaps[number]
    row = last.get(number)
    if row is None:
        return prior_at(submap.prior, stamp_ns)
    return predict_belief(row.belief, submap, max(stamp_ns - row.stamp_ns, 0) * 1e-9)
