"""Loop closing: local map against local map in growing windows, judged by companions and by free space."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from dynmap_cli.arrays import B1, F64, I32, I64
from dynmap_cli.domain.poses import between, compose, inverse, wrap_angle
from dynmap_cli.mapping.local_maps import Easel, Fit, LocalMaps
from dynmap_cli.mapping.places import SAME_VISIT, representatives

WINDOWS_M = (1.0, 3.0, 8.0, 12.0)
_WEAK_SHARE = 0.03
MAX_ROUNDS = 9
_NEIGHBOURS = 4
_RETRY_TURN_RAD = 0.35
_TURN_RAD, _TURN_RADPM, _MAX_TURN_RAD = 0.015, 0.002, 0.7
_SOURCES = 64


@dataclass(frozen=True, slots=True)
class LoopParams:
    """What is asked of a loop.

    Attributes
    ----------
    min_seen, min_matched_of_seen, max_in_free : float
        Shares of the points, see `Fit`.
    max_residual_m : float
    margin : float
        The second best place, relative to the best, must match less than this.
    overlap_m : float
        Anchors farther apart than this (plus the window) are not tried.
    min_detour_m : float
        Nor are those that the graph connects on a shorter way.
    n_partners : int
        Partners of a map in a round.
    drift_share : float
        How fast the uncertainty grows with the way through the graph.
    """

    min_seen: float = 0.3
    min_matched_of_seen: float = 0.7
    max_in_free: float = 0.12
    max_residual_m: float = 0.035
    margin: float = 0.9
    overlap_m: float = 4.0
    min_detour_m: float = 10.0
    n_partners: int = 3
    drift_share: float = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Loop:
    """One map fitted on another.

    Attributes
    ----------
    fixed, moved : int
        Numbers of the local maps.
    fit : Fit
        fixed_from_moved, with its evidence.
    shift_m, turn_rad : float
        How far it is from what the graph said when it was found.
    """

    fixed: int
    moved: int
    fit: Fit
    shift_m: float
    turn_rad: float


@dataclass(slots=True)
class LoopSearch:
    """The search for loops over several rounds.

    Attributes
    ----------
    maps : LocalMaps
    params : LoopParams
    loops : list of Loop
        Accepted so far.
    rejected : dict of (int, int) to str
        Why the last try of a pair (fixed, moved) failed.
    banned : set of (int, int)
        Pairs that are not tried again.
    drives : (n_maps,) int32
        Which drive each map is of, ascending. Where there are several, only pairs of different drives are tried.
    """

    maps: LocalMaps
    params: LoopParams
    drives: I32
    loops: list[Loop] = field(default_factory=list)
    rejected: dict[tuple[int, int], str] = field(default_factory=dict)
    banned: set[tuple[int, int]] = field(default_factory=set)
    _tried: dict[tuple[int, int], tuple[float, F64]] = field(default_factory=dict)
    _easel: Easel = field(default_factory=Easel)

    def round(self, poses: F64, window_m: float) -> int:
        """Try all promising pairs within a window; returns how many loops are new.

        Parameters
        ----------
        poses : (n_maps, 3) float64
            map_from_anchor of the local maps, as the graph has them now.
        window_m : float
        """
        found: list[Loop] = []
        pairs, detours = self._partners(poses, window_m)
        reaches = np.clip(2.5 * (0.05 + self.params.drift_share * detours), 0.4, window_m).tolist()
        turns = np.clip(2.5 * (_TURN_RAD + _TURN_RADPM * detours), 0.06, _MAX_TURN_RAD).tolist()
        guesses = between(poses[pairs[:, 0]], poses[pairs[:, 1]])
        for (fixed, moved), guess, reach, turn in zip(pairs.tolist(), guesses, reaches, turns, strict=True):
            if (fixed, moved) in self.banned or self._was_tried(fixed, moved, reach, guess):
                continue
            self._tried[fixed, moved] = (reach, guess)
            loop = self._try(fixed, moved, guess, reach, turn)
            if loop is not None:
                found.append(loop)
        return self._accept(found, poses)

    def retry(self, pairs: list[tuple[int, int]], poses: F64, window_m: float) -> int:
        """Try given pairs within a window whatever the graph says about it; returns how many loops are new."""
        found = []
        closed = {(loop.fixed, loop.moved) for loop in self.loops}
        for fixed, moved in sorted({(max(pair), min(pair)) for pair in pairs} - self.banned - closed):
            guess = between(poses[fixed], poses[moved])
            loop = self._try(fixed, moved, guess, window_m, _RETRY_TURN_RAD)
            if loop is not None:
                found.append(loop)
        return self._accept(found, poses)

    def _accept(self, found: list[Loop], poses: F64) -> int:
        """Keep loops that hold both ways and have companions."""
        found = self._both_ways(found)
        accepted = []
        near = _NearLoops((*self.loops, *found))
        for loop in found:
            if self._has_companions(loop, near, poses):
                accepted.append(loop)
            else:
                self._reject(loop.fixed, loop.moved, "no companion")
                self._tried.pop((loop.fixed, loop.moved), None)
        self.loops += accepted
        return len(accepted)

    def contradictions(self, poses: F64) -> tuple[float, list[tuple[int, int]]]:
        """Share of pairs of nearby maps with a quarter of one's points in the other's free space, and these pairs."""
        bad: list[tuple[int, int]] = []
        n_pairs = 0
        shown = representatives(poses)
        around = cKDTree(poses[shown, :2]).query_ball_point(
            poses[:, :2], self.params.overlap_m, return_sorted=True
        )
        for fixed in range(len(self.maps)):
            near = shown[around[fixed]]
            near = near[np.abs(near - fixed) > SAME_VISIT]
            if near.size == 0:
                continue
            self._easel.draw(self.maps[fixed])
            chosen = near[:: max(1, near.size // 4)]
            for moved, pose in zip(chosen, between(poses[fixed], poses[chosen]), strict=True):
                n_pairs += 1
                fit = self._easel.judge(self.maps[moved], pose)
                if fit.in_free > 0.25:
                    bad.append((fixed, int(moved)))
        return len(bad) / max(n_pairs, 1), bad

    def _reject(self, fixed: int, moved: int, reason: str) -> None:
        self.rejected[fixed, moved] = reason

    def _was_tried(self, fixed: int, moved: int, reach: float, guess: F64) -> bool:
        """Whether this pair was searched before from nearly the same guess with the same reach."""
        before = self._tried.get((fixed, moved))
        if before is None:
            return False
        shift = float(np.linalg.norm(before[1][:2] - guess[:2]))
        turn = abs(float(wrap_angle(before[1][2] - guess[2])))
        return reach <= before[0] + 0.2 and shift < 0.25 * before[0] and turn < 0.05

    def ways(self, poses: F64) -> sparse.csr_matrix:
        """(n_maps, n_maps) lengths of the steps through the graph of the anchors; loops are short cuts."""
        n_maps = len(self.maps)
        steps = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1) + 0.3 * np.abs(
            wrap_angle(np.diff(poses[:, 2]))
        )
        within = np.flatnonzero(np.diff(self.drives) == 0)
        first = [*within.tolist(), *(loop.fixed for loop in self.loops)]
        second = [*(within + 1).tolist(), *(loop.moved for loop in self.loops)]
        lengths = np.concatenate([steps[within] + 0.2, np.full(len(self.loops), 1.0)])
        return sparse.coo_matrix((lengths, (first, second)), shape=(n_maps, n_maps)).tocsr()

    def _partners(self, poses: F64, window_m: float) -> tuple[I64, F64]:
        """Pairs that may show the same place: near, far through the graph, spread over visits.

        Returns
        -------
        pairs : (n, 2) int64
            Number of a map and of an earlier one that stands for a place.
        detours : (n,) float64
            Ways between them through the graph; inf = so long that windows no longer grow with it.
        """
        share = 2.5 * self.params.drift_share
        limit = max(window_m / share, (_MAX_TURN_RAD / 2.5 - _TURN_RAD) / _TURN_RADPM)
        ways, numbers = self.ways(poses), np.arange(len(self.maps))
        found = []
        shown = representatives(poses)
        for part in np.array_split(shown, -(-shown.size // _SOURCES)):
            detours = np.asarray(dijkstra(ways, directed=False, indices=part, limit=limit))
            distance = np.hypot(*(poses[:, axis] - poses[part, axis, None] for axis in (0, 1)))
            allowed = distance < self.params.overlap_m + np.minimum(share * detours, window_m)
            allowed &= numbers > part[:, None]
            if self.drives[-1] == 0:
                allowed &= detours > self.params.min_detour_m
            else:
                allowed &= self.drives != self.drives[part, None]
            row, fixed = np.nonzero(allowed)
            found.append((fixed, part[row], distance[allowed], detours[allowed]))
        fixed, moved, distance, detour = (np.concatenate(parts) for parts in zip(*found, strict=True))
        order = np.lexsort((moved, distance, fixed))
        fixed, moved = fixed[order], moved[order]
        chosen = self._spread_over_visits(fixed.tolist(), moved.tolist())
        return np.column_stack([fixed[chosen], moved[chosen]]), detour[order][chosen]

    def _spread_over_visits(self, fixed: list[int], moved: list[int]) -> list[int]:
        """Rows of the first partners of each map, no two of the same visit; the rows of a map stand together."""
        chosen: list[int] = []
        partners: list[int] = []
        before = -1
        for row, (number, other) in enumerate(zip(fixed, moved, strict=True)):
            if number != before:
                before, partners = number, []
            if len(partners) < self.params.n_partners and all(
                abs(other - one) > SAME_VISIT for one in partners
            ):
                partners.append(other)
                chosen.append(row)
        return chosen

    def _try(self, fixed: int, moved: int, guess: F64, reach_m: float, turn_rad: float) -> Loop | None:
        """Search one pair; the best place has to fit, and to be the only one."""
        self._easel.draw(self.maps[fixed])
        fits = self._easel.search(self.maps[moved], guess, reach_m, turn_rad)
        if not fits:
            return None
        best = fits[0]
        reason = why_not(best, self.params)
        if reason:
            self._reject(fixed, moved, reason)
            return None
        others = [fit for fit in fits[1:] if fit.matched > self.params.margin * best.matched]
        others = [fit for fit in others if _far_apart(fit.pose, best.pose)]
        if others:
            unambiguous = _without_ambiguous_direction(best, others)
            if unambiguous is None:
                self._reject(fixed, moved, "not unique")
                return None
            best = unambiguous
        best = _without_weak_direction(best)
        error = between(guess, best.pose)
        return Loop(fixed, moved, best, float(np.hypot(error[0], error[1])), abs(float(error[2])))

    def _both_ways(self, found: list[Loop]) -> list[Loop]:
        """Keep loops for which the fixed map does not stand in the moved one's free space either."""
        kept = []
        for loop in sorted(found, key=lambda loop: (loop.moved, loop.fixed)):
            self._easel.draw(self.maps[loop.moved])
            back = self._easel.judge(self.maps[loop.fixed], inverse(loop.fit.pose))
            if (
                back.in_free > self.params.max_in_free
                or back.matched_of_seen < self.params.min_matched_of_seen
            ):
                self._reject(loop.fixed, loop.moved, "points in free space")
            else:
                kept.append(loop)
        return kept

    def _has_companions(self, loop: Loop, near: _NearLoops, poses: F64) -> bool:
        """Whether enough neighbouring loops say the same: none for small shifts, one or two for large ones."""
        needed = 0 if loop.shift_m < 0.5 else 1 if loop.shift_m < 2.0 else 2
        if needed == 0:
            return True
        return int(are_companions(loop, list(near.around(loop)), poses).sum()) >= needed


