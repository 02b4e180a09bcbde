"""Objects of a patch map, visit by visit, against the doors and boxes that were really there."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import ndimage

from dynmap_cli.arrays import B1, F64
from dynmap_cli.counting.counts import count_beams
from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.patches import OFF, ON, UNKNOWN_STATE, ChangingObject, PatchSet, Visit
from dynmap_cli.domain.scans import end_points
from dynmap_cli.evaluation.scores import Score, ratio
from dynmap_cli.evaluation.states import read_learned_states, score_states
from dynmap_cli.evaluation.truth import Run, Truth, read_run, same_scans
from dynmap_cli.files.patch_archive import read_patches, read_visits

ON_SHARE, OFF_SHARE = 0.6, 0.4
_LEAST_HITS, _LEAST_BEAMS, _SEEN_SHARE, _RANGE_M = 2, 3.0, 0.25, 12.0


def score_run(name: str, run_dir: Path, truth: Truth) -> Score:
    """Score of the states of a run (`score_states`), with those of its objects beside them."""
    states = score_states(name, read_learned_states(run_dir, truth), truth)
    archive = run_dir / "patches" / "patches.zip"
    objects = score_objects(name, read_run(run_dir), read_patches(archive), read_visits(archive), truth)
    return replace(states, values={**states.values, **objects.values})


def score_objects(
    name: str, run: Run, patch_sets: Sequence[PatchSet], visits: Sequence[Visit], truth: Truth
) -> Score:
    """Share of the states of objects that are right, and that are unknown.

    An object is truly on if one of the things that were there in that state hit beams in 60 % of its cells (or beside
    them), at any time in the recording, and off if none did in 40 %. What lies between, and visits during which that
    changed, does not count. *In view* are the visits in which three beams or more reached a quarter of the cells.

    Parameters
    ----------
    name : str
    run : Run
    patch_sets : sequence of PatchSet
    visits : sequence of Visit
    truth : Truth
    """
    counts: Counter[str] = Counter()
    for patch_set in patch_sets:
        own = [visit for visit in visits if visit.submap_id == patch_set.submap_id]
        covers = covered_cells(run, truth, patch_set.frame)
        shares = [cell_shares(thing, covers, truth) for thing in patch_set.objects]
        for visit in own:
            crossed = _crossed(run, visit, patch_set.frame)
            for thing, share in zip(patch_set.objects, shares, strict=True):
                is_on = _truly_on(visit, share, truth)
                if is_on is None:
                    continue
                found = thing.states.get(visit.sequence, UNKNOWN_STATE)
                counts["states"] += 1
                counts["known"] += found != UNKNOWN_STATE
                counts["right"] += found == (ON if is_on else OFF)
                in_view = bool(crossed[thing.cells].mean() >= _SEEN_SHARE)
                counts["in_view"] += in_view
                counts["unknown_in_view"] += in_view and found == UNKNOWN_STATE
    values = {
        "objects": float(sum(len(patch_set.objects) for patch_set in patch_sets)),
        "object_states": float(counts["states"]),
        "object_states_right_share": ratio(counts["right"], counts["known"]),
        "object_states_unknown_share": ratio(counts["states"] - counts["known"], counts["states"]),
        "object_states_in_view_unknown_share": ratio(counts["unknown_in_view"], counts["in_view"]),
    }
    return Score(name, 1.0, values)


def covered_cells(run: Run, truth: Truth, frame: GridFrame) -> dict[tuple[int, int], B1]:
    """For each thing and state, the cells (rows, cols) of a sub-map that beams truly hit it in, and those beside."""
    mine, theirs = same_scans(run.log.stamps_ns, truth)
    log, classes = run.log.select(mine), truth.beam_class[theirs]
    hit = (classes >= truth.first_object) & np.isfinite(log.ranges_m)
    row, col = frame.to_cells(end_points(log, run.poses[mine], hit)).T
    things = classes[hit] - truth.first_object
    states = truth.object_states[theirs[np.nonzero(hit)[0]], things]
    inside = (row >= 0) & (row < frame.rows) & (col >= 0) & (col < frame.cols)
    keys = np.column_stack([things, states])[inside]
    covers = {}
    for thing, state in np.unique(keys, axis=0).tolist():
        hits = np.zeros(frame.shape, dtype=np.int64)
        same = (keys == (thing, state)).all(axis=1)
        np.add.at(hits, (row[inside][same], col[inside][same]), 1)
        covers[thing, state] = ndimage.binary_dilation(hits >= _LEAST_HITS, np.ones((3, 3), dtype=bool))
    return covers


def cell_shares(thing: ChangingObject, covers: Mapping[tuple[int, int], B1], truth: Truth) -> list[F64]:
    """For each true thing the share of the cells of an object that each of its states covers."""
    return [
        np.array(
            [
                float(covers[number, state][thing.cells].mean()) if (number, state) in covers else 0.0
                for state in range(len(true.states))
            ]
        )
        for number, true in enumerate(truth.objects)
    ]


def _truly_on(visit: Visit, shares: Sequence[F64], truth: Truth) -> bool | None:
    """Whether an object was there in a visit; None where it changed, or cannot be said."""
    stamps = truth.trajectory.stamps_ns
    first = int(np.searchsorted(stamps, visit.start_ns))
    end = int(np.searchsorted(stamps, visit.end_ns, side="right"))
    rows = np.unique(truth.object_states[first:end], axis=0)
    largest = [max(share[state] for share, state in zip(shares, row, strict=True)) for row in rows.tolist()]
    if not largest:
        return None
    if min(largest) >= ON_SHARE:
        return True
    return False if max(largest) <= OFF_SHARE else None


def _crossed(run: Run, visit: Visit, frame: GridFrame) -> B1:
    """Cells (rows, cols) in which three beams of a visit ended, or which they crossed over that many cells' length."""
    stamps = run.log.stamps_ns
    scans = slice(
        int(np.searchsorted(stamps, visit.start_ns)), int(np.searchsorted(stamps, visit.end_ns, side="right"))
    )
    counts = count_beams(run.log.select(scans), run.poses[scans], frame, _RANGE_M)
    return np.asarray(counts.static_hits + counts.dynamic_hits + counts.passed_cells >= _LEAST_BEAMS)
