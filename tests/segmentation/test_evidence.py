"""What counts as evidence: kernels against their plain twins, and the rule about grazing beams."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynmap_cli.counting.counts import twists_of
from dynmap_cli.counting.evidence import Evidence, EvidenceParams, surface_cells
from dynmap_cli.domain.grid import FREE, OCCUPIED, UNKNOWN, GridFrame
from dynmap_cli.domain.poses import compose
from dynmap_cli.domain.scans import single_laser_log
from dynmap_cli.kernels.regions import judge_cells, segment_is_blocked, surface_normals
from tests.reference.regions import plain_evidence, plain_normal, plain_states

FRAME = GridFrame(0.1, -1.0, -1.0, 24, 26)
BEARINGS = np.deg2rad(np.arange(-180.0, 180.0, 5.0))


def random_log(seed, n_scans=6):
    draw = np.random.default_rng(seed)
    ranges = draw.uniform(0.05, 2.5, (n_scans, BEARINGS.size)).astype(np.float32)
    ranges[draw.random(ranges.shape) < 0.1] = np.inf
    ranges[draw.random(ranges.shape) < 0.1] = np.nan
    poses = np.column_stack([draw.uniform(-1.5, 1.8, (n_scans, 2)), draw.uniform(-3, 3, n_scans)])
    stamps = np.arange(n_scans) * 10**8
    log = single_laser_log(stamps, ranges, BEARINGS, np.full((n_scans, 3), np.nan), range_limits_m=(0.0, 3.0))
    return log, poses


@pytest.mark.parametrize("interval_s", [0.002, -0.002])
def test_each_beam_of_a_sweep_starts_where_the_robot_is_by_then(interval_s):
    log, _ = random_log(7)
    log = replace(log, beam_interval_s=np.full_like(log.beam_interval_s, interval_s))
    yaw = 0.08 * np.arange(log.n_scans)
    poses = np.column_stack([0.02 * np.arange(log.n_scans), np.zeros(log.n_scans), yaw])
    rule = EvidenceParams(max_range_m=2.0, occupied_hits=1.0)
    surface = surface_cells(log, poses, FRAME, [slice(None)], rule)
    evidence = Evidence(surface, rule)
    evidence.add(log, poses)
    twists = twists_of(log, poses)
    twists[-1] = twists[-2]
    beams = []
    for pose, twist, ranges in zip(poses, twists, log.ranges_m, strict=True):
        for beam, distance in enumerate(ranges):
            elapsed_s = (beam if interval_s > 0 else beam - ranges.size + 1) * interval_s
            x, y, turned = compose(pose, elapsed_s * twist)
            beams.append((x, y, turned + BEARINGS[beam], float(distance)))
    hits, crossed = plain_evidence(beams, surface, math.sin(rule.min_crossing_rad), rule.beyond_m, 2.0)
    np.testing.assert_array_equal(evidence.hits, hits)
    np.testing.assert_allclose(evidence.crossed, crossed, atol=1e-6)


@settings(max_examples=25)
@given(st.integers(0, 10_000), st.sampled_from([1.0, 3.0]))
def test_hits_and_crossed_lengths_are_those_of_plain_geometry(seed, occupied_hits):
    log, poses = random_log(seed)
    # With three hits few cells are left, and beams leap far between them.
    rule = EvidenceParams(max_range_m=2.0, occupied_hits=occupied_hits, free_cells=1.0)
    surface = surface_cells(log, poses, FRAME, [slice(None)], rule)
    evidence = Evidence(surface, rule)
    evidence.add(log, poses)
    beams = [
        (x, y, yaw + bearing, float(distance))
        for (x, y, yaw), ranges in zip(poses, log.ranges_m, strict=True)
        for bearing, distance in zip(BEARINGS, ranges, strict=True)
    ]
    hits, crossed = plain_evidence(beams, surface, math.sin(rule.min_crossing_rad), rule.beyond_m, 2.0)
    np.testing.assert_array_equal(evidence.hits, hits)
    np.testing.assert_allclose(evidence.crossed, crossed, atol=1e-6)
    states = plain_states(evidence.hits, evidence.crossed, FRAME.shape, surface.cells, rule)
    np.testing.assert_array_equal(evidence.states(), states)


@given(st.integers(0, 10_000))
def test_other_cells_know_how_far_the_nearest_surface_cell_is(seed):
    log, poses = random_log(seed)
    surface = surface_cells(log, poses, FRAME, [slice(None)], EvidenceParams())
    if surface.cells.size:
        for row, col in np.argwhere(surface.index < 0):
            assert surface.index[row, col] == -np.abs(surface.cells - [row, col]).max(axis=1).min()


@given(st.integers(0, 10_000))
def test_evidence_of_parts_adds_up(seed):
    log, poses = random_log(seed)
    rule = EvidenceParams(max_range_m=2.0, occupied_hits=1.0)
    surface = surface_cells(log, poses, FRAME, [slice(None)], rule)
    whole, first, second = (Evidence(surface, rule) for _ in range(3))
    whole.add(log, poses)
    first.add(log.select(slice(0, 3)), poses[:3])
    second.add(log.select(slice(3, None)), poses[3:])
    first.merge(second)
    np.testing.assert_allclose(first.crossed, whole.crossed, atol=1e-12)
    np.testing.assert_array_equal(first.states(), whole.states())
    first.clear()
    assert first.hits.sum() == first.crossed.sum() == first.judge()[0].size == 0


def test_cells_without_hits_enough_in_any_window_are_left_out():
    log, poses = random_log(3)
    apart = surface_cells(log, poses, FRAME, [slice(k, k + 1) for k in range(6)], EvidenceParams())
    together = surface_cells(log, poses, FRAME, [slice(None)], EvidenceParams())
    assert len(apart.cells) <= len(together.cells)
    assert surface_cells(log, poses, FRAME, [], EvidenceParams()).cells.shape == (0, 2)


def numbered(hits, offset_x, offset_y):
    """The same grids as the kernels take them: numbers of the cells that have hits, and sums by number."""
    numbers = np.zeros(hits.shape, dtype=np.int32)
    numbers[hits > 0] = np.arange(1, np.count_nonzero(hits) + 1)
    moments = np.zeros((hits.size + 1, 3))
    moments[numbers[hits > 0]] = np.stack([hits, offset_x, offset_y], axis=-1)[hits > 0]
    return numbers, moments


@given(st.floats(-math.pi, math.pi), st.floats(0.0, 0.02))
def test_the_normal_is_that_of_the_line_of_hits(angle, noise):
    draw = np.random.default_rng(1)
    along = np.linspace(-0.35, 0.35, 60)
    across = noise * draw.standard_normal(60)
    points = np.column_stack(
        [np.cos(angle) * along - np.sin(angle) * across, np.sin(angle) * along + np.cos(angle) * across]
    )
    cells = 10.5 + points * 10.0
    hits, offset_x, offset_y = (np.zeros((21, 21)) for _ in range(3))
    for x, y in cells:
        hits[int(y), int(x)] += 1
        offset_x[int(y), int(x)] += x % 1
        offset_y[int(y), int(x)] += y % 1
    out = np.empty((1, 2))
    surface_normals(np.array([[10, 10]]), *numbered(hits, offset_x, offset_y), 4, 0.3, out)
    expected, _ = plain_normal(points)
    assert abs(out[0] @ expected) > math.cos(math.radians(3.0))


def test_a_blob_has_no_normal():
    hits, offset = np.ones((9, 9)), np.full((9, 9), 0.5)
    out = np.empty((1, 2))
    surface_normals(np.array([[4, 4]]), *numbered(hits, offset, offset), 3, 0.3, out)
    np.testing.assert_array_equal(out, 0.0)


def wall_and_pose(angle_deg, overshoot_m):
    """A wall at y = 1.05; a beam that crosses it at an angle and ends *overshoot_m* behind the crossing."""
    along = np.linspace(-0.9, 1.5, 49)
    poses = np.array(
        [[0.0, 0.0, math.pi / 2]] * 3 + [[0.3, 1.05 - 0.5 * math.sin(math.radians(angle_deg)), 0.0]]
    )
    bearings = np.concatenate([np.arctan2(1.05, along) - math.pi / 2, [math.radians(angle_deg)]])
    ranges = np.full((4, bearings.size), np.nan, dtype=np.float32)
    ranges[:3, :-1] = np.hypot(along, 1.05)
    ranges[3, -1] = 0.5 + overshoot_m
    log = single_laser_log(np.arange(4) * 10**8, ranges, bearings, np.full((4, 3), np.nan))
    return log, poses


@pytest.mark.parametrize(
    ("angle_deg", "overshoot_m", "is_evidence"),
    [(60.0, 1.0, True), (25.0, 1.0, True), (15.0, 1.0, False), (60.0, 0.2, False)],
)
def test_only_beams_that_cross_steeply_and_end_well_beyond_are_evidence(angle_deg, overshoot_m, is_evidence):
    log, poses = wall_and_pose(angle_deg, overshoot_m)
    rule = EvidenceParams()
    surface = surface_cells(log, poses, FRAME, [slice(0, 3)], rule)
    wall = surface.cells[:, 0] == 20
    assert wall.sum() > 20
    evidence = Evidence(surface, rule)
    evidence.add(log.select(slice(3, None)), poses[3:])
    assert (evidence.crossed[wall].sum() > 0.5) == is_evidence


def test_tri_state_needs_evidence_and_quiet_neighbours():
    neighbours = np.array([[0, 1], [1, 0], [2, -1], [3, -1]], dtype=np.int32)
    hits, crossed = np.array([3.0, 0.0, 0.0, 2.0]), np.array([4.5, 9.0, 9.0, 0.0])
    out = np.empty(4, dtype=np.int8)
    judge_cells(hits, crossed, neighbours, np.arange(4), 4, 0.4, 3.0, 0.15, 5.0, out)
    assert out.tolist() == [OCCUPIED, UNKNOWN, FREE, UNKNOWN]


def test_only_cells_between_the_ends_block_the_sight():
    blocking = np.zeros((5, 9), dtype=np.int8)
    blocking[2, 4] = 1
    assert segment_is_blocked(0.5, 2.5, 8.5, 2.5, blocking)
    assert not segment_is_blocked(4.5, 2.5, 8.5, 2.5, blocking)
    assert not segment_is_blocked(0.5, 2.5, 4.5, 2.5, blocking)
    assert not segment_is_blocked(0.5, 0.5, 8.5, 0.5, blocking)
