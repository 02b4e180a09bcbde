"""States of sub-maps that a localization believed in, against what the doors and boxes in them really were."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import B1, F64, I64
from dynmap_cli.domain.patches import SURE
from dynmap_cli.evaluation.association import nearest_stamp
from dynmap_cli.evaluation.object_beliefs import BelievedObject, ObjectShares, covered_share
from dynmap_cli.evaluation.objects import OFF_SHARE, ON_SHARE
from dynmap_cli.evaluation.scores import ratio
from dynmap_cli.evaluation.states import (
    ELSEWHERE,
    Configuration,
    LearnedStates,
    configurations,
    patch_meanings,
)
from dynmap_cli.evaluation.truth import Truth


@dataclass(frozen=True, slots=True)
class Believed:
    """The state believed most of one sub-map over time.

    Attributes
    ----------
    stamps_ns : (n,) int64
    patches : (n,) int64
    probability : (n,) float64
    """

    stamps_ns: I64
    patches: I64
    probability: F64


def state_measures(
    believed: Mapping[int, Believed], truth: Truth, learned: LearnedStates, map_truth: Truth
) -> dict[str, float]:
    """Share of right states over all scans and sub-maps in view, and how soon changes were noticed.

    The delay of a change runs from the first scan that had the sub-map in view after it. A patch means what was
    there in most visits of the run; one without such a visit is never right. A patch is the state of all objects in a
    sub-map together, and where these were never seen like this while the map was made, no patch is right: the share of
    the others is `state_mapped_share`, and of them are right `state_accuracy_when_mapped`.
    """
    right = count = sure = sure_and_right = mapped = changes = 0
    delays_s: list[float] = []
    for submap in learned.submaps:
        reach = learned.reach[submap.submap_id]
        own = believed.get(submap.submap_id)
        if own is None or not any(thing.name in reach for thing in truth.objects):
            continue
        meanings = patch_meanings(submap.submap_id, reach, learned.visits, map_truth)
        actual = configurations(truth, reach)
        is_right = _is_right(own, actual, meanings, truth.trajectory.stamps_ns)
        right, count = right + int(is_right.sum()), count + is_right.size
        mapped += _count_mapped(own, actual, meanings, truth.trajectory.stamps_ns)
        is_sure = own.probability >= SURE
        sure, sure_and_right = sure + int(is_sure.sum()), sure_and_right + int((is_sure & is_right).sum())
        found = _delays_s(own.stamps_ns, is_right, _change_stamps(actual, truth.trajectory.stamps_ns))
        changes += len(found)
        delays_s += [delay for delay in found if math.isfinite(delay)]
    return {
        "state_accuracy": ratio(right, count),
        "state_mapped_share": ratio(mapped, count),
        "state_accuracy_when_mapped": ratio(right, mapped),
        "state_sure_share": ratio(sure, count),
        "state_accuracy_when_sure": ratio(sure_and_right, sure),
        "state_changes_in_view": float(changes),
        "state_changes_noticed_share": ratio(len(delays_s), changes),
        "state_delay_median_s": float(np.median(delays_s)) if delays_s else math.nan,
    }


def combination_accuracy(
    believed: Mapping[int, Believed],
    objects: Mapping[tuple[int, int], BelievedObject],
    shares: ObjectShares,
    truth: Truth,
    learned: LearnedStates,
    map_truth: Truth,
) -> float:
    """Share of right states over all scans and sub-maps in view, of combinations that were never mapped, too.

    Right is a patch that means what is there, as for `state_measures`, and otherwise a combination in which all objects
    in view are as they were, if everything that is there is one of the objects.
    """
    right = count = 0
    for submap in learned.submaps:
        number, reach = submap.submap_id, learned.reach[submap.submap_id]
        own = believed.get(number)
        if own is None or not any(thing.name in reach for thing in truth.objects):
            continue
        meanings = patch_meanings(number, reach, learned.visits, map_truth)
        actual, stamps_ns = configurations(truth, reach), truth.trajectory.stamps_ns
        scans = nearest_stamp(stamps_ns, own.stamps_ns)
        are_objects = (scans >= 0) & _are_objects(actual, number, shares)[scans]
        is_right = _is_right(own, actual, meanings, stamps_ns)
        is_right |= are_objects & _right_objects(number, own.stamps_ns, objects, shares, truth)
        right, count = right + int(is_right.sum()), count + is_right.size
    return ratio(right, count)


def _is_right(
    own: Believed,
    actual: Sequence[Configuration],
    meanings: Mapping[int, Configuration],
    stamps_ns: I64,
) -> B1:
    """Whether each believed patch means what was there."""
    scans = nearest_stamp(stamps_ns, own.stamps_ns)
    return np.array(
        [
            scan >= 0 and meanings.get(patch) == actual[scan]
            for scan, patch in zip(scans.tolist(), own.patches.tolist(), strict=True)
        ],
        dtype=bool,
    )


def _count_mapped(
    own: Believed,
    actual: Sequence[Configuration],
    meanings: Mapping[int, Configuration],
    stamps_ns: I64,
) -> int:
    """In how many scans what was there is what some patch means."""
    known = set(meanings.values())
    return sum(
        scan >= 0 and actual[scan] in known for scan in nearest_stamp(stamps_ns, own.stamps_ns).tolist()
    )


def _change_stamps(actual: Sequence[Configuration], stamps_ns: I64) -> I64:
    """Stamps of the scans at which the configuration is another than at the scan before."""
    changed = [now != before for before, now in itertools.pairwise(actual)]
    return np.asarray(stamps_ns[1:][np.array(changed, dtype=bool)])


def _delays_s(stamps_ns: I64, is_right: B1, changes_ns: I64) -> list[float]:
    """Delay of each change that was in view before the next one; inf where it was not noticed until then."""
    delays = []
    for begin, end in itertools.pairwise([*changes_ns.tolist(), np.iinfo(np.int64).max]):
        seen = np.flatnonzero((stamps_ns >= begin) & (stamps_ns < end))
        if seen.size == 0:
            continue
        noticed = seen[is_right[seen]]
        delays.append(float(stamps_ns[noticed[0]] - stamps_ns[seen[0]]) * 1e-9 if noticed.size else math.inf)
    return delays


def _right_objects(
    submap_id: int,
    stamps_ns: I64,
    objects: Mapping[tuple[int, int], BelievedObject],
    shares: ObjectShares,
    truth: Truth,
) -> B1:
    """Whether, at each stamp (n,), every object of a sub-map that was in view was believed to be as it was.

    Objects that are neither on nor off, see `object_measures`, do not count; False where none counts.
    """
    scans = nearest_stamp(truth.trajectory.stamps_ns, stamps_ns)
    n_right, n_wrong = np.zeros((2, stamps_ns.size), dtype=np.int64)
    for key, own in objects.items():
        if key[0] != submap_id or key not in shares or own.stamps_ns.size == 0:
            continue
        row = np.minimum(np.searchsorted(own.stamps_ns, stamps_ns), own.stamps_ns.size - 1)
        covered = covered_share(shares[key], truth)[scans]
        counts = (own.stamps_ns[row] == stamps_ns) & (scans >= 0)
        counts &= (covered >= ON_SHARE) | (covered <= OFF_SHARE)
        is_right = (own.probability_on[row] >= 0.5) == (covered >= ON_SHARE)
        n_right += counts & is_right
        n_wrong += counts & ~is_right
    return np.asarray((n_right > 0) & (n_wrong == 0))


def _are_objects(actual: Sequence[Configuration], submap_id: int, shares: ObjectShares) -> B1:
    """Whether, at each scan (n,), each thing that is there in a sub-map is one of its objects in that state."""
    own = [share for (number, _), share in shares.items() if number == submap_id]
    known: dict[Configuration, bool] = {}
    for configuration in set(actual):
        there = [pair for pair in configuration if pair[1] != ELSEWHERE]
        known[configuration] = all(any(share.get(pair, 0.0) >= ON_SHARE for share in own) for pair in there)
    return np.array([known[configuration] for configuration in actual], dtype=bool)
