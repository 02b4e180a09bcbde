r"""How many states: likelihood, BIC (Eq. 1.19), and merging of what is the same.

The paper leaves open what P(d | theta) is, and it decides everything: with independent cells the BIC always
takes the largest k, with |theta| = number of cells it takes 1. Here:

- a cell is Gaussian around its cluster mean with s = 0.15, on tri-state values;
- an object, not a cell, is one observation, since its cells appear and vanish together. The log-likelihood of a
  vector is therefore scaled by (groups of touching varying cells) / (varying cells);
- the clusters are a mixture with their mean memberships as weights;
- |theta| = k, the number of clusters, as the paper says under Eq. 1.19.

At the end, clusters are merged whose means contradict each other in too few cells that touch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import F64, I64
from dynmap_cli.clustering.fuzzy_kmeans import Clusters, fuzzy_kmeans, squared_distances
from dynmap_cli.clustering.local_maps import Vectors, component_sizes

CELL_SIGMA = 0.15
CONTRADICTION = 0.6
"""Two values contradict each other from this difference on."""
_PATIENCE = 2


@dataclass(frozen=True, slots=True)
class Model:
    """The chosen clusters.

    Attributes
    ----------
    clusters : Clusters
    bic : tuple of float
        BIC of the models with 1, 2, ... clusters that were tried.
    rounds : tuple of (k, n_cells) float64
        Means of the clusters of each of these models.
    """

    clusters: Clusters
    bic: tuple[float, ...]
    rounds: tuple[F64, ...]


def cluster_log_likelihoods(vectors: Vectors, centers: F64) -> F64:
    """Logarithm of P(vector | cluster), (n, k), up to a constant."""
    scale = vectors.n_components / max(vectors.component.size, 1)
    return -scale * squared_distances(vectors.values, centers) / (2.0 * CELL_SIGMA**2)


def mixture_log_likelihoods(vectors: Vectors, clusters: Clusters) -> F64:
    """Logarithm of P(vector | theta), (n,): the clusters weighted with their mean memberships."""
    weights = clusters.memberships.mean(axis=0)
    joint = cluster_log_likelihoods(vectors, clusters.centers) + np.log(weights)
    return np.asarray(np.logaddexp.reduce(joint, axis=1))


def bic(vectors: Vectors, clusters: Clusters) -> float:
    """Eq. 1.19: log P(d | theta) - |theta| / 2 log n, with |theta| = k."""
    count = vectors.values.shape[0]
    likelihood = float(mixture_log_likelihoods(vectors, clusters).sum())
    return likelihood - 0.5 * clusters.count * float(np.log(count))


def choose_clusters(vectors: Vectors, max_states: int, min_cells: int) -> Model:
    """Add clusters one by one, each at the vector with the lowest likelihood; the highest BIC wins.

    Parameters
    ----------
    vectors : Vectors
        Of at least one map.
    max_states : int
    min_cells : int
        Clusters that contradict each other in fewer cells that touch are the same state.
    """
    clusters = fuzzy_kmeans(vectors.values, _mean(vectors.values))
    best, scores, rounds = clusters, [bic(vectors, clusters)], [clusters.centers]
    while len(scores) < min(max_states, vectors.values.shape[0]):
        worst = int(mixture_log_likelihoods(vectors, clusters).argmin())
        clusters = fuzzy_kmeans(vectors.values, np.vstack([clusters.centers, vectors.values[worst]]))
        scores.append(bic(vectors, clusters))
        rounds.append(clusters.centers)
        if scores[-1] > max(scores[:-1]):
            best = clusters
        if len(scores) - int(np.argmax(scores)) > _PATIENCE:
            break
    return Model(merge_equal(vectors, best, min_cells), tuple(scores), tuple(rounds))


def _mean(values: F64) -> F64:
    """Mean of the known values, (1, n_cells)."""
    known = ~np.isnan(values)
    mean = np.full((1, values.shape[1]), np.nan)
    np.divide(
        np.where(known, values, 0.0).sum(axis=0), known.sum(axis=0), out=mean[0], where=known.any(axis=0)
    )
    return mean


def merge_equal(vectors: Vectors, clusters: Clusters, min_cells: int) -> Clusters:
    """Merge the two clusters that contradict each other least, while that is in too few cells that touch."""
    while clusters.count > 1:
        pairs = [(a, b) for a in range(clusters.count) for b in range(a + 1, clusters.count)]
        differences = [
            _touching_contradiction(clusters.centers[a], clusters.centers[b], vectors) for a, b in pairs
        ]
        least = int(np.argmin(differences))
        if differences[least] >= min_cells:
            break
        a, b = pairs[least]
        memberships = np.delete(clusters.memberships, b, axis=1)
        memberships[:, a] += clusters.memberships[:, b]
        clusters = fuzzy_kmeans(vectors.values, _means_of(vectors.values, memberships))
    return clusters


def _touching_contradiction(one: F64, other: F64, vectors: Vectors) -> int:
    """Number of cells in the largest group of touching ones in which two value vectors (n_cells,) contradict."""
    cells = np.zeros(vectors.cells.shape, dtype=bool)
    cells[vectors.cells] = np.abs(one - other) > CONTRADICTION
    return int(component_sizes(cells).max(initial=0))


def _means_of(values: F64, memberships: F64) -> F64:
    """Means of the vectors whose largest membership is each cluster, (k, n_cells)."""
    member_of = memberships.argmax(axis=1)
    return np.concatenate([_mean(values[member_of == k]) for k in np.unique(member_of)])


def largest_contradiction(one: F64, other: F64, vectors: Vectors) -> int:
    """Number of cells, in the group that has most of them, in which two value vectors (n_cells,) contradict."""
    contradicts = np.abs(one - other) > CONTRADICTION
    return int(np.bincount(vectors.component[contradicts], minlength=1).max())


def fitting_states(values: F64, vectors: Vectors, clusters: Clusters, min_cells: int) -> I64:
    """Numbers of the clusters that a value vector (n_cells,) contradicts in fewer than *min_cells* of every group."""
    return np.array(
        [
            k
            for k, center in enumerate(clusters.centers)
            if largest_contradiction(values, center, vectors) < min_cells
        ],
        dtype=np.int64,
    )


def assign(vectors: Vectors, clusters: Clusters, min_cells: int) -> tuple[I64, F64]:
    """State of vectors that founded none: number of the cluster or -1, and its posterior, (n,) each.

    A vector is assigned if it knows *min_cells* cells and the state is at least nine times as likely as the
    others together.

    Parameters
    ----------
    vectors : Vectors
    clusters : Clusters
    min_cells : int
    """
    joint = cluster_log_likelihoods(vectors, clusters.centers) + np.log(clusters.memberships.mean(axis=0))
    posterior = np.exp(joint - np.logaddexp.reduce(joint, axis=1)[:, None])
    best, share = posterior.argmax(axis=1), posterior.max(axis=1)
    knows = (~np.isnan(vectors.values)).sum(axis=1) >= min_cells
    return np.where(knows & (share >= 0.9), best, -1).astype(np.int64), share
