"""The back end: key scans in a graph, loops in rounds until nothing new, then dense refinement."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from dynmap_cli.arrays import F64, I64
from dynmap_cli.counting.counts import Rays
from dynmap_cli.domain.poses import between, compose, wrap_angle
from dynmap_cli.kernels.local_maps import MATCHED, RESIDUAL, SEEN
from dynmap_cli.mapping.front_end import Registered, Sweeps
from dynmap_cli.mapping.local_maps import Easel, LocalMap, make_local_maps
from dynmap_cli.mapping.loops import MAX_ROUNDS, WINDOWS_M, LoopParams, LoopSearch
from dynmap_cli.mapping.pose_graph import CHAIN, DENSE, LOOP, Edges, join_edges, no_edges, optimise

_CHAIN_SCALE, _LOOP_SCALE, _DENSE_SCALE = 6.0, 4.0, 3.0
_CHAIN_SHIFT_M, _CHAIN_TURN_RAD = 0.008, 0.003
_LOOP_SHIFT_M, _LOOP_TURN_RAD = 0.02, 0.003
_DENSE_SHIFT_M, _DENSE_TURN_RAD = 0.01, 0.002
_RESIDUAL_M = 0.1
_DENSE_PARTNERS, _DENSE_REACH_M = 3, 6.0
_DENSE_ROUNDS = 2
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
    n_loops : int
    rejected : dict of str to int
        Loops that were tried and turned down, by reason.
    contradictions : float
        Share of pairs of nearby local maps that contradict each other in free space.
    """

    keys: I64
    poses: F64
    edges: Edges
    weights: F64
    n_loops: int = 0
    rejected: dict[str, int] = field(default_factory=dict)
    contradictions: float = 0.0


