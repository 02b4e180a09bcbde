"""The pose graph: sparse Gauss-Newton on SE(2) with robust kernels.

The kernels are tightened step by step (graduated non-convexity, Geman-McClure).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from dynmap_cli.arrays import F64, I64, U8
from dynmap_cli.domain.poses import between, wrap_angle

CHAIN, LOOP, DENSE, PLACED = 0, 1, 2, 3
"""Where an edge came from: consecutive key scans, two local maps, a key scan in a local map, two drives."""

_ANCHOR_WEIGHT = 1e10


@dataclass(frozen=True, slots=True)
class Edges:
    """Relative poses between nodes.

    Attributes
    ----------
    first, second : (m,) int64
        Nodes.
    measured : (m, 3) float64
        first_from_second.
    information : (m, 3, 3) float64
        Inverse covariance, in the frame of *first*.
    kind : (m,) uint8
        CHAIN, LOOP, DENSE or PLACED.
    """

    first: I64
    second: I64
    measured: F64
    information: F64
    kind: U8

    def __len__(self) -> int:
        """Number of edges."""
        return int(self.first.size)


def no_edges() -> Edges:
    """An empty set of edges."""
    none = np.zeros(0, dtype=np.int64)
    return Edges(none, none, np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0, dtype=np.uint8))


def join_edges(*parts: Edges) -> Edges:
    """All edges of several sets."""
    return Edges(
        np.concatenate([part.first for part in parts]),
        np.concatenate([part.second for part in parts]),
        np.concatenate([part.measured for part in parts]),
        np.concatenate([part.information for part in parts]),
        np.concatenate([part.kind for part in parts]),
    )


def residuals(poses: F64, edges: Edges) -> F64:
    """(m, 3) estimated minus measured relative pose, in the frame of the first node."""
    error = between(poses[edges.first], poses[edges.second]) - edges.measured
    error[:, 2] = wrap_angle(error[:, 2])
    return np.asarray(error)


def squared_distances(poses: F64, edges: Edges) -> F64:
    """(m,) squared Mahalanobis length of the residuals."""
    error = residuals(poses, edges)
    return np.asarray((error[:, None, :] @ edges.information @ error[:, :, None])[:, 0, 0])


def optimise(
    poses: F64, edges: Edges, scales: F64, *, graduated: bool = True, rounds: int = 30
) -> tuple[F64, F64]:
    r"""Minimise \sum_k \rho_\mu(r_k^2) over all poses but the first, which stays.

    rho is the Geman-McClure kernel mu c^2 r^2 / (mu c^2 + r^2) of scale c; mu falls from "nearly quadratic" to 1
    (Yang et al., Graduated Non-Convexity, 2020).

    Parameters
    ----------
    poses : (n, 3) float64
        Start.
    edges : Edges
    scales : (m,) float64
        Kernel scale c of each edge in standard deviations; inf = no kernel.
    graduated : bool
        Whether mu starts high; not needed where the start is good.
    rounds : int
        Gauss-Newton steps at most.

    Returns
    -------
    poses : (n, 3) float64
    weights : (m,) float64
        Robust weight of each edge at the end, 0 to 1.
    """
    current = poses.copy()
    squared_scales = scales**2
    mu = float(np.max(squared_distances(current, edges) / squared_scales, initial=1.0))
    mu = max(1.0, min(2.0 * mu, 1e4)) if graduated else 1.0
    weights = np.ones(len(edges))
    equations = _NormalEquations(edges, poses.shape[0])
    for _ in range(rounds):
        squared = squared_distances(current, edges)
        finite = np.isfinite(squared_scales)
        weights[finite] = (mu * squared_scales[finite] / (mu * squared_scales[finite] + squared[finite])) ** 2
        step = equations.step(current, weights)
        current += step
        current[:, 2] = wrap_angle(current[:, 2])
        if mu == 1.0 and float(np.abs(step).max()) < 1e-4:
            break
        mu = max(1.0, mu / 3.0)
    return current, weights


def jacobians(poses: F64, edges: Edges) -> tuple[F64, F64]:
    """(m, 3, 3) derivatives of the residuals by the first and the second node."""
    a, b = poses[edges.first], poses[edges.second]
    cos, sin = np.cos(a[:, 2]), np.sin(a[:, 2])
    dx, dy = b[:, 0] - a[:, 0], b[:, 1] - a[:, 1]
    second = np.zeros((len(edges), 3, 3))
    second[:, 0, 0], second[:, 0, 1] = cos, sin
    second[:, 1, 0], second[:, 1, 1] = -sin, cos
    second[:, 2, 2] = 1.0
    first = -second
    first[:, 0, 2] = -sin * dx + cos * dy
    first[:, 1, 2] = -cos * dx - sin * dy
    return first, second


class _NormalEquations:
    """The normal equations of a set of edges: where their blocks stand in the sparse matrix is worked out once."""

    def __init__(self, edges: Edges, n_nodes: int) -> None:
        self._edges, self._n_nodes = edges, n_nodes
        nodes = np.arange(n_nodes)
        rows = np.concatenate([edges.first, edges.first, edges.second, edges.second, nodes])
        cols = np.concatenate([edges.first, edges.second, edges.first, edges.second, nodes])
        self._order = np.lexsort((rows, cols))
        place = (cols * n_nodes + rows)[self._order]
        self._starts = np.flatnonzero(np.diff(place, prepend=-1))
        block_rows, block_cols = place[self._starts] % n_nodes, place[self._starts] // n_nodes
        # Blocks of a column stand one under another; each of its three scalar columns takes a row of all of them.
        per_column = np.bincount(block_cols, minlength=n_nodes)
        self._indptr = np.concatenate([[0], np.cumsum(np.repeat(3 * per_column, 3))])
        before = (np.cumsum(per_column) - per_column)[block_cols]
        number_in_column = np.arange(block_cols.size) - before
        at = 9 * before[:, None] + 3 * (
            per_column[block_cols][:, None] * np.arange(3) + number_in_column[:, None]
        )
        self._places = at[:, :, None] + np.arange(3)
        self._indices = np.empty(9 * block_rows.size, dtype=np.int32)
        self._indices[self._places] = (3 * block_rows[:, None] + np.arange(3))[:, None, :]
        damping = np.zeros((n_nodes, 3, 3))
        damping[:, [0, 1, 2], [0, 1, 2]] = 1e-9
        damping[0, [0, 1, 2], [0, 1, 2]] = _ANCHOR_WEIGHT
        self._damping = damping

    def step(self, poses: F64, weights: F64) -> F64:
        """Solve once; (n, 3) Gauss-Newton step."""
        edges = self._edges
        error = residuals(poses, edges)
        by_first, by_second = jacobians(poses, edges)
        weighted = edges.information * weights[:, None, None]
        right = np.zeros((self._n_nodes, 3))
        blocks = []
        for node, jacobian in ((edges.first, by_first), (edges.second, by_second)):
            transposed = jacobian.transpose(0, 2, 1) @ weighted
            np.subtract.at(right, node, (transposed @ error[:, :, None])[:, :, 0])
            blocks += [transposed @ by_first, transposed @ by_second]
        stacked = np.concatenate([*blocks, self._damping])[self._order]
        sums = np.add.reduceat(stacked, self._starts, axis=0)
        values = np.empty(self._indices.size)
        values[self._places] = sums.transpose(0, 2, 1)
        size = 3 * self._n_nodes
        matrix = sparse.csc_matrix((values, self._indices, self._indptr), shape=(size, size))
        solver = splu(matrix, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        return np.asarray(solver.solve(right.ravel())).reshape(-1, 3)
