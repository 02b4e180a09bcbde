"""Frames against direct computation with complex numbers and scipy's rotations."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dynmap_cli.ingest.choices.frames import FrameTree, find_mounting, make_edge
from dynmap_cli.ingest.choices.transforms import (
    inverse_matrices,
    matrices,
    planar,
    planar_of,
    put_at,
    slerp,
)
from dynmap_cli.ingest.raw.recording import RawTransform

metres = st.floats(-50.0, 50.0)
angles = st.floats(-3.1, 3.1)
poses3 = st.tuples(metres, metres, metres, angles, st.floats(-1.4, 1.4), angles)


def raw(values, stamps=(0,), *, static=False):
    result = RawTransform(static)
    result.add_many(np.array(stamps), np.array(stamps), np.array(values))
    return result


def from_euler(pose):
    x, y, z, roll, pitch, yaw = pose
    return (x, y, z, *Rotation.from_euler("xyz", [roll, pitch, yaw]).as_quat())


def turned(yaw):
    return (0.0, 0.0, 0.0, 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))


@given(poses3)
def test_matrices_match_scipy(pose):
    values = np.array([from_euler(pose)])
    found = matrices(values[:, :3], values[:, 3:])[0]
    np.testing.assert_allclose(found[:3, :3], Rotation.from_quat(values[0, 3:]).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(found[:3, 3], pose[:3])


@given(poses3)
def test_a_pose_after_its_inverse_is_nothing(pose):
    values = np.array([from_euler(pose)])
    a_from_b = matrices(values[:, :3], values[:, 3:])
    np.testing.assert_allclose(inverse_matrices(a_from_b) @ a_from_b, [np.eye(4)], atol=1e-9)


@given(poses3, st.tuples(metres, metres, angles))
def test_a_transform_that_is_put_elsewhere_keeps_its_height_and_tilt(pose, place):
    values = np.array([from_euler(pose)])
    (moved,) = put_at(values, np.array([place]))
    turn = Rotation.from_euler("z", place[2] - planar_of(values)[0, 2])
    right = (turn * Rotation.from_quat(values[0, 3:])).as_matrix()
    np.testing.assert_allclose(Rotation.from_quat(moved[3:]).as_matrix(), right, atol=1e-12)
    np.testing.assert_allclose(moved[:3], [*place[:2], pose[2]])
    assert abs(math.remainder(planar_of(moved[None])[0, 2] - place[2], 2 * math.pi)) < 1e-9


@given(angles, angles, st.floats(0.0, 1.0))
def test_slerp_of_headings_goes_the_shorter_way(start, end, share):
    a, b = np.array([turned(start)[3:]]), np.array([turned(end)[3:]])
    way = math.remainder(end - start, 2 * math.pi)
    if abs(abs(way) - math.pi) < 1e-3:
        return
    found = slerp(a, b, np.array([[share]]))[0]
    heading = 2 * math.atan2(found[2], found[3])
    assert abs(math.remainder(heading - (start + share * way), 2 * math.pi)) < 1e-6


@given(st.tuples(metres, metres, angles), st.tuples(metres, metres, angles))
def test_planar_chains_match_complex_numbers(first, second):
    tree = FrameTree(
        {
            ("odom", "base"): make_edge(raw([(*first[:2], 0.0, *turned(first[2])[3:])])),
            ("base", "laser"): make_edge(raw([(*second[:2], 0.3, *turned(second[2])[3:])], static=True)),
        }
    )
    found = planar(tree.transform("odom", "laser", np.zeros(1, dtype=np.int64)))[0]
    place = complex(*first[:2]) + complex(*second[:2]) * complex(math.cos(first[2]), math.sin(first[2]))
    np.testing.assert_allclose(found[:2], [place.real, place.imag], atol=1e-9)
    assert abs(math.remainder(found[2] - first[2] - second[2], 2 * math.pi)) < 1e-9
    back = tree.transform("laser", "odom", np.zeros(1, dtype=np.int64))
    np.testing.assert_allclose(
        back @ tree.transform("odom", "laser", np.zeros(1, dtype=np.int64)), [np.eye(4)], atol=1e-9
    )


def test_moving_frames_are_interpolated_and_unknown_outside_their_span():
    edge = make_edge(raw([(0, 0, 0, 0, 0, 0, 1), (2.0, 4.0, 0, *turned(1.0)[3:])], [0, 100]))
    found = planar(edge.at(np.array([-1, 0, 25, 100, 101])))
    np.testing.assert_allclose(found[1:4], [[0, 0, 0], [0.5, 1.0, 0.25], [2.0, 4.0, 1.0]], atol=1e-9)
    assert np.isnan(found[[0, 4]]).all()


def test_a_transform_that_is_repeated_unchanged_holds_at_all_times():
    edge = make_edge(raw([(1, 2, 3, 0, 0, 0, 1), (1, 2, 3, 0, 0, 0, -1)], [50, 100]))
    assert edge.is_fixed
    np.testing.assert_allclose(edge.at(np.array([0, 1000]))[:, :3, 3], [[1, 2, 3], [1, 2, 3]])


def test_transforms_that_arrive_out_of_order_are_sorted():
    edge = make_edge(raw([(2, 0, 0, 0, 0, 0, 1), (0, 0, 0, 0, 0, 0, 1), (1, 0, 0, 0, 0, 0, 1)], [20, 0, 10]))
    np.testing.assert_allclose(planar(edge.at(np.array([5, 15])))[:, 0], [0.5, 1.5])


def test_frames_that_are_not_joined_have_no_transform():
    tree = FrameTree({("a", "b"): make_edge(raw([turned(0)])), ("c", "d"): make_edge(raw([turned(0)]))})
    assert tree.transform("a", "d", np.zeros(1, dtype=np.int64)) is None
    assert tree.path("a", "nowhere") is None


def mounting_of(*values, stamps=(0,), static=True):
    tree = FrameTree({("base", "laser"): make_edge(raw(values, stamps, static=static))})
    return find_mounting(tree, "base", "laser", np.array([0, 10, 20, 30, 40]))


@pytest.mark.parametrize("yaw", [0.0, 0.5, -2.0, 3.0])
def test_an_upside_down_laser_is_seen_and_keeps_its_heading(yaw):
    found = mounting_of(from_euler((0.3, -0.1, 0.5, math.pi, 0.0, yaw)))
    assert found.is_upside_down
    assert found.is_level
    assert not found.moves
    np.testing.assert_allclose(found.robot_from_sensor, [0.3, -0.1, yaw], atol=1e-9)


def test_a_laser_that_tilts_moves_and_one_that_is_pitched_is_not_level():
    nods = mounting_of(
        from_euler((0, 0, 0, 0, 0, 0)), from_euler((0, 0, 0, 0, 0.3, 0)), stamps=(0, 40), static=False
    )
    assert nods.moves
    assert not mounting_of(from_euler((0, 0, 0, 0, 0.4, 0))).is_level
    assert mounting_of(from_euler((0, 0, 0, 0.02, 0.02, 0))).is_level
