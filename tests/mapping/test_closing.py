"""The chain of local maps holds against a few wrong loops, and tears where it is wrong itself."""

import numpy as np
import pytest

from dynmap_cli.domain.poses import between, compose
from dynmap_cli.mapping.back_end import _solved
from dynmap_cli.mapping.edges import scales
from dynmap_cli.mapping.pose_graph import CHAIN, LOOP, Edges, optimise, robust_cost

N_LAP = 120


def two_laps(seed, torn_m=0.0, wrong=0):
    """Two laps of 120 m with a loop at every place; chain with a step that is wrong, or neighbouring wrong loops."""
    rng = np.random.default_rng(seed)
    turns = np.where(np.arange(2 * N_LAP) % 30 == 29, np.pi / 2, 0.0)
    poses = np.zeros((2 * N_LAP, 3))
    for k in range(1, 2 * N_LAP):
        poses[k] = compose(poses[k - 1], np.array([1.0, 0.0, turns[k]]))
    first = np.r_[np.arange(2 * N_LAP - 1), np.arange(0, N_LAP, 2)]
    second = np.r_[np.arange(1, 2 * N_LAP), np.arange(0, N_LAP, 2) + N_LAP]
    kind = np.where(np.arange(first.size) < 2 * N_LAP - 1, CHAIN, LOOP).astype(np.uint8)
    sigma = np.where((kind == CHAIN)[:, None], [0.03, 0.03, 0.006], [0.02, 0.02, 0.005])
    measured = between(poses[first], poses[second]) + 0.5 * sigma * rng.normal(size=sigma.shape)
    measured[50, 1] += torn_m
    loops = np.flatnonzero(kind == LOOP)
    measured[loops[20 : 20 + wrong], 1] += 2.6
    edges = Edges(first, second, measured, np.array([np.diag(1.0 / each**2) for each in sigma]), kind)
    start = np.zeros_like(poses)
    for k in range(1, 2 * N_LAP):
        start[k] = compose(start[k - 1], measured[k - 1])
    return poses, start, edges


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("torn_m", "wrong"), [(0.0, 0), (3.0, 0), (0.0, 3)])
def test_the_way_is_found_with_a_torn_chain_and_with_wrong_loops(seed, torn_m, wrong):
    poses, start, edges = two_laps(seed, torn_m, wrong)
    found = _solved(start, edges)
    error = np.linalg.norm((found - poses)[:, :2], axis=1)
    # No loop says on which side of a torn step the one place between two loops is.
    assert np.delete(error, 51).max() < 0.5
    assert robust_cost(found, edges, scales(edges)) <= robust_cost(
        optimise(start, edges, scales(edges))[0], edges, scales(edges)
    )
