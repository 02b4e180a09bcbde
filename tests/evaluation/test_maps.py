"""Laws of the measures of maps."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynmap_cli.counting.counts import end_cells
from dynmap_cli.counting.frames import frame_of_scans
from dynmap_cli.domain.grid import FREE, OCCUPIED, UNKNOWN, GridFrame, OccupancyGrid
from dynmap_cli.domain.poses import compose, inverse, transform_points
from dynmap_cli.domain.scans import single_laser_log
from dynmap_cli.evaluation.maps import align_maps, look_up_cells, score_map
from dynmap_cli.evaluation.sharpness import is_looked_through, line_sigmas_m, score_alone
from tests.evaluation.worlds import room


def plan(frame=None, seen_from=(0.0, 0.0, 0.0)):
    """An L-shaped flat with a partition, drawn on any frame, as seen from a turned and shifted map frame."""
    frame = frame or GridFrame(0.05, -1.0, -1.0, 200, 240)
    cells = np.argwhere(np.ones(frame.shape, dtype=bool))
    x, y = transform_points(np.array(seen_from), frame.to_points(cells)).T
    inside = (x > 0) & (x < 9) & (y > 0) & (y < 7) & ~((x > 5) & (y > 4))
    outer = (x > -0.08) & (x < 9.08) & (y > -0.08) & (y < 7.08) & ~((x > 5.08) & (y > 4.08))
    partition = (np.abs(x - 3) < 0.04) & (y < 2.5)
    values = np.full(frame.shape, UNKNOWN, dtype=np.int8)
    values[cells[inside, 0], cells[inside, 1]] = FREE
    walls = (outer & ~inside) | partition
    values[cells[walls, 0], cells[walls, 1]] = OCCUPIED
    return OccupancyGrid(frame, values)


def test_a_map_against_itself_is_perfect():
    values = score_map("self", plan(), plan()).values
    assert values["differing_share"] == 0.0
    for name in (
        "occupied_precision",
        "occupied_recall",
        "occupied_recall_where_seen",
        "known_share_of_reference",
    ):
        assert values[name] == 1.0, name


@settings(max_examples=4)
@given(st.floats(-3.1, 3.1), st.floats(-6, 6), st.floats(-6, 6))
def test_alignment_undoes_any_rigid_motion(yaw, x, y):
    pose = np.array([x, y, yaw])
    corners = transform_points(inverse(pose), np.array([[0.0, 0.0], [9.0, 0.0], [9.0, 7.0], [0.0, 7.0]]))
    low = np.floor(corners.min(axis=0)) - 1.0
    cols, rows = (np.ceil((np.ptp(corners, axis=0) + 3.0) / 0.05)).astype(int).tolist()
    turned = plan(GridFrame(0.05, low[0], low[1], rows, cols), pose)
    found = align_maps(turned, plan())
    np.testing.assert_allclose(compose(inverse(pose), found), 0.0, atol=0.03)
    values = score_map("turned", turned, plan()).values
    assert values["occupied_precision"] > 0.99
    assert values["occupied_recall"] > 0.99
    assert values["differing_share"] < 0.03


def test_a_missing_wall_lowers_the_recall_and_an_extra_one_the_precision():
    whole, other = plan(), plan()
    cells = other.cells.copy()
    cells[40:45, 100:180] = OCCUPIED
    extra = OccupancyGrid(other.frame, cells)
    assert score_map("extra", extra, whole).values["occupied_precision"] < 0.95
    assert score_map("extra", extra, whole).values["occupied_recall"] == 1.0
    assert score_map("missing", whole, extra).values["occupied_recall"] < 0.95


def test_an_empty_map_is_not_good():
    blank = OccupancyGrid(plan().frame, np.full(plan().cells.shape, UNKNOWN, dtype=np.int8))
    score = score_map("blank", blank, plan())
    assert not score.is_complete
    assert np.isnan(score.values["occupied_precision"])
    assert score.values["occupied_recall"] == 0.0


def test_outside_of_a_map_is_unknown():
    assert look_up_cells(plan(), np.array([[100.0, 0.0], [1.0, 1.0]])).tolist() == [UNKNOWN, FREE]


@pytest.mark.parametrize("sigma", [0.005, 0.02])
def test_thickness_is_the_spread_across_a_wall_of_any_direction(sigma):
    draw = np.random.default_rng(1)
    along, across = draw.uniform(0, 20, 40_000), draw.normal(0, sigma, 40_000)
    cos, sin = np.cos(0.6), np.sin(0.6)
    points = np.column_stack([cos * along - sin * across, sin * along + cos * across])
    assert np.exp(np.log(line_sigmas_m(points)).mean()) == pytest.approx(sigma, rel=0.05)


def test_noise_on_the_poses_shows_in_every_measure():
    run, _ = room()
    shaken = run.poses + np.random.default_rng(1).normal(0.0, 0.06, run.poses.shape)
    still, moved = (
        score_alone("still", run).values,
        score_alone("moved", replace(run, poses=shaken)).values,
    )
    assert moved["line_thickness_mm"] > still["line_thickness_mm"]
    assert moved["held_out_log_likelihood_per_beam"] < still["held_out_log_likelihood_per_beam"]
    assert moved["looked_through_share_of_kept"] >= still["looked_through_share_of_kept"]


def test_what_stood_there_only_once_is_looked_through():
    bearings = np.linspace(-0.2, 0.2, 41)
    ranges = np.full((100, 41), 4.0, dtype=np.float32)
    ranges[40:45] = 2.0
    stamps = np.arange(100, dtype=np.int64) * 10**8
    log = single_laser_log(stamps, ranges / np.cos(bearings).astype(np.float32), bearings, np.zeros((100, 3)))
    poses = np.zeros((100, 3))
    frame = frame_of_scans(log, poses, 30.0, 0.05)
    through = is_looked_through(log, poses, frame, end_cells(log, poses, frame, 30.0))
    assert through[40:45].mean() > 0.9
    assert not through[:40].any()
