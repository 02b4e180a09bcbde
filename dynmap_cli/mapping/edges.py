"""Edges of the pose graph: what consecutive key scans, loops and drives say, and how far each is believed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynmap_cli.arrays import F64, I32, I64
from dynmap_cli.domain.poses import between
from dynmap_cli.mapping.loops import Loop
from dynmap_cli.mapping.pose_graph import CHAIN, LOOP, PLACED, Edges, no_edges

_CHAIN_SCALE, _LOOP_SCALE, _DENSE_SCALE = 6.0, 4.0, 3.0
_CHAIN_SHIFT_M, _CHAIN_TURN_RAD = 0.008, 0.003
_LOOP_SHIFT_M, _LOOP_TURN_RAD = 0.02, 0.003
_PLACED_SHIFT_M, _PLACED_TURN_RAD = 1.0, 0.1
RESIDUAL_M = 0.1
"""Standard deviation of a point across its line, as large as it is because neighbouring points err together."""


def scales(edges: Edges) -> F64:
    """Scale of the robust kernel of each edge, standard deviations."""
    return np.array([_CHAIN_SCALE, _LOOP_SCALE, _DENSE_SCALE, np.inf])[edges.kind]


def chain_edges(key_poses: F64, drives: I32) -> Edges:
    """Consecutive key scans of a drive, as the front end saw them."""
    measured, sigma_shift, sigma_turn = _chain_steps(key_poses)
    return _chain(measured, _diagonal(sigma_shift, sigma_turn), drives)


def _chain(measured: F64, information: F64, drives: I32) -> Edges:
    """Edges between consecutive nodes, without those from one drive to the next."""
    within = np.flatnonzero(np.diff(drives) == 0).astype(np.int64)
    kind = np.full(within.size, CHAIN, dtype=np.uint8)
    return Edges(within, within + 1, measured[within], information[within], kind)


def placed_edges(poses: F64, nodes: I64, drives: I32) -> Edges:
    """From the first node of the first drive to that of each other: they hold together what loops do not.

    Parameters
    ----------
    poses : (n, 3) float64
    nodes : (k,) int64
        Ascending; those that stand for the local maps.
    drives : (n,) int32
        Ascending.
    """
    _, first = np.unique(drives[nodes], return_index=True)
    ends = nodes[first]
    others = ends[1:]
    start = np.full(others.size, ends[0], dtype=np.int64)
    sigma = np.full(others.size, 1.0)
    information = _diagonal(_PLACED_SHIFT_M * sigma, _PLACED_TURN_RAD * sigma)
    measured = between(poses[start], poses[others])
    return Edges(start, others, measured, information, np.full(others.size, PLACED, dtype=np.uint8))


def anchor_chain(key_poses: F64, anchors: I64, drives: I32) -> Edges:
    """Consecutive anchors, with the uncertainty of all key scans between them."""
    _, sigma_shift, sigma_turn = _chain_steps(key_poses)
    measured = between(key_poses[anchors[:-1]], key_poses[anchors[1:]])
    turn = np.sqrt(np.add.reduceat(sigma_turn**2, anchors[:-1]))
    length = np.linalg.norm(measured[:, :2], axis=1)
    shift = np.sqrt(np.add.reduceat(sigma_shift**2, anchors[:-1]) + (turn * length) ** 2 / 3.0)
    return _chain(measured, _diagonal(shift, turn), drives[anchors])


def _chain_steps(key_poses: F64) -> tuple[F64, F64, F64]:
    """Steps between consecutive key scans, (n - 1, 3), and their standard deviations of shift and turn."""
    measured = between(key_poses[:-1], key_poses[1:])
    shift = np.linalg.norm(measured[:, :2], axis=1)
    return measured, _CHAIN_SHIFT_M + 0.02 * shift, _CHAIN_TURN_RAD + 0.01 * np.abs(measured[:, 2])


def _diagonal(sigma_shift: F64, sigma_turn: F64) -> F64:
    """(m, 3, 3) information of independent shifts and turns."""
    information = np.zeros((sigma_shift.size, 3, 3))
    information[:, 0, 0] = information[:, 1, 1] = 1.0 / sigma_shift**2
    information[:, 2, 2] = 1.0 / sigma_turn**2
    return information


def loop_edges(loops: Sequence[Loop], nodes: I64) -> Edges:
    """Loops as edges between the nodes that stand for their local maps."""
    if not loops:
        return no_edges()
    information = np.array([loop.fit.information for loop in loops]) / RESIDUAL_M**2
    return Edges(
        nodes[[loop.fixed for loop in loops]],
        nodes[[loop.moved for loop in loops]],
        np.array([loop.fit.pose for loop in loops]),
        capped(information, _LOOP_SHIFT_M, _LOOP_TURN_RAD),
        np.full(len(loops), LOOP, dtype=np.uint8),
    )


def capped(information: F64, shift_m: float, turn_rad: float) -> F64:
    """(m, 3, 3) information whose covariance is that of the fit plus the given standard deviations."""
    covariance = np.linalg.inv(information + 1e-3 * np.eye(3))
    return np.asarray(np.linalg.inv(covariance + np.diag([shift_m**2, shift_m**2, turn_rad**2])))
