"""What a localization believed of objects against the doors and boxes that were really there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np

from dynmap_cli.arrays import F64, I64
from dynmap_cli.evaluation.association import nearest_stamp
from dynmap_cli.evaluation.objects import OFF_SHARE, ON_SHARE, cell_shares, covered_cells
from dynmap_cli.evaluation.scores import ratio
from dynmap_cli.evaluation.truth import Truth, read_run
from dynmap_cli.files.patch_archive import read_patches
from dynmap_cli.files.trajectory import parse_stamp

ObjectShares: TypeAlias = Mapping[tuple[int, int], Mapping[tuple[str, str], float]]
"""By sub-map and object: share of its cells that a true thing covers in a state, by the names of both."""


@dataclass(frozen=True, slots=True)
class BelievedObject:
    """Probability that one object was there, over time.

    Attributes
    ----------
    stamps_ns : (n,) int64
    probability_on : (n,) float64
    """

    stamps_ns: I64
    probability_on: F64


def read_object_shares(run_dir: Path, truth: Truth) -> ObjectShares:
    """Find which true things the objects of a run's patch map are; *truth* is that of its recording."""
    run, found = read_run(run_dir), {}
    for patch_set in read_patches(run_dir / "patches" / "patches.zip"):
        covers = covered_cells(run, truth, patch_set.frame) if patch_set.objects else {}
        for thing in patch_set.objects:
            found[patch_set.submap_id, thing.object_id] = {
                (true.name, state): float(share)
                for true, shares in zip(truth.objects, cell_shares(thing, covers, truth), strict=True)
                for state, share in zip(true.states, shares.tolist(), strict=True)
            }
    return found


def parse_beliefs(rows: Sequence[Mapping[str, str]]) -> dict[tuple[int, int], BelievedObject]:
    """The rows of objects.csv by sub-map and object."""
    found: dict[tuple[int, int], list[tuple[int, float]]] = {}
    for row in rows:
        key = int(row["submap"]), int(row["object"])
        found.setdefault(key, []).append((parse_stamp(row["stamp_s"]), float(row["probability_on"])))
    return {
        key: BelievedObject(
            np.array([stamp for stamp, _ in pairs], dtype=np.int64),
            np.array([probability for _, probability in pairs], dtype=np.float64),
        )
        for key, pairs in found.items()
    }


def object_measures(
    believed: Mapping[tuple[int, int], BelievedObject], shares: ObjectShares, truth: Truth, sure: float
) -> dict[str, float]:
    """Share of right beliefs over all scans and objects in view, and of those that were *sure*.

    An object is truly on at a scan if a thing covers 60 % of its cells in the state it is in then, and truly off if
    none covers 40 %; what lies between does not count.
    """
    right = count = n_sure = sure_and_right = 0
    for key, own in believed.items():
        if key not in shares:
            continue
        scans = nearest_stamp(truth.trajectory.stamps_ns, own.stamps_ns)
        covered = covered_share(shares[key], truth)[scans]
        counts = (scans >= 0) & ((covered >= ON_SHARE) | (covered <= OFF_SHARE))
        is_right = ((own.probability_on >= 0.5) == (covered >= ON_SHARE)) & counts
        is_sure = (np.maximum(own.probability_on, 1.0 - own.probability_on) >= sure) & counts
        right, count = right + int(is_right.sum()), count + int(counts.sum())
        n_sure, sure_and_right = n_sure + int(is_sure.sum()), sure_and_right + int((is_sure & is_right).sum())
    return {
        "object_accuracy": ratio(right, count),
        "object_sure_share": ratio(n_sure, count),
        "object_accuracy_when_sure": ratio(sure_and_right, n_sure),
    }


def covered_share(shares: Mapping[tuple[str, str], float], truth: Truth) -> F64:
    """Largest share of an object's cells that a thing covers at each scan (n_scans,)."""
    largest = np.zeros(truth.object_states.shape[0])
    for number, thing in enumerate(truth.objects):
        by_state = np.array([shares.get((thing.name, state), 0.0) for state in thing.states])
        largest = np.maximum(largest, by_state[truth.object_states[:, number]])
    return largest
