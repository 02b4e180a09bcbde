"""The sparse factor against NumPy's dense solver."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynmap_cli.kernels.block_cholesky import fill_in
from dynmap_cli.mapping.sparse_factor import SparseFactor, _filled


def random_matrix(seed, n_nodes, n_pairs):
    """A positive definite matrix of 3 x 3 blocks; pairs, blocks on the diagonal and off it, and all of it, dense."""
    rng = np.random.default_rng(seed)
    lower = [(a, b) for b in range(n_nodes) for a in range(b)]
    chosen = rng.permutation(len(lower))[: min(n_pairs, len(lower))]
    smaller, larger = np.array([lower[k] for k in chosen], dtype=np.int64).reshape(-1, 2).T.copy()
    dense = np.zeros((n_nodes, 3, n_nodes, 3))
    pairs = rng.normal(0.0, 1.0, (smaller.size, 3, 3))
    for a, b, block in zip(smaller, larger, pairs, strict=True):
        dense[b, :, a, :], dense[a, :, b, :] = block, block.T
    diagonal = np.zeros((n_nodes, 3, 3))
    for node in range(n_nodes):
        half = rng.normal(0.0, 1.0, (3, 3))
        diagonal[node] = half @ half.T + np.abs(dense[node]).sum() * np.eye(3) + 0.1 * np.eye(3)
        dense[node, :, node, :] = diagonal[node]
    return smaller, larger, diagonal, pairs, dense.reshape(3 * n_nodes, 3 * n_nodes)


@given(st.integers(0, 10**6), st.integers(1, 25), st.integers(0, 60))
def test_solutions_match_the_dense_solver(seed, n_nodes, n_pairs):
    smaller, larger, diagonal, pairs, dense = random_matrix(seed, n_nodes, n_pairs)
    right = np.random.default_rng(seed).normal(0.0, 1.0, (n_nodes, 3))
    factor = SparseFactor(smaller, larger, n_nodes)
    for scale in (1.0, 3.0):
        factor.factorise(scale * diagonal, scale * pairs)
        expected = np.linalg.solve(scale * dense, right.ravel()).reshape(-1, 3)
        np.testing.assert_allclose(factor.solve(right), expected, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_the_factor_has_room_where_elimination_puts_something(seed):
    n_nodes = 20
    smaller, larger, *_ = random_matrix(seed, n_nodes, 30)
    starts, rows = _filled(larger, smaller, n_nodes)
    neighbours = [set() for _ in range(n_nodes)]
    for a, b in zip(smaller, larger, strict=True):
        neighbours[a].add(int(b))
    for node in range(n_nodes):
        later = sorted(neighbours[node])
        for k, one in enumerate(later):
            neighbours[one].update(later[k + 1 :])
        assert rows[starts[node] : starts[node + 1]].tolist() == [node, *later]


def test_a_factor_that_does_not_fit_says_how_much_room_it_wants():
    n_nodes = 12
    numbers = np.arange(n_nodes)
    # A star whose middle comes first: everything fills.
    starts = np.concatenate([[0], n_nodes + numbers])
    rows = np.concatenate([numbers, numbers[1:]])
    wanted = fill_in(starts, rows, np.empty(n_nodes + 1, np.int64), np.empty(30, np.int64))
    assert wanted > 30
    filled_starts, filled = np.empty(n_nodes + 1, np.int64), np.empty(200, np.int64)
    assert fill_in(starts, rows, filled_starts, filled) == n_nodes * (n_nodes + 1) // 2 == filled_starts[-1]
