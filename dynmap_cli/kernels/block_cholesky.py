"""Cholesky factors of sparse symmetric matrices of 3 x 3 blocks.

A lower triangle is stored by block columns, as SciPy's CSC stores scalars: `starts` (n + 1,), and for each block its
row `rows` (m,), ascending in a column, diagonal first, and its values (m, 3, 3).
"""

from __future__ import annotations

import math

import numpy as np

from dynmap_cli.arrays import B1, F64, I64
from dynmap_cli.kernels.jit import kernel

LEAST_PIVOT = 1e-9
"""Smaller squares on the diagonal of a factor are rounding: what is damped by as much has none."""


@kernel
def _sort_range(values: I64, begin: int, end: int) -> None:
    """Sort values[begin:end]: Shell's sort with Knuth's gaps (numpy's is slow to compile)."""
    gap = 1
    while 3 * gap + 1 < end - begin:
        gap = 3 * gap + 1
    while gap > 0:
        for place in range(begin + gap, end):
            value, free = values[place], place
            while free >= begin + gap and values[free - gap] > value:
                values[free] = values[free - gap]
                free -= gap
            values[free] = value
        gap //= 3


@kernel
def fill_in(starts: I64, rows: I64, filled_starts: I64, filled_rows: I64) -> int:
    """Work out where the factor of a matrix has blocks.

    Column j of the factor has the rows of column j of the matrix and those of its children, the columns whose first
    row below the diagonal is j (George and Liu, Computer Solution of Large Sparse Positive Definite Systems, 1981).

    Parameters
    ----------
    starts, rows
        The matrix.
    filled_starts : (n + 1,) int64
        Filled.
    filled_rows : (capacity,) int64
        Filled where they fit in.

    Returns
    -------
    n_blocks : int
        Of the factor; more than the capacity = call again with room for so many.
    """
    n_nodes = starts.size - 1
    child, sibling = np.full(n_nodes, -1), np.full(n_nodes, -1)
    seen_for = np.full(n_nodes, -1)
    end = 0
    for col in range(n_nodes):
        begin = end
        filled_starts[col] = begin
        for place in range(starts[col], starts[col + 1]):
            seen_for[rows[place]] = col
            if end < filled_rows.size:
                filled_rows[end] = rows[place]
            end += 1
        other = child[col]
        while other >= 0:
            for place in range(filled_starts[other] + 1, filled_starts[other + 1]):
                row = filled_rows[place]
                if seen_for[row] != col:
                    seen_for[row] = col
                    if end < filled_rows.size:
                        filled_rows[end] = row
                    end += 1
            other = sibling[other]
        filled_starts[col + 1] = end
        if end > filled_rows.size:
            return 2 * end
        _sort_range(filled_rows, begin, end)
        if end > begin + 1:
            parent = filled_rows[begin + 1]
            sibling[col] = child[parent]
            child[parent] = col
    return end


@kernel
def factorise(starts: I64, rows: I64, blocks: F64) -> None:
    r"""Replace the lower triangle of A by that of L, A = L L^T, with the inverses of L's blocks on the diagonal.

    Left-looking: column j less \sum_k L_{ik} L_{jk}^T over the columns k that have row j (George and Liu, 1981).

    Parameters
    ----------
    starts, rows
        Of the factor, see `fill_in`.
    blocks : (m, 3, 3) float64
        Lower triangle of a positive definite matrix, zero where only the factor has blocks; overwritten.
    """
    n_nodes = starts.size - 1
    waiting, after = np.full(n_nodes, -1), np.full(n_nodes, -1)
    upcoming, place_of = starts[:-1].copy(), np.zeros(n_nodes, np.int64)
    for col in range(n_nodes):
        first, last = starts[col], starts[col + 1]
        for place in range(first, last):
            place_of[rows[place]] = place
        other = waiting[col]
        while other >= 0:
            following, begin, end = after[other], upcoming[other], starts[other + 1]
            _subtract_products(blocks, rows, place_of, begin, end)
            upcoming[other] = begin + 1
            if begin + 1 < end:
                after[other], waiting[rows[begin + 1]] = waiting[rows[begin + 1]], other
            other = following
        _invert_factor(blocks[first])
        for place in range(first + 1, last):
            _times_transposed(blocks[place], blocks[first])
        upcoming[col] = first + 1
        if first + 1 < last:
            after[col], waiting[rows[first + 1]] = waiting[rows[first + 1]], col


