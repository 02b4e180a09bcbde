"""Matching kernels against their plain twins, and what matching has to do."""

import itertools

import numpy as np
import pytest

from dynmap_cli.kernels.beams import Rays
from dynmap_cli.kernels.matching import SIZE, correlate, insert_points, thin_points
from dynmap_cli.kernels.refinement import point_to_line
from tests.reference.mapping import (
    plain_bridged,
    plain_correlate,
    plain_field,
    plain_local_map,
    plain_point_to_line,
)

CELL = 0.05


class Torus:
    """A local map on the torus."""

    def __init__(self):
        self.sums = np.zeros((SIZE, SIZE, 3), dtype=np.int64)
        self.lines = np.zeros((SIZE, SIZE, 4), dtype=np.float32)
        self.stale = np.zeros((SIZE, SIZE), dtype=np.uint8)
        self.field = np.zeros((SIZE, SIZE), dtype=np.uint8)

    def insert(self, points, weights, pose, sign=1):
        insert_points(
            points, weights, len(points), pose, sign, CELL, self.sums, self.lines, self.stale, self.field
        )

    def match(self, points, pose):
        """Matched share of points at a pose."""
        tables = self.sums, self.lines, self.stale, self.field
        n = len(points)
        return point_to_line(
            points, np.ones(n), n, pose, 2, 0.04, CELL, *tables, np.empty((3, 3)), np.empty(3)
        )


@pytest.fixture(scope="module")
def room():
    """Points on the walls of a room with a corner cut off, jittered, in the map frame."""
    rng = np.random.default_rng(4)
    corners = np.array([[-2.0, -1.5], [2.2, -1.5], [2.2, 1.0], [1.4, 1.9], [-2.0, 1.9], [-2.0, -1.5]])
    walls = [
        a + (b - a) * np.linspace(0, 1, int(np.hypot(*(b - a)) / 0.04))[:, None]
        for a, b in itertools.pairwise(corners)
    ]
    points = np.concatenate(walls)
    return points + rng.normal(0, 0.01, points.shape)


@pytest.fixture(scope="module")
def torus(room):
    result = Torus()
    result.insert(room, np.ones(len(room)), np.zeros(3))
    return result


def to_robot(points, pose):
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return (points - pose[:2]) @ np.array([[c, -s], [s, c]])


def test_the_local_map_has_the_centroids_of_the_plain_one(room, torus):
    cells = plain_local_map(room, np.ones(len(room)), CELL)
    assert (torus.sums[..., 0] > 0).sum() == len(cells)
    for (row, col), (weight, x, y) in cells.items():
        hits, sx, sy = torus.sums[row % SIZE, col % SIZE]
        np.testing.assert_allclose(hits / 2**20, weight, atol=1e-6)
        np.testing.assert_allclose([(col + sx / hits) * CELL, (row + sy / hits) * CELL], [x, y], atol=1e-6)


def test_the_field_is_that_of_the_plain_twin(room, torus):
    field = plain_field(plain_local_map(room, np.ones(len(room)), CELL))
    assert (torus.field > 0).sum() == len(field)
    for (row, col), value in field.items():
        assert torus.field[row % SIZE, col % SIZE] == value


def test_taking_scans_out_leaves_the_rest_to_the_byte(room, torus):
    other = Torus()
    other.insert(room, np.ones(len(room)), np.zeros(3))
    pose = np.array([40.0, -30.0, 1.0])
    other.insert(room, np.full(len(room), 0.3), pose)
    other.insert(room, np.full(len(room), 0.3), pose, sign=-1)
    for name in ("sums", "field"):
        assert getattr(other, name).tobytes() == getattr(torus, name).tobytes()


