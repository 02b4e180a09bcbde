"""Twins of the kernels of room 5."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.poses import transform_points
from dynmap_cli.kernels.likelihood import (
    explain_by_states,
    explain_ends,
    field_log_likelihoods,
    first_crossings,
    own_cells,
    place_beams,
)
from tests.reference.localization import plain_field_log_likelihood, plain_first_crossing


@given(st.integers(0, 10_000), st.integers(1, 23), st.booleans())
def test_field_log_likelihoods_is_its_plain_twin(seed, n_beams, with_patch):
    random = np.random.default_rng(seed)
    rows, cols = 30, 40
    whole = random.normal(size=(rows, cols)).astype(np.float32)
    patch = random.normal(size=(6, 9)).astype(np.float32)
    pool = np.concatenate([whole.ravel(), patch.ravel()])
    cells = np.column_stack([random.uniform(-5, 45, 7), random.uniform(-5, 35, 7), random.uniform(-7, 7, 7)])
    poses = cells * (0.1, 0.1, 1.0) + (3.0, -2.0, 0.0)
    ends = random.uniform(-20, 20, (2, n_beams)).astype(np.float32)
    windows = np.zeros((7, 5), dtype=np.int32)
    if with_patch:
        windows[::2] = [8, 12, 6, 9, rows * cols]
    out = np.empty(7)
    cell, index = np.array([3.0, -2.0, 0.1]), np.empty(n_beams, np.int32)
    field_log_likelihoods(pool, rows, cols, cell, poses, ends, windows, index, out)
    for k in range(7):
        own = patch if windows[k, 2] else None
        expected = plain_field_log_likelihood((whole, own), windows[k], cells[k], ends.T.astype(float))
        borders = _nearest_border(cells[k], ends.T.astype(float))
        if borders > 1e-4:
            assert math.isclose(out[k], expected, abs_tol=1e-5)


def _nearest_border(pose, ends):
    c, s = math.cos(pose[2]), math.sin(pose[2])
    xy = np.stack([pose[0] + c * ends[:, 0] - s * ends[:, 1], pose[1] + s * ends[:, 0] + c * ends[:, 1]])
    return np.abs(xy - np.round(xy)).min()


@given(st.integers(0, 10_000))
def test_own_cells_are_those_of_the_frame(seed):
    random = np.random.default_rng(seed)
    frame = GridFrame(0.05, 1.0, -2.0, 7, 9)
    owned = random.random(frame.shape) < 0.5
    points = random.uniform((0.8, -2.2), (1.8, -1.4), (40, 2))
    cells, inside = np.empty((40, 2), np.int64), np.empty(40, bool)
    own_cells(points, np.array([1.0, -2.0, 0.05]), owned, cells, inside)
    expected = frame.to_cells(points)
    for k in range(40):
        row, col = expected[k]
        is_in = 0 <= row < 7 and 0 <= col < 9
        assert inside[k] == (is_in and owned[row, col])
        assert cells[k].tolist() == [min(max(row, 0), 6), min(max(col, 0), 8)]


@given(st.integers(0, 10_000))
def test_explained_ends_are_their_plain_twin(seed):
    random = np.random.default_rng(seed)
    shape, cell = (7, 9), np.array([1.0, -2.0, 0.05])
    static, owned = random.random((2, *shape)) < 0.5
    states, state = random.random((3, *shape)) < 0.3, int(random.integers(3))
    ends = random.uniform((0.8, -2.2), (1.8, -1.4), (40, 2))
    now, other = np.empty(40, bool), np.zeros(40, bool)
    explain_ends(ends, cell, static, now)
    explain_by_states(ends, cell, owned, states, state, now, other)
    for k, (x, y) in enumerate(ends):
        row, col = math.floor((y + 2.0) / 0.05), math.floor((x - 1.0) / 0.05)
        if 0 <= row < 7 and 0 <= col < 9 and owned[row, col]:
            assert now[k] == states[state, row, col]
            assert other[k] == (any(states[:, row, col]) and not states[state, row, col])
        else:
            assert now[k] == static[min(max(row, 0), 6), min(max(col, 0), 8)]
            assert not other[k]


@given(st.integers(0, 10_000))
@settings(max_examples=8)
def test_first_crossings_is_its_plain_twin(seed):
    random = np.random.default_rng(seed)
    surfaces = np.where(
        random.random((9, 11)) < 0.15, random.choice([1, 46, 91, 136, 255], (9, 11)), 0
    ).astype(np.uint8)
    x, y = random.uniform(-4, 15), random.uniform(-4, 13)
    directions = random.uniform(-np.pi, np.pi, 4)
    out = np.empty((4, 2))
    first_crossings(surfaces, x, y, directions, np.full(4, 12.0), 0.34, out)
    for k in range(4):
        entered, crossed = plain_first_crossing(surfaces, x, y, directions[k], 12.0, 0.34, 2e-3)
        for mine, twin in ((out[k, 0], entered), (out[k, 1], crossed)):
            if math.isfinite(mine) and math.isfinite(twin):
                assert abs(mine - twin) < 5e-3 or _grazes_a_corner(x, y, directions[k], min(mine, twin))
            elif math.isfinite(mine) != math.isfinite(twin):
                assert _grazes_a_corner(x, y, directions[k], min(mine, twin))


def _grazes_a_corner(x, y, direction, at):
    """Whether the twin may have stepped over a cell that the ray only touches."""
    px, py = x + at * math.cos(direction), y + at * math.sin(direction)
    return (abs(px - round(px)) < 0.02 and abs(py - round(py)) < 0.02) or at > 11.99


def test_a_beam_that_slides_along_a_wall_crosses_nothing():
    surfaces = np.zeros((20, 20), dtype=np.uint8)
    surfaces[10, :] = 1  # a wall along x
    out = np.empty((2, 2))
    first_crossings(surfaces, 2.0, 9.0, np.array([0.1, math.pi / 2]), np.full(2, 17.0), 0.34, out)
    assert math.isinf(out[0, 1])
    assert math.isclose(out[1, 1], 1.0)


@given(st.floats(-10, 10), st.floats(-10, 10), st.floats(-4, 4), st.floats(-4, 4), st.floats(0, 30))
def test_a_placed_beam_ends_where_its_pose_sees_it(x, y, yaw, direction, length):
    directions, ends = np.empty(1), np.empty((1, 2))
    place_beams(np.array([direction]), np.array([length]), np.array([x, y, yaw]), directions, ends)
    seen = np.array([length * math.cos(direction), length * math.sin(direction)])
    np.testing.assert_allclose(ends[0], transform_points(np.array([x, y, yaw]), seen), atol=1e-9)
    assert directions[0] == direction + yaw