@kernel
def _subtract_products(blocks: F64, rows: I64, place_of: I64, begin: int, end: int) -> None:
    """Take the products of the blocks begin to end of a column with the one at *begin* off another column."""
    b00, b01, b02 = blocks[begin, 0, 0], blocks[begin, 0, 1], blocks[begin, 0, 2]
    b10, b11, b12 = blocks[begin, 1, 0], blocks[begin, 1, 1], blocks[begin, 1, 2]
    b20, b21, b22 = blocks[begin, 2, 0], blocks[begin, 2, 1], blocks[begin, 2, 2]
    for place in range(begin, end):
        into = place_of[rows[place]]
        for i in range(3):
            x, y, z = blocks[place, i, 0], blocks[place, i, 1], blocks[place, i, 2]
            blocks[into, i, 0] -= x * b00 + y * b01 + z * b02
            blocks[into, i, 1] -= x * b10 + y * b11 + z * b12
            blocks[into, i, 2] -= x * b20 + y * b21 + z * b22


@kernel
def _invert_factor(block: F64) -> None:
    """Replace a positive definite block by the inverse of its Cholesky factor, lower triangular."""
    a = 1.0 / math.sqrt(max(block[0, 0], LEAST_PIVOT))
    l10, l20 = block[1, 0] * a, block[2, 0] * a
    b = 1.0 / math.sqrt(max(block[1, 1] - l10 * l10, LEAST_PIVOT))
    l21 = (block[2, 1] - l20 * l10) * b
    c = 1.0 / math.sqrt(max(block[2, 2] - l20 * l20 - l21 * l21, LEAST_PIVOT))
    block[:] = 0.0
    block[0, 0], block[1, 1], block[2, 2] = a, b, c
    block[1, 0] = -b * l10 * a
    block[2, 1] = -c * l21 * b
    block[2, 0] = -c * (l20 * a + l21 * block[1, 0])


@kernel
def _times_transposed(block: F64, lower: F64) -> None:
    """Multiply a block by the transpose of a lower triangular one from the right, in place."""
    for i in range(3):
        x, y, z = block[i, 0], block[i, 1], block[i, 2]
        block[i, 0] = x * lower[0, 0]
        block[i, 1] = x * lower[1, 0] + y * lower[1, 1]
        block[i, 2] = x * lower[2, 0] + y * lower[2, 1] + z * lower[2, 2]


@kernel
def solve_factored(starts: I64, rows: I64, blocks: F64, vector: F64) -> None:
    """Replace b (n, 3) by the solution of L L^T x = b, with L as `factorise` left it."""
    n_nodes = starts.size - 1
    for col in range(n_nodes):
        first = starts[col]
        x, y, z = vector[col, 0], vector[col, 1], vector[col, 2]
        x, y, z = (
            blocks[first, 0, 0] * x,
            blocks[first, 1, 0] * x + blocks[first, 1, 1] * y,
            blocks[first, 2, 0] * x + blocks[first, 2, 1] * y + blocks[first, 2, 2] * z,
        )
        vector[col, 0], vector[col, 1], vector[col, 2] = x, y, z
        for place in range(first + 1, starts[col + 1]):
            row = rows[place]
            for i in range(3):
                vector[row, i] -= blocks[place, i, 0] * x + blocks[place, i, 1] * y + blocks[place, i, 2] * z
    for col in range(n_nodes - 1, -1, -1):
        first = starts[col]
        x, y, z = vector[col, 0], vector[col, 1], vector[col, 2]
        for place in range(first + 1, starts[col + 1]):
            row = rows[place]
            for i in range(3):
                value = vector[row, i]
                x -= blocks[place, i, 0] * value
                y -= blocks[place, i, 1] * value
                z -= blocks[place, i, 2] * value
        vector[col, 0] = blocks[first, 0, 0] * x + blocks[first, 1, 0] * y + blocks[first, 2, 0] * z
        vector[col, 1] = blocks[first, 1, 1] * y + blocks[first, 2, 1] * z
        vector[col, 2] = blocks[first, 2, 2] * z