@pytest.mark.parametrize("seed", range(8))
def test_normal_equations_match_the_plain_sum(room, torus, seed):
    rng = np.random.default_rng(seed)
    pose = np.array([*rng.normal(0, 0.03, 2), rng.normal(0, 0.02)])
    points, weights = to_robot(room[::5], np.zeros(3)), rng.uniform(0, 1, len(room[::5]))
    normal_matrix, gradient = np.empty((3, 3)), np.empty(3)
    share = point_to_line(
        points,
        weights,
        len(points),
        pose,
        2,
        0.06,
        CELL,
        torus.sums,
        torus.lines,
        torus.stale,
        torus.field,
        normal_matrix,
        gradient,
    )
    expected = plain_point_to_line(
        points, weights, pose, 2, 0.06, CELL, plain_local_map(room, np.ones(len(room)), CELL)
    )
    np.testing.assert_allclose(normal_matrix, expected[0], rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(gradient, expected[1], rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(share, expected[2], rtol=1e-4)


@pytest.mark.parametrize(("reach", "step"), [(4, 1), (6, 2), (7, 2)])
def test_correlative_search_finds_what_trying_everything_finds(room, torus, reach, step):
    points = to_robot(room[::20], np.array([0.1, -0.05, 0.06]))
    angles = -0.1 + 0.02 * np.arange(11)
    costs, out = np.array([0.3, 1.0]), np.empty(3)
    score = correlate(
        points,
        len(points),
        np.zeros(3),
        0.1,
        0.02,
        reach,
        step,
        CELL,
        torus.field,
        np.zeros((64, 64), np.int32),
        costs,
        out,
    )
    field = plain_field(plain_local_map(room, np.ones(len(room)), CELL))
    whole = reach // step * step
    _, expected_score, expected = plain_correlate(
        points, np.zeros(3), angles, range(-whole, whole + 1, step), CELL, field, costs
    )
    np.testing.assert_allclose(out, expected, atol=1e-12)
    np.testing.assert_allclose(score, expected_score)
    np.testing.assert_allclose(out, [0.1, -0.05, 0.06], atol=0.051)


def test_the_map_is_the_same_on_the_other_side_of_the_torus(room):
    here, there = Torus(), Torus()
    shift = np.array([SIZE * CELL * 3, -SIZE * CELL * 2, 0.0])
    here.insert(room, np.ones(len(room)), np.zeros(3))
    there.insert(room, np.ones(len(room)), shift)
    same = (here.sums[..., 0] > 0) == (there.sums[..., 0] > 0)
    assert same.mean() > 0.99999
    matrices = []
    for torus, pose in ((here, np.array([0.01, 0.02, 0.01])), (there, shift + np.array([0.01, 0.02, 0.01]))):
        matrix, gradient = np.empty((3, 3)), np.empty(3)
        point_to_line(
            room,
            np.ones(len(room)),
            len(room),
            pose,
            2,
            0.06,
            CELL,
            torus.sums,
            torus.lines,
            torus.stale,
            torus.field,
            matrix,
            gradient,
        )
        matrices.append(matrix)
    np.testing.assert_allclose(matrices[0], matrices[1], rtol=2e-2, atol=0.5)


def test_thinning_keeps_a_spacing_and_skips_what_is_no_return():
    ranges = np.array([1.0, 1.0, np.nan, 1.0, np.inf, 5.0], dtype=np.float32)
    directions = np.array([[np.cos(a), np.sin(a)] for a in (0.0, 0.01, 0.02, 0.5, 0.6, 0.7)])
    out, beams = np.empty((6, 2)), np.empty(6, dtype=np.int32)
    rays = Rays(directions[None], np.array([[0.2, 0.0, 0.0]]), np.array([4.0]), np.array([0.0]))
    count = thin_points(ranges, rays, 0, np.zeros(3), 0.03, out, beams)
    assert beams[:count].tolist() == [0, 3]
    np.testing.assert_allclose(out[0], [1.2, 0.0])


def test_a_sweep_is_corrected_for_the_motion_during_it():
    """A wall seen beam by beam while the robot drives and turns lands on one line, at its pose at the first beam."""
    n, interval, speed, turn = 90, 0.002, 1.0, 0.8
    bearings = np.linspace(-0.8, 0.8, n)
    times = np.arange(n) * interval
    ranges = ((3.0 - speed * times) / np.cos(bearings + turn * times)).astype(np.float32)
    directions = np.column_stack([np.cos(bearings), np.sin(bearings)])
    out, beams = np.empty((n, 2)), np.empty(n, dtype=np.int32)
    twist = np.array([speed, 0.0, turn])
    rays = Rays(directions[None], np.zeros((1, 3)), np.array([10.0]), np.array([interval]))
    count = thin_points(ranges, rays, 0, twist, 0.0, out, beams)
    assert count == n
    np.testing.assert_allclose(out[:, 0], 3.0, atol=1e-5)


def test_gaps_on_smooth_walls_are_bridged_as_by_the_plain_twin():
    """A scan down a corridor with a niche: the ends get further apart the further away they are."""
    bearings = np.radians(np.arange(-89.5, 90.0, 1.0))
    across = np.where(np.abs(np.degrees(bearings) - 30) < 4, 1.4, 1.0)
    points = (across / np.abs(np.sin(bearings)))[:, None] * np.column_stack(
        [np.cos(bearings), np.sin(bearings)]
    )
    points = points[np.abs(points[:, 0]) < 9.0]
    weights, pose, torus = np.linspace(0.2, 1.0, len(points)), np.array([0.3, -0.2, 0.4]), Torus()
    bridged, bridged_weights = plain_bridged(points, weights, CELL)
    assert len(bridged) > 1.5 * len(points)
    assert (np.abs(np.abs(bridged[:, 1]) - 1.2) > 0.19).all()  # nothing between wall and niche
    torus.insert(points, weights, pose)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    cells = plain_local_map(bridged @ np.array([[c, s], [-s, c]]) + pose[:2], bridged_weights, CELL)
    assert (torus.sums[..., 0] > 0).sum() == len(cells)
    for (row, col), (weight, _, _) in cells.items():
        np.testing.assert_allclose(torus.sums[row % SIZE, col % SIZE, 0] / 2**20, weight, atol=1e-5)
    torus.insert(points, weights, pose, sign=-1)
    assert not torus.sums.any()
    assert not torus.field.any()


def test_a_scan_along_a_bare_corridor_matches_as_well_where_the_robot_went_as_where_it_was():
    bearings = np.radians(np.arange(-89.5, 90.0, 1.0))
    points = np.column_stack([np.cos(bearings), np.sin(bearings)]) / np.abs(np.sin(bearings))[:, None]
    points = points[(points[:, 0] > 2.5) & (points[:, 0] < 5.0)]
    torus = Torus()
    torus.insert(points, np.ones(len(points)), np.zeros(3))
    inner = points[points[:, 0] < 4.3]
    shares = [torus.match(inner, np.array([x, 0.0, 0.0])) for x in (0.0, 0.1, 0.17)]
    assert min(shares) > 0.9
