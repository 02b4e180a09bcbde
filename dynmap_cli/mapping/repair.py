"""Repair of a wrong map: loops that explain contradictions in free space are taken out, others are sought."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from itertools import groupby
from operator import itemgetter

import numpy as np
from scipy.sparse.csgraph import dijkstra

from dynmap_cli.arrays import F64
from dynmap_cli.mapping.loops import WINDOWS_M, Loop, LoopSearch, are_companions

_ATTEMPTS, _SUSPECTS = 6, 4
_REPAIR_FROM = 0.01
"""Share of contradicting places above which a repair is tried. Where a place changed, right maps have some, too;
there nothing makes them fewer, and nothing is kept."""
_REPAIR_FROM_PAIRS = 3
"""So many contradicting places are enough: one bent corridor is a small share of a large site."""

Solve = Callable[[Sequence[Loop], F64], F64]
"""Poses of the anchors (n_maps, 3) that loops lead to, from a start."""
State = tuple[F64, float, list[tuple[int, int]]]
"""Poses of the anchors, share of places that contradict each other there, and which pairs do."""


def repair(search: LoopSearch, poses: F64, solve: Solve, note: Callable[[str], None]) -> State:
    """Make contradictions fewer; a map that does not contradict itself is left as it is.

    Agreement among loops is no proof of a right map, but contradiction in free space is one of a wrong map. Either a
    loop is missing: contradicting places are searched again in growing windows. Or a loop is wrong: the groups of
    loops on the ways between contradicting places are left out in turn. What makes the contradictions fewer is kept.

    Parameters
    ----------
    search : LoopSearch
        Its loops are changed.
    poses : (n_maps, 3) float64
    solve : callable
    note : callable
        Told what was changed.

    Returns
    -------
    State
    """
    share, bad = search.contradictions(poses)
    for _ in range(_ATTEMPTS):
        if not _is_wrong(share, bad):
            break
        before = share
        poses, share, bad = _with_more(search, poses, share, bad, solve)
        if _is_wrong(share, bad):
            poses, share, bad = _with_fewer(search, poses, share, bad, solve)
        if share >= before:
            break
        note(f"repair: contradictions fell from {100 * before:.0f} to {100 * share:.0f} %")
    return poses, share, bad


def _is_wrong(share: float, bad: list[tuple[int, int]]) -> bool:
    """Whether places contradict each other so often that the map is to be repaired."""
    return share > _REPAIR_FROM or len(bad) >= _REPAIR_FROM_PAIRS


def _with_more(
    search: LoopSearch, poses: F64, share: float, bad: list[tuple[int, int]], solve: Solve
) -> State:
    """Search the contradicting pairs in growing windows."""
    for window_m in WINDOWS_M[1:]:
        old = list(search.loops)
        if search.retry(bad, poses, window_m) == 0:
            continue
        trial = solve(search.loops, poses)
        trial_share, trial_bad = search.contradictions(trial)
        if trial_share < share:
            return trial, trial_share, trial_bad
        search.loops = old
    return poses, share, bad


def _with_fewer(
    search: LoopSearch, poses: F64, share: float, bad: list[tuple[int, int]], solve: Solve
) -> State:
    """Leave out the group of loops without which the contradictions are fewest."""
    best, best_out = (poses, share, bad), []
    for group in _suspects(search, poses, bad)[:_SUSPECTS]:
        kept = [loop for loop in search.loops if loop not in group]
        trial = solve(kept, poses)
        trial_share, trial_bad = search.contradictions(trial)
        if trial_share < best[1]:
            best, best_out = (trial, trial_share, trial_bad), group
    for loop in best_out:
        search.loops.remove(loop)
        search.banned.add((loop.fixed, loop.moved))
        search.rejected[loop.fixed, loop.moved] = "contradicts free space"
    return best


def _suspects(search: LoopSearch, poses: F64, bad: list[tuple[int, int]]) -> list[list[Loop]]:
    """Groups of loops that say the same, those on most of the ways between contradicting places first."""
    blame = _blame(search, poses, bad)
    groups: list[list[Loop]] = []
    weights: list[int] = []
    for loop in sorted(
        search.loops, key=lambda loop: (-blame[loop.fixed, loop.moved], loop.fixed, loop.moved)
    ):
        if blame[loop.fixed, loop.moved] == 0 or any(loop in group for group in groups):
            continue
        group = _group(loop, search.loops, poses)
        groups.append(group)
        weights.append(sum(blame[one.fixed, one.moved] for one in group))
    return [groups[k] for k in np.argsort([-weight for weight in weights], kind="stable")]


def _group(seed: Loop, loops: Sequence[Loop], poses: F64) -> list[Loop]:
    """The loops that are joined to one by companions."""
    group, ends = [seed], [seed]
    while ends:
        end = ends.pop()
        are_new = are_companions(end, loops, poses)
        new = [loop for loop, is_new in zip(loops, are_new, strict=True) if is_new and loop not in group]
        group += new
        ends += new
    return group


def _blame(search: LoopSearch, poses: F64, bad: list[tuple[int, int]]) -> Counter[tuple[int, int]]:
    """On how many of the shortest ways between contradicting places each loop lies."""
    loops = {(loop.fixed, loop.moved) for loop in search.loops}
    blame: Counter[tuple[int, int]] = Counter()
    ways = search.ways(poses)
    for start, pairs in groupby(sorted(bad), key=itemgetter(0)):
        _, before = dijkstra(ways, directed=False, indices=start, return_predecessors=True)
        for _, end in pairs:
            here = end
            while here != start and before[here] >= 0:
                there = int(before[here])
                pair = (max(here, there), min(here, there))
                if pair in loops:
                    blame[pair] += 1
                here = there
    return blame