def close_loops(
    sweeps: Sweeps, rays: Rays, front: Registered, params: LoopParams, note: Callable[[str], None]
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
    """
    keys = np.nonzero(front.is_key)[0].astype(np.int64)
    poses = front.poses[keys]
    chain = _chain_edges(front, keys)
    if keys.size < 3:
        return Graph(keys, poses, chain, np.ones(len(chain)))
    maps = make_local_maps(sweeps, rays, front.twists, keys, poses)
    anchors = np.array([local_map.anchor for local_map in maps], dtype=np.int64)
    search = LoopSearch(maps, params)
    weights = np.ones(len(chain))
    edges = chain
    for number in range(MAX_ROUNDS):
        new = search.round(poses[anchors], WINDOWS_M[min(number, len(WINDOWS_M) - 1)])
        if new:
            edges = join_edges(chain, _loop_edges(search, anchors))
            poses, weights = optimise(poses, edges, _scales(edges))
            note(f"loop round {number + 1}: {new} new loops, {len(search.loops)} in all")
        elif number >= len(WINDOWS_M):
            break
    for _ in range(_DENSE_ROUNDS):
        maps = make_local_maps(sweeps, rays, front.twists, keys, poses)
        dense = _dense_edges(sweeps, rays, front.twists, keys, poses, maps, anchors)
        edges = join_edges(chain, _loop_edges(search, anchors), dense)
        poses, weights = optimise(poses, edges, _scales(edges), graduated=False)
    share, _ = search.contradictions(poses[anchors])
    return Graph(keys, poses, edges, weights, len(search.loops), dict(sorted(search.rejected.items())), share)


def spread_to_scans(front: Registered, graph: Graph) -> F64:
    """Poses of all scans: between two key scans the correction is interpolated.

    Returns
    -------
    (n_scans, 3) float64
    """
    scans = np.arange(front.poses.shape[0])
    before = np.clip(np.searchsorted(graph.keys, scans, side="right") - 1, 0, graph.keys.size - 1)
    after = np.minimum(before + 1, graph.keys.size - 1)
    from_before = compose(graph.poses[before], between(front.poses[graph.keys[before]], front.poses))
    from_after = compose(graph.poses[after], between(front.poses[graph.keys[after]], front.poses))
    span = np.maximum(graph.keys[after] - graph.keys[before], 1)
    share = ((scans - graph.keys[before]) / span)[:, None]
    share[before == after] = 0.0
    delta = from_after - from_before
    delta[:, 2] = wrap_angle(delta[:, 2])
    result = from_before + share * delta
    result[:, 2] = wrap_angle(result[:, 2])
    return np.asarray(result)


def _scales(edges: Edges) -> F64:
    """Scale of the robust kernel of each edge, standard deviations."""
    return np.array([_CHAIN_SCALE, _LOOP_SCALE, _DENSE_SCALE])[edges.kind]


def _chain_edges(front: Registered, keys: I64) -> Edges:
    """Consecutive key scans; directions that the match does not know are left to the odometry in it."""
    measured = between(front.poses[keys[:-1]], front.poses[keys[1:]])
    shift = np.linalg.norm(measured[:, :2], axis=1)
    sigma_shift = _CHAIN_SHIFT_M + 0.02 * shift
    sigma_turn = _CHAIN_TURN_RAD + 0.01 * np.abs(measured[:, 2])
    information = np.zeros((keys.size - 1, 3, 3))
    information[:, 0, 0] = information[:, 1, 1] = 1.0 / sigma_shift**2
    information[:, 2, 2] = 1.0 / sigma_turn**2
    numbers = np.arange(keys.size - 1, dtype=np.int64)
    kind = np.full(keys.size - 1, CHAIN, dtype=np.uint8)
    return Edges(numbers, numbers + 1, measured, information, kind)


def _loop_edges(search: LoopSearch, anchors: I64) -> Edges:
    """Loops as edges between the anchors of their maps."""
    if not search.loops:
        return no_edges()
    fits = [loop.fit for loop in search.loops]
    return Edges(
        anchors[[loop.fixed for loop in search.loops]],
        anchors[[loop.moved for loop in search.loops]],
        np.array([fit.pose for fit in fits]),
        _capped(np.array([fit.information for fit in fits]) / _RESIDUAL_M**2, _LOOP_SHIFT_M, _LOOP_TURN_RAD),
        np.full(len(fits), LOOP, dtype=np.uint8),
    )


def _capped(information: F64, shift_m: float, turn_rad: float) -> F64:
    """(m, 3, 3) information whose covariance is that of the fit plus the given standard deviations."""
    covariance = np.linalg.inv(information + 1e-3 * np.eye(3))
    return np.asarray(np.linalg.inv(covariance + np.diag([shift_m**2, shift_m**2, turn_rad**2])))


def _dense_edges(
    sweeps: Sweeps, rays: Rays, twists: F64, keys: I64, poses: F64, maps: list[LocalMap], anchors: I64
) -> Edges:
    """Each key scan fitted on the local maps around it, of this pass and of others."""
    easel = Easel()
    parts = [no_edges()]
    for number, nodes in enumerate(_dense_pairs(poses, anchors)):
        if nodes.size == 0:
            continue
        easel.draw(maps[number])
        starts = between(poses[anchors[number]], poses[nodes])
        fitted, information, judged = easel.fit_scans(sweeps, rays, twists, keys[nodes], starts)
        seen = judged[:, SEEN]
        good = (
            (seen >= _DENSE_MIN_SEEN)
            & (judged[:, MATCHED] >= _DENSE_MIN_MATCHED * seen)
            & (judged[:, RESIDUAL] <= _DENSE_MAX_RESIDUAL_M)
        )
        count = int(good.sum())
        parts.append(
            Edges(
                np.full(count, anchors[number]),
                nodes[good],
                fitted[good],
                _capped(information[good] / _RESIDUAL_M**2, _DENSE_SHIFT_M, _DENSE_TURN_RAD),
                np.full(count, DENSE, dtype=np.uint8),
            )
        )
    return join_edges(*parts)


def _dense_pairs(poses: F64, anchors: I64) -> list[I64]:
    """For each local map the key scans that are to be fitted on it: per key scan the nearest maps of each pass."""
    pairs: list[list[int]] = [[] for _ in anchors]
    tree = cKDTree(poses[anchors, :2])
    n_nearest = min(8 * _DENSE_PARTNERS, anchors.size)
    _, nearest = tree.query(poses[:, :2], k=[*range(1, n_nearest + 1)], distance_upper_bound=_DENSE_REACH_M)
    for node, candidates in enumerate(nearest.tolist()):
        chosen: list[int] = []
        for number in candidates:
            if number == anchors.size or len(chosen) == _DENSE_PARTNERS:
                break
            if anchors[number] != node and all(abs(number - other) > 2 for other in chosen):
                chosen.append(number)
        for number in chosen:
            pairs[number].append(node)
    return [np.array(nodes, dtype=np.int64) for nodes in pairs]
