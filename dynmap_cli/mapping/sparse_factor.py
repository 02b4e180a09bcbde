"""The Cholesky factor of a sparse matrix of 3 x 3 blocks: where its blocks stand is worked out once."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from dynmap_cli.arrays import F64, I64
from dynmap_cli.kernels.block_cholesky import factorise, fill_in, solve_factored


class SparseFactor:
    """Factor of a symmetric matrix with blocks on the diagonal and at given pairs of nodes.

    Parameters
    ----------
    smaller, larger : (k,) int64
        Nodes of the pairs, each pair once.
    n_nodes : int
    """

    def __init__(self, smaller: I64, larger: I64, n_nodes: int) -> None:
        self._number = _order(smaller, larger, n_nodes)
        cols = np.minimum(self._number[smaller], self._number[larger])
        rows = np.maximum(self._number[smaller], self._number[larger])
        self._is_turned = self._number[smaller] > self._number[larger]
        self._starts, self._rows = _filled(rows, cols, n_nodes)
        place = np.repeat(np.arange(n_nodes), np.diff(self._starts)) * n_nodes + self._rows
        self._places = np.searchsorted(place, cols * n_nodes + rows)
        self._blocks = np.empty((self._rows.size, 3, 3))

    def factorise(self, diagonal: F64, pairs: F64) -> None:
        """Factorise a positive definite matrix.

        Parameters
        ----------
        diagonal : (n_nodes, 3, 3) float64
        pairs : (k, 3, 3) float64
            Blocks in the row of the larger and the column of the smaller node of each pair.
        """
        self._blocks[:] = 0.0
        self._blocks[self._starts[self._number]] = diagonal
        self._blocks[self._places] = np.where(self._is_turned[:, None, None], pairs.transpose(0, 2, 1), pairs)
        factorise(self._starts, self._rows, self._blocks)

    def solve(self, right: F64) -> F64:
        """Solution x (n_nodes, 3) of A x = right with the last matrix."""
        solution = np.empty_like(right)
        solution[self._number] = right
        solve_factored(self._starts, self._rows, self._blocks, solution)
        return solution[self._number]


def _order(smaller: I64, larger: I64, n_nodes: int) -> I64:
    """(n_nodes,) place of each node in an order with little fill, minimum degree, as SuperLU finds it."""
    ones = np.ones(smaller.size)
    graph = sparse.coo_matrix((ones, (smaller, larger)), shape=(n_nodes, n_nodes)).tocsc()
    graph = graph + graph.T
    # A graph's Laplacian and more: positive definite, so that its rows stay in the order of its columns.
    matrix = sparse.diags(np.asarray(graph.sum(axis=0)).ravel() + 1.0) - graph
    factors = splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    return np.asarray(factors.perm_c, dtype=np.int64)


def _filled(rows: I64, cols: I64, n_nodes: int) -> tuple[I64, I64]:
    """Starts and rows of the columns of the factor of a matrix with a diagonal and blocks at rows, cols (k,)."""
    numbers = np.arange(n_nodes)
    place = np.sort(np.concatenate([cols * n_nodes + rows, numbers * (n_nodes + 1)]))
    starts = np.searchsorted(place, np.arange(n_nodes + 1) * n_nodes)
    filled_starts, n_blocks = np.empty(n_nodes + 1, dtype=np.int64), 2 * place.size
    while True:
        filled_rows = np.empty(n_blocks, dtype=np.int64)
        n_blocks = fill_in(starts, place % n_nodes, filled_starts, filled_rows)
        if n_blocks <= filled_rows.size:
            return filled_starts, filled_rows[:n_blocks]
