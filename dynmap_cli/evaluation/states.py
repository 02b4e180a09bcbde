"""Visits against what the doors and boxes of a sub-map really were."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from scipy import ndimage

from dynmap_cli.arrays import F64, I32, I64
from dynmap_cli.domain.patches import Visit
from dynmap_cli.domain.poses import Trajectory
from dynmap_cli.domain.scans import end_points
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.evaluation.scores import Score, ratio
from dynmap_cli.evaluation.truth import Run, Truth, read_run, same_scans, truth_from_map
from dynmap_cli.files.patch_archive import read_visits
from dynmap_cli.files.submaps import read_submaps

Configuration: TypeAlias = tuple[tuple[str, str], ...]
"""(object, state) of each object in a sub-map; a state that does not reach into the sub-map is "elsewhere"."""
Reach: TypeAlias = Mapping[str, frozenset[str]]
"""Objects that reach into a sub-map, each with the states in which it does."""
ELSEWHERE = "elsewhere"
_LEAST_HITS, _LEAST_CELLS = 3, 3


@dataclass(frozen=True, slots=True)
class LearnedStates:
    """The patch map of a run.

    Attributes
    ----------
    submaps : tuple of SubMap
    visits : tuple of Visit
    truth_from_map : (3,) float64
    reach : dict of int to Reach
        By sub-map.
    """

    submaps: tuple[SubMap, ...]
    visits: tuple[Visit, ...]
    truth_from_map: F64
    reach: Mapping[int, Reach]


def read_learned_states(run_dir: Path, truth: Truth) -> LearnedStates:
    """Read sub-maps and visits of a run, and find how its map lies in the frame of the truth."""
    run = read_run(run_dir)
    submaps = read_submaps(run_dir / "submaps")
    return LearnedStates(
        submaps,
        read_visits(run_dir / "patches" / "patches.zip"),
        truth_from_map(Trajectory(run.log.stamps_ns, run.poses), truth),
        reach_of_objects(run, truth, submaps),
    )


def reach_of_objects(run: Run, truth: Truth, submaps: Sequence[SubMap]) -> dict[int, Reach]:
    """Find which objects reach into which sub-maps, and in which states.

    An object does if beams that truly hit it end in three contested cells or more (or beside them), three times in
    each. So a cupboard with four places, two of them in a sub-map, has three states there: two, and elsewhere.
    """
    mine, theirs = same_scans(run.log.stamps_ns, truth)
    log, classes = run.log.select(mine), truth.beam_class[theirs]
    hit = (classes >= truth.first_object) & np.isfinite(log.ranges_m)
    points = end_points(log, run.poses[mine], hit)
    scan = np.nonzero(hit)[0]
    objects = classes[hit] - truth.first_object
    states = truth.object_states[theirs[scan], objects]
    return {submap.submap_id: _reach(submap, points, objects, states, truth) for submap in submaps}


def _reach(submap: SubMap, points: F64, objects: I32, states: I32, truth: Truth) -> Reach:
    """Objects and states whose hits lie on the contested cells of one sub-map."""
    contested = ndimage.binary_dilation(submap.contested, np.ones((3, 3), dtype=bool))
    row, col = submap.frame.to_cells(points).T
    inside = (row >= 0) & (row < submap.frame.rows) & (col >= 0) & (col < submap.frame.cols)
    inside[inside] = contested[row[inside], col[inside]]
    keys = np.column_stack([objects[inside], states[inside], row[inside], col[inside]])
    cells, hits = np.unique(keys, axis=0, return_counts=True)
    found, n_cells = np.unique(cells[hits >= _LEAST_HITS, :2], axis=0, return_counts=True)
    reach: dict[str, frozenset[str]] = {}
    for number, state in found[n_cells >= _LEAST_CELLS].tolist():
        thing = truth.objects[number]
        reach[thing.name] = reach.get(thing.name, frozenset()) | {thing.states[state]}
    return reach


def configurations(truth: Truth, reach: Reach, scans: slice = slice(None)) -> list[Configuration]:
    """States, scan by scan, of the objects that reach into a sub-map."""
    rows, which = np.unique(truth.object_states[scans], axis=0, return_inverse=True)
    distinct = [_configuration(row.tolist(), truth, reach) for row in rows]
    return [distinct[number] for number in which.ravel().tolist()]


def _configuration(states: Sequence[int], truth: Truth, reach: Reach) -> Configuration:
    """Name the states of those objects that reach into a sub-map."""
    found = []
    for thing, number in zip(truth.objects, states, strict=True):
        if thing.name in reach:
            state = thing.states[number]
            found.append((thing.name, state if state in reach[thing.name] else ELSEWHERE))
    return tuple(found)


def true_configuration(visit: Visit, reach: Reach, truth: Truth) -> Configuration | None:
    """What was there during a visit; None where it changed, or the truth is about other times."""
    stamps = truth.trajectory.stamps_ns
    first = int(np.searchsorted(stamps, visit.start_ns))
    end = int(np.searchsorted(stamps, visit.end_ns, side="right"))
    found = set(configurations(truth, reach, slice(first, end)))
    return found.pop() if len(found) == 1 else None


def patch_meanings(
    submap_id: int, reach: Reach, visits: Sequence[Visit], truth: Truth
) -> dict[int, Configuration]:
    """For each patch, the configuration that was there in most of the visits assigned to it."""
    counts: dict[int, Counter[Configuration]] = {}
    for visit in visits:
        if visit.submap_id == submap_id and visit.patch is not None:
            found = true_configuration(visit, reach, truth)
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
    changed = {
        thing.name
        for number, thing in enumerate(truth.objects)
        if np.unique(truth.object_states[:, number]).size > 1
    }
    found = {name for reach in learned.reach.values() for name in reach}
    visits = sum(row["visits"] for row in real)
    values = {
        "objects_that_changed": float(len(changed)),
        "objects_found_share": ratio(len(found & changed), len(changed)),
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
    reach = learned.reach[submap.submap_id]
    own = [visit for visit in learned.visits if visit.submap_id == submap.submap_id]
    pairs = [(visit.patch, true_configuration(visit, reach, truth)) for visit in own]
    both = [(patch, found) for patch, found in pairs if patch is not None and found is not None]
    return {
        "submap": submap.submap_id,
        "objects": list(reach),
        "visits": len(own),
        "assigned": sum(patch is not None for patch, _ in pairs),
        "changed_meanwhile": sum(found is None for _, found in pairs),
        "in_index": len(both),
        "states_found": len({patch for patch, _ in pairs if patch is not None}),
        "states_occurred": len({found for _, found in pairs if found is not None}),
        "rand_index": adjusted_rand_index([patch for patch, _ in both], [found for _, found in both]),
    }
