"""The back end: key scans in a graph, loops in rounds until nothing new, then dense refinement."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial import cKDTree

from dynmap_cli.arrays import F64, I32, I64
from dynmap_cli.domain.poses import between, compose, wrap_angle
from dynmap_cli.kernels.beams import Rays
from dynmap_cli.kernels.map_fits import MATCHED, RESIDUAL, SEEN
from dynmap_cli.mapping.edges import (
    RESIDUAL_M,
    anchor_chain,
    capped,
    chain_edges,
    loop_edges,
    placed_edges,
    scales,
)
from dynmap_cli.mapping.local_maps import Easel, LocalMaps, anchors_of, make_local_maps
from dynmap_cli.mapping.loops import MAX_ROUNDS, WINDOWS_M, Loop, LoopParams, LoopSearch
from dynmap_cli.mapping.places import SAME_VISIT, representatives
from dynmap_cli.mapping.pose_graph import CHAIN, DENSE, Edges, join_edges, no_edges, optimise, robust_cost
from dynmap_cli.mapping.repair import State, repair
from dynmap_cli.scan_matching.front_end import Registered
from dynmap_cli.scan_matching.sweeps import Sweeps

_DENSE_SHIFT_M, _DENSE_TURN_RAD = 0.01, 0.002
_PLACED_WINDOW_M = 2.0
_DENSE_PARTNERS, _DENSE_REACH_M = 3, 6.0
_DENSE_STEPS = 6
_POSES_AT_ONCE, _KEYS_AT_ONCE = 1 << 16, 1 << 12
_DENSE_MIN_SEEN, _DENSE_MIN_MATCHED, _DENSE_MAX_RESIDUAL_M = 0.3, 0.6, 0.05


@dataclass(frozen=True, slots=True)
class Graph:
    """The optimised graph of key scans.

    Attributes
    ----------
    keys : (n_keys,) int64
        Scan numbers of the nodes.
    poses : (n_keys, 3) float64
    edges : Edges
    weights : (n_edges,) float64
        Robust weight of each edge, 0 to 1.
    loops : tuple of Loop
        Between local maps, accepted.
    anchors : (n_maps,) int64
        Nodes that stand for the local maps.
    rejected : dict of (int, int) to str
        Pairs of local maps that were tried and turned down, and why.
    contradictions : float
        Share of pairs of nearby local maps that contradict each other in free space.
    contradicting : tuple of (int, int)
        These pairs.
    """

    keys: I64
    poses: F64
    edges: Edges
    weights: F64
    loops: tuple[Loop, ...] = ()
    anchors: I64 = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    rejected: dict[tuple[int, int], str] = field(default_factory=dict)
    contradictions: float = 0.0
    contradicting: tuple[tuple[int, int], ...] = ()

    def without_edges(self) -> Graph:
        """The same with no edges."""
        return replace(self, edges=no_edges(), weights=np.zeros(0))


@dataclass(frozen=True, slots=True)
class Known:
    """What is known of several drives before loops between them are sought.

    Attributes
    ----------
    key_poses : (n_keys, 3) float64
        map_from_robot of the key scans of all drives.
    loops : tuple of Loop
        Within the drives.
    rejected : dict of (int, int) to str
    pairs : tuple of (int, int)
        Local maps of different drives that probably show the same place.
    """

    key_poses: F64
    loops: tuple[Loop, ...]
    rejected: dict[tuple[int, int], str]
    pairs: tuple[tuple[int, int], ...]


def close_loops(
    sweeps: Sweeps,
    rays: Rays,
    front: Registered,
    params: LoopParams,
    note: Callable[[str], None],
    known: Known | None = None,
) -> Graph:
    """Build the graph of the key scans, find loops, and optimise.

    Parameters
    ----------
    sweeps : Sweeps
    rays : Rays
    front : Registered
        Result of the front end.
    params : LoopParams
    note : callable
        Told what was found, one sentence at a time.
    known : Known, optional
        Where the sweeps are of several drives.
    """
    keys = np.nonzero(front.is_key)[0].astype(np.int64)
    drives = sweeps.drive_index[keys]
    known = known or Known(front.poses[keys], (), {}, ())
    if keys.size < 3:
        chain = chain_edges(front.poses[keys], drives)
        return Graph(keys, front.poses[keys], chain, np.ones(len(chain)))
    maps = make_local_maps(sweeps, rays, front.twists, keys, front.poses[keys])
    anchors = anchors_of(maps)
    search = LoopSearch(maps, params, drives[anchors], list(known.loops), dict(known.rejected))
    fixed_edges = join_edges(
        anchor_chain(front.poses[keys], anchors, drives),
        placed_edges(known.key_poses[anchors], np.arange(anchors.size), drives[anchors]),
    )
    search.retry(list(known.pairs), known.key_poses[anchors], _PLACED_WINDOW_M)
    anchor_poses, contradictions, contradicting = _close_rounds(
        search, known.key_poses[anchors], fixed_edges, note
    )
    poses = _spread(anchors, anchor_poses, front.poses[keys], drives)
    closed = {(loop.fixed, loop.moved) for loop in search.loops}
    graph = Graph(
        keys,
        poses,
        no_edges(),
        np.zeros(0),
        tuple(search.loops),
        anchors,
        {pair: reason for pair, reason in sorted(search.rejected.items()) if pair not in closed},
        contradictions,
        tuple(contradicting),
    )
    return refine_graph(sweeps, rays, front, graph, maps)


def refine_graph(
    sweeps: Sweeps, rays: Rays, front: Registered, graph: Graph, maps: LocalMaps | None = None
) -> Graph:
    """Fit each key scan on the local maps around it, and optimise (dense refinement).

    Parameters
    ----------
    sweeps, rays, front
        As for `close_loops`; the beams may have other weights than when the loops were found.
    graph : Graph
    maps : LocalMaps, optional
        Made with these weights and nearly these poses; drawn anew without them.
    """
    keys = graph.keys
    if keys.size < 3:
        return graph
    maps = maps or make_local_maps(sweeps, rays, front.twists, keys, graph.poses)
    anchors = anchors_of(maps)
    dense = _dense_edges(sweeps, rays, front.twists, keys, graph.poses, maps, anchors)
    drives = sweeps.drive_index[keys]
    edges = join_edges(
        chain_edges(front.poses[keys], drives),
        loop_edges(graph.loops, anchors),
        dense,
        placed_edges(graph.poses, anchors, drives),
    )
    poses, weights = optimise(graph.poses, edges, scales(edges), graduated=False, rounds=_DENSE_STEPS)
    return replace(graph, poses=poses, edges=edges, weights=weights)


def spread_to_scans(front: Registered, graph: Graph, drive_index: I32) -> F64:
    """Poses of all scans (n_scans, 3): between two key scans of a drive the correction is interpolated."""
    return _spread(graph.keys, graph.poses, front.poses, drive_index)


def _close_rounds(search: LoopSearch, poses: F64, fixed_edges: Edges, note: Callable[[str], None]) -> State:
    """Search loops in growing windows until nothing is new, and repair what contradicts itself then."""
    numbers = np.arange(poses.shape[0])

    def solve(loops: Sequence[Loop], start: F64) -> F64:
        return _solved(start, join_edges(fixed_edges, loop_edges(loops, numbers)))

    def until_nothing_new(poses: F64) -> F64:
        for number in range(MAX_ROUNDS):
            new = search.round(poses, WINDOWS_M[min(number, len(WINDOWS_M) - 1)])
            if new:
                poses = solve(search.loops, poses)
                note(f"loop round {number + 1}: {new} new loops, {len(search.loops)} in all")
            elif number >= len(WINDOWS_M):
                break
        return poses

    start = solve(search.loops, poses) if search.loops else poses
    return repair(search, until_nothing_new(start), solve, note)


def _solved(start: F64, edges: Edges) -> F64:
    """Poses of the nodes: the cheaper of two minima.

    A few wrong loops can tear a chain that is right before they lose their weight; and a chain that is torn indeed
    (a wheel slipped where scans match anything) bends what is right as long as it has to hold. So the chain may tear
    from the start in one of them, and only after the loops have been judged in the other.
    """
    own = scales(edges)
    firm = np.where(edges.kind == CHAIN, np.inf, own)
    torn, _ = optimise(start, edges, own)
    held, _ = optimise(start, edges, firm)
    held, _ = optimise(held, edges, own, graduated=False)
    return min(torn, held, key=lambda poses: robust_cost(poses, edges, own))


def _spread(nodes: I64, node_poses: F64, poses: F64, drives: I32) -> F64:
    """Carry the correction of some poses over to those between them, interpolated within each drive.

    Parameters
    ----------
    nodes : (n,) int64
        Ascending rows of *poses* whose corrected pose is known.
    node_poses : (n, 3) float64
    poses : (m, 3) float64
    drives : (m,) int32
        Ascending.
    """
    ends = np.searchsorted(drives, np.unique(drives), side="right")
    parts = []
    first = 0
    for last in ends.tolist():
        own = slice(*np.searchsorted(nodes, (first, last)).tolist())
        parts.append(_spread_one(nodes[own] - first, node_poses[own], poses[first:last]))
        first = last
    return np.concatenate(parts)


def _spread_one(nodes: I64, node_poses: F64, poses: F64) -> F64:
    """`_spread` of one drive; some poses at a time, as a long recording has millions."""
    result = np.empty(poses.shape)
    for first in range(0, poses.shape[0], _POSES_AT_ONCE):
        rows = np.arange(first, min(first + _POSES_AT_ONCE, poses.shape[0]))
        result[rows] = _spread_to(rows, nodes, node_poses, poses)
    return result


def _spread_to(rows: I64, nodes: I64, node_poses: F64, poses: F64) -> F64:
    """`_spread` of one drive to some of its poses."""
    before = np.clip(np.searchsorted(nodes, rows, side="right") - 1, 0, nodes.size - 1)
    after = np.minimum(before + 1, nodes.size - 1)
    from_before = compose(node_poses[before], between(poses[nodes[before]], poses[rows]))
    from_after = compose(node_poses[after], between(poses[nodes[after]], poses[rows]))
    span = np.maximum(nodes[after] - nodes[before], 1)
    share = np.clip((rows - nodes[before]) / span, 0.0, 1.0)[:, None]
    share[before == after] = 0.0
    delta = from_after - from_before
    delta[:, 2] = wrap_angle(delta[:, 2])
    result = from_before + share * delta
    result[:, 2] = wrap_angle(result[:, 2])
    return np.asarray(result)


def _dense_edges(
    sweeps: Sweeps, rays: Rays, twists: F64, keys: I64, poses: F64, maps: LocalMaps, anchors: I64
) -> Edges:
    """Each key scan fitted on the local maps around it, of this pass and of others."""
    easel = Easel()
    pairs = _dense_pairs(poses, anchors)
    second = np.concatenate(pairs)
    first = np.repeat(anchors, [nodes.size for nodes in pairs])
    starts = between(poses[first], poses[second])
    fitted, information = starts.copy(), np.zeros((second.size, 3, 3))
    judged = np.zeros((second.size, 4))
    end = 0
    for number, nodes in enumerate(pairs):
        begin, end = end, end + nodes.size
        if nodes.size:
            part = slice(begin, end)
            easel.draw(maps[number])
            fitted[part], information[part], judged[part] = easel.fit_scans(
                sweeps, rays, twists, keys[nodes], starts[part]
            )
    seen = judged[:, SEEN]
    good = (
        (seen >= _DENSE_MIN_SEEN)
        & (judged[:, MATCHED] >= _DENSE_MIN_MATCHED * seen)
        & (judged[:, RESIDUAL] <= _DENSE_MAX_RESIDUAL_M)
    )
    return Edges(
        first[good],
        second[good],
        fitted[good],
        capped(information[good] / RESIDUAL_M**2, _DENSE_SHIFT_M, _DENSE_TURN_RAD),
        np.full(int(good.sum()), DENSE, dtype=np.uint8),
    )


def _dense_pairs(poses: F64, anchors: I64) -> list[I64]:
    """For each local map the key scans that are to be fitted on it.

    Those are, for a key scan, its own map, the maps before and after it that it is no part of, the nearest of those
    that stand for the place, and the nearest of all others, each of another visit. The front end is a filter: it fits
    a scan on those before it alone, and what is wrong there at first stays in the path. With the maps before and after,
    the graph becomes a smoother (Lu and Milios, 1997).
    """
    own = np.searchsorted((anchors[1:] + anchors[:-1]) / 2, np.arange(poses.shape[0]))
    around = own[:, None] + np.array([-SAME_VISIT, SAME_VISIT])
    there = np.clip(around, 0, anchors.size - 1)
    distance = np.linalg.norm(poses[anchors[there], :2] - poses[:, None, :2], axis=2)
    around[(around != there) | (distance > _DENSE_REACH_M)] = -1
    standing = _nearest(poses, anchors, representatives(poses[anchors]))
    others = _nearest(poses, anchors, np.arange(anchors.size))
    pairs: list[list[int]] = [[] for _ in anchors]
    # Row by row, as lists of all of them would take a kilobyte for each key scan.
    rows = (map(np.ndarray.tolist, numbers) for numbers in (standing, others))
    for node, (here, *candidates) in enumerate(zip(own.tolist(), *rows, strict=True)):
        apart = [here]
        for n_wanted, numbers in ((2, candidates[0]), (_DENSE_PARTNERS, candidates[1])):
            for number in numbers:
                if number < 0 or len(apart) == n_wanted:
                    break
                if all(abs(number - other) > SAME_VISIT for other in apart):
                    apart.append(number)
        for number in (*apart, *around[node].tolist()):
            if number >= 0 and anchors[number] != node:
                pairs[number].append(node)
    return [np.array(nodes, dtype=np.int64) for nodes in pairs]


def _nearest(poses: F64, anchors: I64, numbers: I64) -> I32:
    """For each key scan those of some local maps that are within reach (n, k), nearest first; -1 = no more."""
    k = min(8 * _DENSE_PARTNERS, numbers.size)
    tree = cKDTree(poses[anchors[numbers], :2])
    found, numbers = np.empty((poses.shape[0], k), dtype=np.int32), np.append(numbers, -1)
    for first in range(0, poses.shape[0], _KEYS_AT_ONCE):
        part = slice(first, first + _KEYS_AT_ONCE)
        _, rows = tree.query(poses[part, :2], k=[*range(1, k + 1)], distance_upper_bound=_DENSE_REACH_M)
        found[part] = numbers[rows]
    return found