@kernel
def add_edges(
    first: I64,
    second: I64,
    by_first: F64,
    by_second: F64,
    information: F64,
    weights: F64,
    errors: F64,
    pair_of: I64,
    is_core: B1,
    right: F64,
    diagonal: F64,
    core_diagonal: F64,
    pairs: F64,
) -> None:
    r"""Add the edges of a graph to its normal equations, \sum J^T W J x = -\sum J^T W e.

    Parameters
    ----------
    first, second : (m,) int64
        Nodes of the edges.
    by_first, by_second : (m, 3, 3) float64
        Derivatives J of the errors by the nodes.
    information : (m, 3, 3) float64
    weights : (m,) float64
        W is the information times the weight.
    errors : (m, 3) float64
    pair_of : (m,) int64
        Which block of *pairs* is an edge's.
    is_core : (m,) bool
        Which edges the core consists of.
    right : (n, 3) float64
    diagonal, core_diagonal : (n, 3, 3) float64
        Of all edges, and of those of the core.
    pairs : (k, 3, 3) float64
        Off the diagonal: row of the larger node, column of the smaller one.
    """
    to_first, to_second = np.empty((3, 3)), np.empty((3, 3))
    for edge in range(first.size):
        a, b, pair = first[edge], second[edge], pair_of[edge]
        for i in range(3):
            for j in range(3):
                x = y = 0.0
                for k in range(3):
                    value = information[edge, k, j] * weights[edge]
                    x += by_first[edge, k, i] * value
                    y += by_second[edge, k, i] * value
                to_first[i, j], to_second[i, j] = x, y
        for i in range(3):
            for k in range(3):
                right[a, i] -= to_first[i, k] * errors[edge, k]
                right[b, i] -= to_second[i, k] * errors[edge, k]
            for j in range(3):
                of_a = of_b = across = 0.0
                for k in range(3):
                    of_a += to_first[i, k] * by_first[edge, k, j]
                    of_b += to_second[i, k] * by_second[edge, k, j]
                    across += (
                        to_second[i, k] * by_first[edge, k, j]
                        if b > a
                        else to_first[i, k] * by_second[edge, k, j]
                    )
                diagonal[a, i, j] += of_a
                diagonal[b, i, j] += of_b
                pairs[pair, i, j] += across
                if is_core[edge]:
                    core_diagonal[a, i, j] += of_a
                    core_diagonal[b, i, j] += of_b


@kernel
def multiply(diagonal: F64, pairs: F64, smaller: I64, larger: I64, vector: F64, product: F64) -> None:
    """Multiply a vector (n, 3) by a symmetric matrix of a diagonal and of *pairs*, see `add_edges`.

    Parameters
    ----------
    smaller, larger : (k,) int64
        Columns and rows of the pairs.
    product : (n, 3) float64
        Filled.
    """
    for node in range(diagonal.shape[0]):
        for i in range(3):
            product[node, i] = (
                diagonal[node, i, 0] * vector[node, 0]
                + diagonal[node, i, 1] * vector[node, 1]
                + diagonal[node, i, 2] * vector[node, 2]
            )
    for pair in range(smaller.size):
        a, b = smaller[pair], larger[pair]
        for i in range(3):
            for j in range(3):
                product[b, i] += pairs[pair, i, j] * vector[a, j]
                product[a, j] += pairs[pair, i, j] * vector[b, i]