def why_not(fit: Fit, params: LoopParams) -> str:
    """What speaks against a fit; "" = nothing."""
    if fit.seen < params.min_seen:
        return "too little overlap"
    if fit.matched_of_seen < params.min_matched_of_seen:
        return "too few points match"
    if fit.in_free > params.max_in_free:
        return "points in free space"
    if fit.residual_m > params.max_residual_m:
        return "residual too large"
    return ""


class _NearLoops:
    """Loops sorted by the maps they join, so that the neighbours of one are found without looking at all."""

    def __init__(self, loops: Sequence[Loop]) -> None:
        self._blocks: dict[tuple[int, int], list[Loop]] = {}
        for loop in loops:
            self._blocks.setdefault(self._block(loop), []).append(loop)

    @staticmethod
    def _block(loop: Loop) -> tuple[int, int]:
        return loop.fixed // (_NEIGHBOURS + 1), loop.moved // (_NEIGHBOURS + 1)

    def around(self, loop: Loop) -> Iterator[Loop]:
        """All loops whose maps are neighbours of its maps, and some more."""
        row, col = self._block(loop)
        for block in product((row - 1, row, row + 1), (col - 1, col, col + 1)):
            yield from self._blocks.get(block, ())


def are_companions(loop: Loop, others: Sequence[Loop], poses: F64) -> B1:
    """(n_others,) which other loops join neighbours of the same maps in the same way."""
    if not others:
        return np.zeros(0, dtype=bool)
    fixed, moved = np.array([(other.fixed, other.moved) for other in others]).T
    way = compose(between(poses[loop.fixed], poses[fixed]), np.array([other.fit.pose for other in others]))
    way = compose(way, between(poses[moved], poses[loop.moved]))
    error = between(way, loop.fit.pose)
    is_other = np.array([other is not loop for other in others])
    are_neighbours = np.maximum(np.abs(fixed - loop.fixed), np.abs(moved - loop.moved)) <= _NEIGHBOURS
    agree = (np.hypot(error[:, 0], error[:, 1]) < 0.4) & (np.abs(error[:, 2]) < 0.07)
    return np.asarray(is_other & are_neighbours & agree)


