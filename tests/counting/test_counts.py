"""Counting by difference grids against the plain twin, and its laws."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynmap_cli.counting.counts import Counter, count_beams, count_up_to_walls, end_cells
from dynmap_cli.counting.frames import frame_of_scans
from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.poses import compose
from dynmap_cli.domain.scans import join_drives, single_laser_log
from dynmap_cli.errors import LogError
from tests.reference.counting import plain_alpha_beta, plain_beams


def random_world(seed, n_scans=4, n_beams=7, max_range=3.0):
    """A few scans with random ranges, some without return, some not measured."""
    rng = np.random.default_rng(seed)
    ranges = rng.uniform(0.1, max_range, (n_scans, n_beams)).astype(np.float32)
    ranges[rng.random(ranges.shape) < 0.1] = np.inf
    ranges[rng.random(ranges.shape) < 0.1] = np.nan
    poses = np.column_stack([rng.uniform(-1, 1, (n_scans, 2)), rng.uniform(-4, 4, n_scans)])
    log = single_laser_log(
        np.arange(n_scans) * 10**9,
        ranges,
        np.linspace(-2.0, 2.0, n_beams),
        np.full((n_scans, 3), np.nan),
        sensor_pose=(0.1, -0.05, 0.3),
        range_limits_m=(0.05, max_range),
    )
    weights = rng.uniform(0.0, 1.0, ranges.shape).astype(np.float32)
    return log, poses, weights


FRAME = GridFrame(0.1, -5.0, -5.0, 100, 100)


@given(st.integers(0, 10**6))
def test_counts_match_the_ray_by_ray_sums(seed):
    log, poses, weights = random_world(seed)
    counts = count_beams(log, poses, FRAME, 2.5, weights=weights)
    alpha, beta = plain_alpha_beta(plain_beams(log, poses, FRAME, 2.5), weights.astype(float), FRAME.shape)
    np.testing.assert_allclose(counts.static_hits, alpha, atol=1e-8)
    np.testing.assert_allclose(counts.dynamic_hits + counts.passed_cells, beta, atol=1e-8)


@given(st.integers(0, 10**6))
def test_lasers_of_fewer_beams_count_as_on_their_own(seed):
    """A drive with another laser leaves columns without a beam, which have neither range nor bearing."""
    drives = [random_world(seed, n_beams=5), random_world(seed + 1, n_beams=9)]
    later = replace(drives[1][0], stamps_ns=drives[1][0].stamps_ns + 10**12)
    log, poses = join_drives([drives[0][0], later]), np.concatenate([drives[0][1], drives[1][1]])
    both = count_beams(log, poses, FRAME, 2.5)
    parts = [count_beams(part, at, FRAME, 2.5) for part, at, _ in drives]
    for name in ("static_hits", "passed_cells"):
        np.testing.assert_allclose(getattr(both, name), sum(getattr(part, name) for part in parts), atol=1e-6)
    ended = end_cells(log, poses, FRAME, 2.5) >= 0
    assert not ended[log.drive_index == 0, 5:].any()


@given(st.integers(0, 10**6))
def test_beams_along_axes_and_through_corners_match_the_plain_twin(seed):
    """Beams along the axes and the diagonals from centres of cells."""
    rng = np.random.default_rng(seed)
    frame = GridFrame(0.125, -5.0, -5.0, 80, 80)
    ranges = (rng.integers(0, 16, (5, 8)) * 0.125).astype(np.float32)
    ranges[rng.random(ranges.shape) < 0.2] = np.inf
    poses = np.column_stack([rng.integers(-8, 9, (5, 2)) * 0.125 + 0.0625, rng.integers(0, 8, 5) * np.pi / 4])
    bearings = np.arange(8) * np.pi / 4
    log = single_laser_log(np.arange(5) * 10**9, ranges, bearings, poses, range_limits_m=(0.0, 4.0))
    counts = count_beams(log, poses, frame, 2.0)
    alpha, beta = plain_alpha_beta(plain_beams(log, poses, frame, 2.0), np.ones(ranges.shape), frame.shape)
    np.testing.assert_array_equal(counts.static_hits, alpha)
    np.testing.assert_allclose(counts.passed_cells, beta, atol=1e-8)


@given(st.integers(0, 10**6))
def test_beams_from_outside_count_where_they_cross_the_grid(seed):
    log, poses, weights = random_world(seed)
    poses[:2, 0] -= 3.5
    poses[2, 1] += 4.0
    wide = GridFrame(0.1, -9.0, -9.0, 180, 180)
    alpha, beta = plain_alpha_beta(plain_beams(log, poses, wide, 2.5), weights.astype(float), wide.shape)
    counts = count_beams(log, poses, wide.window(60, 60, 61, 59), 2.5, weights=weights)
    np.testing.assert_allclose(counts.static_hits, alpha[60:121, 60:119], atol=1e-8)
    np.testing.assert_allclose(counts.dynamic_hits + counts.passed_cells, beta[60:121, 60:119], atol=1e-8)


@given(st.integers(0, 10**6))
def test_a_small_grid_cuts_out_of_the_large_one(seed):
    log, poses, weights = random_world(seed)
    whole = count_beams(log, poses, FRAME, 2.5, weights=weights)
    cut = count_beams(log, poses, FRAME.window(40, 35, 13, 22), 2.5, weights=weights)
    np.testing.assert_allclose(cut.passed_cells, whole.passed_cells[40:53, 35:57], atol=1e-6)
    np.testing.assert_array_equal(cut.static_hits, whole.static_hits[40:53, 35:57])


@given(st.integers(0, 10**6))
def test_adding_scans_then_taking_them_out_leaves_every_byte(seed):
    log, poses, weights = random_world(seed)
    other, other_poses, _ = random_world(seed + 1)
    counter = Counter(FRAME)
    counter.add(log, poses, 2.5, weights=weights)
    before = counter.counting_map()
    counter.add(other, other_poses, 2.5)
    counter.add(other, other_poses, 2.5, sign=-1)
    after = counter.counting_map()
    for name in ("static_hits", "dynamic_hits", "passed_cells", "centroids_m"):
        assert getattr(before, name).tobytes() == getattr(after, name).tobytes()


def test_order_and_threads_change_no_byte():
    log, poses, weights = random_world(5, n_scans=5000, n_beams=5)
    order = np.random.default_rng(0).permutation(log.n_scans)
    one = count_beams(log, poses, FRAME, 2.5, weights=weights)
    two = count_beams(log, poses, FRAME, 2.5, weights=weights, threads=2)
    shuffled = Counter(FRAME)
    for scan in np.array_split(order, 7):
        part = np.sort(scan)
        shuffled.add(log.select(part), poses[part], 2.5, weights=weights[part])
    for name in ("static_hits", "dynamic_hits", "passed_cells", "centroids_m"):
        assert getattr(one, name).tobytes() == getattr(two, name).tobytes()
        assert getattr(one, name).tobytes() == getattr(shuffled.counting_map(), name).tobytes()


def test_turning_the_world_by_a_right_angle_turns_the_map():
    log, poses, weights = random_world(3)
    frame = GridFrame(0.1, -5.0, -5.0, 100, 100)
    turned = np.column_stack([-poses[:, 1], poses[:, 0], poses[:, 2] + np.pi / 2])
    here = count_beams(log, poses, frame, 2.5, weights=weights).passed_cells
    there = count_beams(log, turned, frame, 2.5, weights=weights).passed_cells
    np.testing.assert_allclose(np.rot90(here, -1), there, atol=1e-6)


def test_scans_without_a_pose_are_left_out():
    log, poses, _ = random_world(1)
    poses[2] = np.nan
    counts = count_beams(log, poses, FRAME, 2.5)
    rest = np.array([0, 1, 3])
    expected = count_beams(log.select(rest), poses[rest], FRAME, 2.5)
    np.testing.assert_array_equal(counts.passed_cells, expected.passed_cells)
    assert (end_cells(log, poses, FRAME, 2.5)[2] == -1).all()


def test_end_cells_are_where_the_hits_are_counted():
    log, poses, _ = random_world(2)
    cells = end_cells(log, poses, FRAME, 2.5)
    hits = np.bincount(cells[cells >= 0], minlength=100 * 100).reshape(100, 100)
    np.testing.assert_allclose(count_beams(log, poses, FRAME, 2.5).static_hits, hits, atol=1e-8)


@pytest.mark.parametrize("seed", range(5))
def test_the_frame_holds_every_end_point(seed):
    log, poses, _ = random_world(seed)
    frame = frame_of_scans(log, poses, 2.5, 0.05)
    ended = np.asarray(log.ranges_m) <= 2.5
    np.testing.assert_array_equal(end_cells(log, poses, frame, 2.5) >= 0, ended)


def test_a_beam_without_return_passes_no_wall_that_others_see():
    ranges = np.full((50, 1), 2.0, dtype=np.float32)
    ranges[7] = np.inf
    log = single_laser_log(np.arange(50), ranges, np.zeros(1), np.zeros((50, 3)), range_limits_m=(0.0, 4.0))
    poses = np.zeros((50, 3))
    row, wall = FRAME.to_cells(np.array([2.0, 0.0]))
    behind = count_up_to_walls(log, poses, FRAME, 4.0).passed_cells[row, wall + 1 :]
    before = count_up_to_walls(log, poses, FRAME, 4.0).passed_cells[row, wall - 5]
    assert behind.sum() == 0.0
    np.testing.assert_allclose(before, 50.0)
    assert count_beams(log, poses, FRAME, 4.0).passed_cells[row, wall + 1 :].sum() > 10.0


def test_a_sweep_made_while_driving_counts_as_beams_from_where_each_was_made():
    n_beams, interval, speed, turn = 40, 0.002, 1.5, 0.7
    rng = np.random.default_rng(6)
    log = replace(random_world(6, n_scans=3, n_beams=n_beams)[0], beam_interval_s=np.array([interval]))
    log = replace(log, stamps_ns=np.arange(3) * 10**8)
    twist = np.array([speed, 0.3, turn])
    poses = np.zeros((3, 3))
    poses[0] = [*rng.uniform(-0.5, 0.5, 2), 0.3]
    swept = count_beams(log, poses, FRAME, 2.5, twists=np.tile(twist, (3, 1)))
    one_by_one = Counter(FRAME)
    for beam in range(n_beams):
        alone = np.full_like(log.ranges_m, np.nan)
        alone[:, beam] = log.ranges_m[:, beam]
        there = compose(poses, beam * interval * twist)
        one_by_one.add(replace(log, ranges_m=alone), there, 2.5)
    np.testing.assert_allclose(swept.passed_cells, one_by_one.counting_map().passed_cells, atol=1e-6)
    np.testing.assert_array_equal(swept.static_hits, one_by_one.counting_map().static_hits)


@pytest.mark.parametrize("jump_m", [150.0, 1e4, 1e9, 1e300])
def test_a_path_that_jumps_is_refused(jump_m):
    poses = np.zeros((4, 3))
    poses[2:, 0] = jump_m
    log = single_laser_log(np.arange(4) * 10**8, np.ones((4, 1), np.float32), np.zeros(1), poses)
    with pytest.raises(LogError, match="recording: the path jumps by"):
        frame_of_scans(log, poses, 8.0, 0.05)


@pytest.mark.parametrize("far_m", [1e5, 1e9, 1e300])
@pytest.mark.parametrize("laser_pose", [True, False])
def test_scans_that_need_too_large_a_grid_are_refused(far_m, laser_pose):
    poses = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    if not laser_pose:
        poses[1, :2] = far_m
    log = single_laser_log(
        np.array([0, 2**62]),
        np.ones((2, 1), np.float32),
        np.zeros(1),
        poses,
        sensor_pose=(far_m if laser_pose else 0.0, 0.0, 0.0),
    )
    with pytest.raises(LogError, match=r"recording: .*(a grid has at most 1.2e\+08 cells|jumps)") as caught:
        frame_of_scans(log, poses, 8.0, 0.05)
    assert "\n" not in str(caught.value)
