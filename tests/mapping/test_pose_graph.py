"""Laws of the pose graph."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynmap_cli.domain.poses import between, compose, wrap_angle
from dynmap_cli.mapping.pose_graph import DENSE, Edges, _NormalEquations, jacobians, optimise, residuals
from tests.reference.mapping import plain_residual


def random_graph(seed, n=40, n_loops=25, noise=0.0, n_wrong=0):
    """A random walk with chain and loop edges; returns true poses and edges."""
    rng = np.random.default_rng(seed)
    poses = np.zeros((n, 3))
    for k in range(1, n):
        step = np.array([rng.uniform(0.5, 1.0), rng.normal(0, 0.1), rng.normal(0, 0.5)])
        poses[k] = compose(poses[k - 1], step)
    first = np.concatenate([np.arange(n - 1), rng.integers(0, n // 2, n_loops)])
    second = np.concatenate([np.arange(1, n), rng.integers(n // 2, n, n_loops)])
    measured = between(poses[first], poses[second])
    measured += rng.normal(0, 1, measured.shape) * [noise, noise, 0.3 * noise]
    measured[len(measured) - n_wrong :, :2] += rng.uniform(2.0, 5.0, (n_wrong, 2)) * rng.choice(
        [-1, 1], (n_wrong, 2)
    )
    information = np.tile(np.diag([400.0, 400.0, 4000.0]), (first.size, 1, 1))
    kind = np.r_[np.zeros(n - 1), np.ones(n_loops)].astype(np.uint8)
    return poses, Edges(first, second, measured, information, kind)


def drifted(poses, edges, n, seed=1):
    """Dead reckoning along noisy chain edges."""
    rng = np.random.default_rng(seed)
    start = np.zeros_like(poses)
    for k in range(1, n):
        start[k] = compose(start[k - 1], edges.measured[k - 1] + rng.normal(0, 1, 3) * [0.05, 0.05, 0.03])
    return start


@given(st.integers(0, 10**6))
def test_residuals_match_the_plain_formula(seed):
    poses, edges = random_graph(seed, noise=0.2)
    moved = poses + np.random.default_rng(seed).normal(0, 0.3, poses.shape)
    for k, row in enumerate(residuals(moved, edges)):
        plain = plain_residual(moved[edges.first[k]], moved[edges.second[k]], edges.measured[k])
        np.testing.assert_allclose(wrap_angle(row - plain), 0.0, atol=1e-9)


@given(st.integers(0, 10**6))
def test_jacobians_match_finite_differences(seed):
    poses, edges = random_graph(seed, n=6, n_loops=3, noise=0.1)
    by_first, by_second = jacobians(poses, edges)
    for k in range(len(edges)):
        for node, jac in ((edges.first[k], by_first[k]), (edges.second[k], by_second[k])):
            for axis in range(3):
                step = np.zeros_like(poses)
                step[node, axis] = 1e-6
                delta = residuals(poses + step, edges)[k] - residuals(poses - step, edges)[k]
                np.testing.assert_allclose(delta / 2e-6, jac[:, axis], atol=1e-6)


def plain_step(poses, edges, weights):
    """The Gauss-Newton step of dense normal equations, edge by edge."""
    n = len(poses)
    matrix, right = np.zeros((n, 3, n, 3)), np.zeros((n, 3))
    matrix[0, :, 0, :] = 1e10 * np.eye(3)
    errors, (by_first, by_second) = residuals(poses, edges), jacobians(poses, edges)
    for k in range(len(edges)):
        ends = ((edges.first[k], by_first[k]), (edges.second[k], by_second[k]))
        for row, left in ends:
            right[row] -= weights[k] * left.T @ edges.information[k] @ errors[k]
            for col, other in ends:
                matrix[row, :, col, :] += weights[k] * left.T @ edges.information[k] @ other
    return np.linalg.solve(matrix.reshape(3 * n, 3 * n), right.ravel()).reshape(n, 3)


@given(st.integers(0, 10**6))
def test_steps_match_the_dense_solution(seed):
    poses, edges = random_graph(seed, noise=0.05)
    turned = np.random.default_rng(seed).random(len(edges)) < 0.5
    first, second = np.where(turned, edges.second, edges.first), np.where(turned, edges.first, edges.second)
    measured = np.where(turned[:, None], between(poses[first], poses[second]), edges.measured)
    edges = replace(edges, first=first, second=second, measured=measured)
    start, weights = drifted(poses, edges, 1), np.random.default_rng(seed).uniform(0.1, 1.0, len(edges))
    start[1:] = poses[1:] + np.random.default_rng(seed).normal(0.0, 0.1, poses[1:].shape)
    step = _NormalEquations(edges, len(poses)).step(start, weights)
    np.testing.assert_allclose(step, plain_step(start, edges, weights), atol=1e-7)


@pytest.mark.parametrize("seed", range(5))
def test_what_is_not_in_the_core_of_the_graph_counts_as_much(seed):
    poses, edges = random_graph(seed, n=120, n_loops=90, noise=0.02)
    start, no_kernel = drifted(poses, edges, 120), np.full(len(edges), np.inf)
    kind = edges.kind.copy()
    kind[-70:] = DENSE
    assert (np.abs(edges.first - edges.second)[-70:] > 20).sum() > 30
    exact, _ = optimise(start, edges, no_kernel)
    iterated, _ = optimise(start, replace(edges, kind=kind), no_kernel)
    np.testing.assert_allclose(iterated, exact, atol=1e-4)


@pytest.mark.parametrize("seed", range(20))
def test_a_part_that_nothing_holds_stays_finite_and_in_shape(seed):
    poses, edges = random_graph(seed, n_loops=0)
    is_kept = edges.first != 19
    edges = Edges(*(getattr(edges, name)[is_kept] for name in Edges.__slots__))
    start = poses.copy()
    start[30:] = compose(np.array([0.3, -0.2, 0.1]), poses[30:])
    result, _ = optimise(start, edges, np.full(len(edges), np.inf))
    assert np.isfinite(result).all()
    np.testing.assert_allclose(residuals(result, edges), 0.0, atol=1e-3)


@pytest.mark.parametrize("seed", range(5))
def test_a_drifted_chain_with_exact_loops_comes_back_to_the_truth(seed):
    poses, edges = random_graph(seed)
    result, _ = optimise(drifted(poses, edges, 40), edges, np.full(len(edges), np.inf))
    np.testing.assert_allclose(result, poses, atol=1e-3)


@pytest.mark.parametrize("seed", range(5))
def test_wrong_loops_are_turned_off(seed):
    poses, edges = random_graph(seed, noise=0.01, n_wrong=8)
    scales = np.where(edges.kind == 0, np.inf, 4.0)
    result, weights = optimise(drifted(poses, edges, 40), edges, scales)
    assert (weights[-8:] < 0.1).all()
    assert np.abs(result - poses)[:, :2].max() < 0.1


def test_moving_the_whole_graph_moves_the_result():
    poses, edges = random_graph(3, noise=0.02)
    start, motion = drifted(poses, edges, 40), np.array([5.0, -2.0, 1.0])
    here, _ = optimise(start, edges, np.full(len(edges), 4.0))
    there, _ = optimise(compose(motion, start), edges, np.full(len(edges), 4.0))
    moved = compose(motion, here)
    np.testing.assert_allclose(there[:, :2], moved[:, :2], atol=1e-3)


def test_the_optimiser_agrees_with_gtsam():
    gtsam = pytest.importorskip("gtsam")
    poses, edges = random_graph(9, noise=0.02)
    start = drifted(poses, edges, 40)
    result, _ = optimise(start, edges, np.full(len(edges), np.inf))
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*start[0]), gtsam.noiseModel.Isotropic.Sigma(3, 1e-6)))
    for node, pose in enumerate(start):
        values.insert(node, gtsam.Pose2(*pose))
    for k in range(len(edges)):
        noise = gtsam.noiseModel.Gaussian.Information(edges.information[k])
        graph.add(
            gtsam.BetweenFactorPose2(
                int(edges.first[k]), int(edges.second[k]), gtsam.Pose2(*edges.measured[k]), noise
            )
        )
    solved = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    expected = np.array([[p.x(), p.y(), p.theta()] for p in (solved.atPose2(n) for n in range(40))])
    np.testing.assert_allclose(result[:, :2], expected[:, :2], atol=5e-3)
