"""Fit of a scan in a field beside its plain twin."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dynmap_cli.kernels.scan_fits import scan_normal_equations
from tests.reference.scan_fits import plain_scan_fit

FLOOR, SIGMA_CELLS = 0.02, 2.0


def field():
    """Two walls in 30 x 40 cells."""
    rows, cols = np.mgrid[0:30, 0:40]
    distance = np.minimum(np.abs(rows - 20), np.hypot(rows - 5, cols - 30))
    return (0.48 * np.exp(-0.5 * (distance / SIGMA_CELLS) ** 2) + FLOOR).astype(np.float32)


def fitted(pose, ends):
    out = np.empty(10)
    scan_normal_equations(field(), FLOOR, SIGMA_CELLS, pose, ends, np.empty((2, 2, 4)), out)
    return out


@given(st.floats(3, 36), st.floats(3, 26), st.floats(-3.1, 3.1), st.integers(0, 1000))
def test_the_fit_is_that_of_the_ends_one_by_one(x, y, yaw, seed):
    ends = np.random.default_rng(seed).normal(scale=6, size=(2, 7))
    pose = np.array([x, y, yaw])
    expected = plain_scan_fit(field(), FLOOR, SIGMA_CELLS, pose, ends)
    np.testing.assert_allclose(fitted(pose, ends), expected, rtol=1e-6, atol=1e-5)


def test_the_gradient_is_how_the_cost_changes():
    ends = np.random.default_rng(4).normal(scale=3, size=(2, 50))
    pose, step = np.array([20.3, 14.4, 0.7]), 1e-5
    for axis in range(3):
        ahead, behind = (fitted(pose + sign * step * np.eye(3)[axis], ends)[0] for sign in (1, -1))
        np.testing.assert_allclose(fitted(pose, ends)[1 + axis], (ahead - behind) / (2 * step), rtol=1e-4)


def test_the_best_place_lies_half_way_between_two_cells_that_share_a_wall():
    wall = np.full((20, 20), FLOOR, dtype=np.float32)
    wall[9:11] = 0.5
    out, ends = np.empty(10), np.array([[0.0], [4.0]])
    costs = []
    for y in np.arange(4.0, 8.0, 0.05):
        pose = np.array([10.0, y, 0.0])
        scan_normal_equations(wall, FLOOR, SIGMA_CELLS, pose, ends, np.empty((2, 2, 4)), out)
        costs.append(out[0])
    assert math.isclose(4.0 + 0.05 * int(np.argmin(costs)), 6.0, abs_tol=0.05)
