"""The pose graph: sparse Gauss-Newton on SE(2) with robust kernels.

The kernels are tightened step by step (graduated non-convexity, Geman-McClure).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import F64, I64, U8
from dynmap_cli.domain.poses import between, wrap_angle
from dynmap_cli.kernels.block_cholesky import LEAST_PIVOT, add_edges, multiply
from dynmap_cli.mapping.sparse_factor import SparseFactor

CHAIN, LOOP, DENSE, PLACED = 0, 1, 2, 3
"""Where an edge came from: consecutive key scans, two local maps, a key scan in a local map, two drives."""

_ANCHOR_WEIGHT = 1e10
_CLOSE_NODES = 20
_CG_STEPS, _CG_SHARE = 50, 0.01
_EDGES_AT_ONCE = 1 << 14


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

    def parts(self) -> Iterator[tuple[slice, Edges]]:
        """Some edges at a time, with their rows: what is computed of each takes more memory than the edge."""
        for start in range(0, len(self), _EDGES_AT_ONCE):
            rows = slice(start, min(start + _EDGES_AT_ONCE, len(self)))
            yield (
                rows,
                Edges(
                    self.first[rows],
                    self.second[rows],
                    self.measured[rows],
                    self.information[rows],
                    self.kind[rows],
                ),
            )


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
    squared = np.empty(len(edges))
    for rows, part in edges.parts():
        error = residuals(poses, part)
        squared[rows] = (error[:, None, :] @ part.information @ error[:, :, None])[:, 0, 0]
    return squared


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


def robust_cost(poses: F64, edges: Edges, scales: F64) -> float:
    r"""\sum_k c_k^2 r_k^2 / (c_k^2 + r_k^2), what `optimise` minimises in the end (mu = 1)."""
    squared, squared_scales = squared_distances(poses, edges), scales**2
    finite = np.isfinite(squared_scales)
    bounded = squared_scales[finite] * squared[finite] / (squared_scales[finite] + squared[finite])
    return float(bounded.sum() + squared[~finite].sum())


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
    """The normal equations of a set of edges, solved by conjugate gradients.

    They are preconditioned with the Cholesky factor of a core of the graph: the chain, the loops, and what joins nodes
    that follow one another closely (Dellaert et al., Subgraph-Preconditioned Conjugate Gradients, 2010). The factor of
    the core stays sparse however often a place is visited, that of the whole graph does not. Where all edges are of the
    core, one step of the conjugate gradients is exact.
    """

    def __init__(self, edges: Edges, n_nodes: int) -> None:
        self._edges, self._n_nodes = edges, n_nodes
        smaller, larger = np.minimum(edges.first, edges.second), np.maximum(edges.first, edges.second)
        pairs, self._pair_of = np.unique(smaller * n_nodes + larger, return_inverse=True)
        self._smaller, self._larger = pairs // n_nodes, pairs % n_nodes
        is_core = np.zeros(pairs.size, dtype=bool)
        hangs_on_it = np.zeros(n_nodes, dtype=bool)
        hangs_on_it[edges.second[edges.kind == LOOP]] = True
        is_core[
            self._pair_of[
                (edges.kind != DENSE) | (larger - smaller <= _CLOSE_NODES) | hangs_on_it[edges.first]
            ]
        ] = True
        self._is_core_edge, self._core = is_core[self._pair_of], np.flatnonzero(is_core)
        self._factor = SparseFactor(self._smaller[is_core], self._larger[is_core], n_nodes)

    def step(self, poses: F64, weights: F64) -> F64:
        """Solve once; (n, 3) Gauss-Newton step."""
        n_nodes = self._n_nodes
        right = np.zeros((n_nodes, 3))
        diagonal = np.zeros((n_nodes, 3, 3))
        diagonal[:, [0, 1, 2], [0, 1, 2]] = LEAST_PIVOT
        diagonal[0, [0, 1, 2], [0, 1, 2]] = _ANCHOR_WEIGHT
        core_diagonal, pairs = diagonal.copy(), np.zeros((self._smaller.size, 3, 3))
        for rows, part in self._edges.parts():
            add_edges(
                part.first,
                part.second,
                *jacobians(poses, part),
                part.information,
                weights[rows],
                residuals(poses, part),
                self._pair_of[rows],
                self._is_core_edge[rows],
                right,
                diagonal,
                core_diagonal,
                pairs,
            )
        self._factor.factorise(core_diagonal, pairs[self._core])
        return self._conjugate_gradients(right, diagonal, pairs)

    def _conjugate_gradients(self, right: F64, diagonal: F64, pairs: F64) -> F64:
        """Preconditioned conjugate gradients; the next Gauss-Newton step corrects what is left."""
        solution, product = np.zeros_like(right), np.empty_like(right)
        rest = right.copy()
        better = self._factor.solve(rest)
        direction = better.copy()
        energy = start = _dot(rest, better)
        for _ in range(_CG_STEPS):
            if energy <= _CG_SHARE**2 * start:
                break
            multiply(diagonal, pairs, self._smaller, self._larger, direction, product)
            length = energy / _dot(direction, product)
            solution += length * direction
            rest -= length * product
            better = self._factor.solve(rest)
            before, energy = energy, _dot(rest, better)
            direction *= energy / before
            direction += better
        return solution


def _dot(a: F64, b: F64) -> float:
    """Inner product, the same whatever the number of threads."""
    return float(np.einsum("ij,ij->", a, b))
