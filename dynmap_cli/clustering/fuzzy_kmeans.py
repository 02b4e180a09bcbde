"""Fuzzy k-means over vectors with unknown cells (Eq. 1.18)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import F64

EPSILON = 0.01
"""Distance of a known and an unknown cell, "a constant close to zero" (Eq. 1.18)."""
FUZZIFIER = 2.0
_MAX_ITERATIONS, _TOLERANCE = 100, 1e-6


@dataclass(frozen=True, slots=True)
class Clusters:
    """A fuzzy partition.

    Attributes
    ----------
    centers : (k, n_cells) float64
        Means; NaN = unknown to all members.
    memberships : (n, k) float64
        Rows add up to 1.
    """

    centers: F64
    memberships: F64

    @property
    def count(self) -> int:
        """Number of clusters."""
        return int(self.centers.shape[0])


def squared_distances(vectors: F64, centers: F64) -> F64:
    r"""Distance of every vector from every center, (n, k).

    .. math::
        d(a, b) = \sum_i \begin{cases} (a_i - b_i)^2 & a_i \ne \xi \wedge b_i \ne \xi \\
        0 & a_i = \xi \wedge b_i = \xi \\ \epsilon & \text{otherwise} \end{cases}

    Eq. 1.18 prints a signed difference, in which errors of opposite sign cancel; squares are meant.

    Parameters
    ----------
    vectors : (n, n_cells) float64
        NaN = unknown.
    centers : (k, n_cells) float64
        NaN = unknown.
    """
    a_known, b_known = ~np.isnan(vectors), ~np.isnan(centers)
    a, b = np.where(a_known, vectors, 0.0), np.where(b_known, centers, 0.0)
    weight_a, weight_b = a_known.astype(np.float64), b_known.astype(np.float64)
    both = (a**2) @ weight_b.T - 2.0 * a @ b.T + weight_a @ (b**2).T
    one_sided = weight_a @ (1.0 - weight_b).T + (1.0 - weight_a) @ weight_b.T
    return np.asarray(np.maximum(both, 0.0) + EPSILON * one_sided)


def memberships_of(distances: F64) -> F64:
    """Fuzzy memberships for squared distances (n, k): u_ij = 1 / sum_l (d_ij / d_il)^(1 / (f - 1))."""
    power = 1.0 / (FUZZIFIER - 1.0)
    closeness = (
        np.maximum(distances, 1e-12) / np.maximum(distances.min(axis=1, keepdims=True), 1e-12)
    ) ** -power
    return np.asarray(closeness / closeness.sum(axis=1, keepdims=True))


def centers_of(vectors: F64, memberships: F64) -> F64:
    """Means of the known values, weighted with u^f; unknown where no vector that is mostly a member knows a cell."""
    known = ~np.isnan(vectors)
    values, weights = np.where(known, vectors, 0.0), memberships**FUZZIFIER
    total = weights.T @ known.astype(np.float64)
    centers = np.full(total.shape, np.nan)
    np.divide(weights.T @ values, total, out=centers, where=total > 0)
    is_member = memberships.argmax(axis=1)[:, None] == np.arange(memberships.shape[1])
    centers[(is_member.T.astype(np.float64) @ known.astype(np.float64)) == 0] = np.nan
    return centers


def fuzzy_kmeans(vectors: F64, centers: F64) -> Clusters:
    """Iterate memberships and means from given centers until nothing moves.

    A cluster in which no vector has its largest membership is empty and is left out.

    Parameters
    ----------
    vectors : (n, n_cells) float64
        NaN = unknown; n at least 1.
    centers : (k, n_cells) float64
        Where to start.
    """
    memberships = memberships_of(squared_distances(vectors, centers))
    for _ in range(_MAX_ITERATIONS):
        filled = np.unique(memberships.argmax(axis=1))
        centers = centers_of(vectors, memberships[:, filled])
        updated = memberships_of(squared_distances(vectors, centers))
        is_settled = updated.shape == memberships.shape and np.abs(updated - memberships).max() < _TOLERANCE
        memberships = updated
        if is_settled:
            break
    return Clusters(centers, memberships)