def _far_apart(a: F64, b: F64) -> bool:
    """Whether two fits are different places."""
    shift = float(np.linalg.norm(a[:2] - b[:2]))
    return shift > 0.3 or abs(float(wrap_angle(a[2] - b[2]))) > 0.1


def _without_ambiguous_direction(best: Fit, others: list[Fit]) -> Fit | None:
    """Take away what a fit says along the line on which other places fit as well; None if they lie elsewhere."""
    shifts = np.array([other.pose[:2] - best.pose[:2] for other in others])
    turns = np.array([abs(float(wrap_angle(other.pose[2] - best.pose[2]))) for other in others])
    if float(turns.max()) > 0.1:
        return None
    _, _, directions = np.linalg.svd(shifts, full_matrices=False)
    along = directions[0]
    if float(np.abs(shifts @ np.array([-along[1], along[0]])).max()) > 0.3:
        return None
    return _without(best, along)


def _without_weak_direction(fit: Fit) -> Fit:
    """Take away what a fit says along bare walls: there only the noise of their normals speaks, and wrongly."""
    strengths, directions = np.linalg.eigh(fit.information[:2, :2])
    return fit if strengths[0] >= _WEAK_SHARE * strengths[1] else _without(fit, directions[:, 0])


def _without(fit: Fit, along: F64) -> Fit:
    """The fit without information on the shift along a unit vector."""
    keep = np.eye(3)
    keep[:2, :2] -= np.outer(along, along)
    return replace(fit, information=keep @ fit.information @ keep)
