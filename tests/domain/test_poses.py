"""Laws of planar poses and of grids."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.poses import (
    Trajectory,
    between,
    compose,
    interpolate,
    inverse,
    transform_points,
    wrap_angle,
)

length = st.floats(-100.0, 100.0)
pose = st.tuples(length, length, st.floats(-math.pi, math.pi)).map(np.array)


def same(a, b):
    np.testing.assert_allclose(a[..., :2], b[..., :2], atol=1e-9)
    np.testing.assert_allclose(wrap_angle(a[..., 2] - b[..., 2]), 0.0, atol=1e-9)


@given(st.floats(-1000.0, 1000.0))
def test_a_wrapped_angle_points_the_same_way(angle):
    wrapped = float(wrap_angle(np.array(angle)))
    assert -math.pi - 1e-12 <= wrapped <= math.pi + 1e-12
    assert math.isclose(math.sin(wrapped), math.sin(angle), abs_tol=1e-9)
    assert math.isclose(math.cos(wrapped), math.cos(angle), abs_tol=1e-9)


@given(pose, pose, pose)
def test_poses_are_a_group(a, b, c):
    same(compose(compose(a, b), c), compose(a, compose(b, c)))
    same(compose(a, inverse(a)), np.zeros(3))
    same(compose(a, between(a, b)), b)


@given(pose, pose, length, length)
def test_points_move_as_poses_do(a, b, x, y):
    point = np.array([x, y])
    once = transform_points(compose(a, b), point)
    np.testing.assert_allclose(once, transform_points(a, transform_points(b, point)), atol=1e-9)
    np.testing.assert_allclose(transform_points(inverse(a), transform_points(a, point)), point, atol=1e-9)


def test_interpolation_goes_through_the_samples_and_the_short_way_round():
    stamps = np.array([0, 10, 20], dtype=np.int64)
    poses = np.array([[0.0, 0.0, 3.0], [2.0, 0.0, -3.0], [2.0, 4.0, -3.0]])
    same(interpolate(stamps, poses, stamps), poses)
    middle = interpolate(stamps, poses, np.array([5, 15], dtype=np.int64))
    np.testing.assert_allclose(middle[:, :2], [[1.0, 0.0], [2.0, 2.0]])
    assert abs(abs(middle[0, 2]) - math.pi) < 1e-9
    assert np.isnan(interpolate(stamps, poses, np.array([-1, 21], dtype=np.int64))).all()
    assert np.isnan(interpolate(stamps[:0], poses[:0], stamps)).all()


def test_a_trajectory_has_a_pose_for_each_stamp():
    with pytest.raises(ValueError, match="2 stamps"):
        Trajectory(np.array([0, 1], dtype=np.int64), np.zeros((3, 3)))
    assert Trajectory(np.arange(3), np.array([[0, 0, 0], [3, 4, 0], [3, 4, 1.0]])).length_m() == 5.0


@given(st.integers(0, 49), st.integers(0, 69), length, length)
def test_the_middle_of_a_cell_lies_in_it(row, col, x, y):
    frame = GridFrame(0.05, x, y, 50, 70)
    cell = np.array([row, col])
    assert frame.to_cells(frame.to_points(cell)).tolist() == [row, col]
    assert frame.window(row, col, 1, 1).to_cells(frame.to_points(cell)).tolist() == [0, 0]
