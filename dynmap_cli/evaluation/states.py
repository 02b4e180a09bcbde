"""Visits against what the doors and boxes of a sub-map really were."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from dynmap_cli.arrays import F64, I64
from dynmap_cli.domain.patches import Visit
from dynmap_cli.domain.poses import Trajectory, transform_points
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.evaluation.scores import Score, ratio
from dynmap_cli.evaluation.truth import Truth, read_run, truth_from_map
from dynmap_cli.files.patch_archive import read_visits
from dynmap_cli.files.submaps import read_submaps

Configuration: TypeAlias = tuple[tuple[str, str], ...]
"""(object, state) of each object in a sub-map."""
_MARGIN_M, _LEAST_CELLS = 0.1, 6


@dataclass(frozen=True, slots=True)
class LearnedStates:
    """The patch map of a run.

    Attributes
    ----------
    submaps : tuple of SubMap
    visits : tuple of Visit
    truth_from_map : (3,) float64
    """

    submaps: tuple[SubMap, ...]
    visits: tuple[Visit, ...]
    truth_from_map: F64


def read_learned_states(run_dir: Path, truth: Truth) -> LearnedStates:
    """Read sub-maps and visits of a run, and find how its map lies in the frame of the truth."""
    run = read_run(run_dir)
    return LearnedStates(
        read_submaps(run_dir / "submaps"),
        read_visits(run_dir / "patches" / "patches.zip"),
        truth_from_map(Trajectory(run.log.stamps_ns, run.poses), truth),
    )


def objects_in(submap: SubMap, truth_from_map_pose: F64, truth: Truth) -> tuple[int, ...]:
    """Numbers of the objects on which contested cells of a sub-map lie.

    Six cells are asked for, the least that a region has, or all where there are fewer.
    """
    cells = np.argwhere(submap.contested)
    points = transform_points(truth_from_map_pose, submap.frame.to_points(cells))
    least = min(_LEAST_CELLS, cells.shape[0])
    found = []
    for number, thing in enumerate(truth.objects):
        low, high = thing.bounds_m[:2] - _MARGIN_M, thing.bounds_m[2:] + _MARGIN_M
        if int(((points >= low) & (points <= high)).all(axis=1).sum()) >= least:
            found.append(number)
    return tuple(found)


def configuration_at(truth: Truth, scan: int, objects: Sequence[int]) -> Configuration:
    """States of some objects at one scan."""
    return tuple(
        (truth.objects[number].name, truth.objects[number].states[truth.object_states[scan, number]])
        for number in objects
    )


def true_configuration(visit: Visit, objects: Sequence[int], truth: Truth) -> Configuration | None:
    """What was there during a visit; None where it changed, or the truth is about other times."""
    stamps = truth.trajectory.stamps_ns
    scans = np.flatnonzero((stamps >= visit.start_ns) & (stamps <= visit.end_ns))
    if scans.size == 0:
        return None
    states = truth.object_states[scans][:, list(objects)]
    return configuration_at(truth, int(scans[0]), objects) if (states == states[0]).all() else None


def patch_meanings(
    submap_id: int, objects: Sequence[int], visits: Sequence[Visit], truth: Truth
) -> dict[int, Configuration]:
    """For each patch, the configuration that was there in most of the visits assigned to it."""
    counts: dict[int, Counter[Configuration]] = {}
    for visit in visits:
        if visit.submap_id == submap_id and visit.patch is not None:
            found = true_configuration(visit, objects, truth)
            if found is not None:
                counts.setdefault(visit.patch, Counter())[found] += 1
    return {patch: counter.most_common(1)[0][0] for patch, counter in counts.items()}


def adjusted_rand_index(first: Sequence[object], second: Sequence[object]) -> float:
    """Agreement of two groupings of the same things, 1 = the same, 0 = as by chance (Hubert and Arabie 1985)."""
    if len(first) != len(second):
        msg = f"{len(first)} labels against {len(second)}"
        raise ValueError(msg)
    rows, cols = _numbered(first), _numbered(second)
    together = np.zeros((rows.max(initial=-1) + 1, cols.max(initial=-1) + 1))
    np.add.at(together, (rows, cols), 1.0)
    pairs = float(_pairs(together).sum())
    by_row, by_col = float(_pairs(together.sum(axis=1)).sum()), float(_pairs(together.sum(axis=0)).sum())
    total = len(first) * (len(first) - 1) / 2.0
    if not len(first):
        return math.nan
    expected = by_row * by_col / total if total else 0.0
    most = 0.5 * (by_row + by_col)
    return 1.0 if most == expected else (pairs - expected) / (most - expected)


def _numbered(labels: Sequence[object]) -> I64:
    """Number labels in the order in which they come."""
    numbers: dict[object, int] = {}
    return np.array([numbers.setdefault(label, len(numbers)) for label in labels], dtype=np.int64)


def _pairs(counts: F64) -> F64:
    return np.asarray(counts * (counts - 1.0) / 2.0)


def score_states(name: str, learned: LearnedStates, truth: Truth) -> Score:
    """Adjusted Rand index of the visits, states found against states that occurred, objects found and false sub-maps.

    The index and the share of right numbers of states are over the sub-maps in which there is an object; visits
    during which something changed, or that the run left open, do not enter the index, but are counted.
    """
    rows = [_submap_row(submap, learned, truth) for submap in learned.submaps]
    real = [row for row in rows if row["objects"]]
    weights = np.array([row["in_index"] for row in real], dtype=np.float64)
    indices = np.array([row["rand_index"] for row in real], dtype=np.float64)
    counted = weights > 0
    changed = [
        number for number in range(len(truth.objects)) if np.unique(truth.object_states[:, number]).size > 1
    ]
    found = {
        number for submap in learned.submaps for number in objects_in(submap, learned.truth_from_map, truth)
    }
    visits = sum(row["visits"] for row in real)
    values = {
        "objects_that_changed": float(len(changed)),
        "objects_found_share": ratio(len(found & set(changed)), len(changed)),
        "submaps": float(len(rows)),
        "submaps_without_object": float(len(rows) - len(real)),
        "adjusted_rand_index": float((weights * indices)[counted].sum() / weights.sum())
        if counted.any()
        else math.nan,
        "right_number_of_states_share": ratio(
            sum(row["states_found"] == row["states_occurred"] for row in real), len(real)
        ),
        "visits": float(visits),
        "visits_assigned_share": ratio(sum(row["assigned"] for row in real), visits),
    }
    details = [
        {key: value if key != "objects" else " ".join(value) or "-" for key, value in row.items()}
        for row in rows
    ]
    known = [visit for visit in learned.visits if _in_time(visit, truth)]
    coverage = ratio(len(known), len(learned.visits)) if learned.visits else 1.0
    return Score(name, coverage, values, {"sub-maps": details})


def _in_time(visit: Visit, truth: Truth) -> bool:
    """Whether the truth is about the time of a visit."""
    stamps = truth.trajectory.stamps_ns
    return bool(((stamps >= visit.start_ns) & (stamps <= visit.end_ns)).any())


def _submap_row(submap: SubMap, learned: LearnedStates, truth: Truth) -> dict[str, Any]:
    """Count what one sub-map found."""
    objects = objects_in(submap, learned.truth_from_map, truth)
    own = [visit for visit in learned.visits if visit.submap_id == submap.submap_id]
    pairs = [(visit.patch, true_configuration(visit, objects, truth)) for visit in own]
    both = [(patch, found) for patch, found in pairs if patch is not None and found is not None]
    return {
        "submap": submap.submap_id,
        "objects": [truth.objects[number].name for number in objects],
        "visits": len(own),
        "assigned": sum(patch is not None for patch, _ in pairs),
        "changed_meanwhile": sum(found is None for _, found in pairs),
        "in_index": len(both),
        "states_found": len({patch for patch, _ in pairs if patch is not None}),
        "states_occurred": len({found for _, found in pairs if found is not None}),
        "rand_index": adjusted_rand_index([patch for patch, _ in both], [found for _, found in both]),
    }
