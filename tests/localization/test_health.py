"""Lost, changed, or all well."""

import numpy as np
import pytest

from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.scans import single_laser_log
from dynmap_cli.kernels.novelties import clip_edges
from dynmap_cli.localization.beliefs.states import place_sweep
from dynmap_cli.localization.particles.particle_filter import ONE_MODE_SHARE, Estimate
from dynmap_cli.localization.sensing.map_pool import make_map_pool
from dynmap_cli.localization.sensing.sensor import sweep_of
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.localization.watching.health import (
    APART_M,
    CLIPPED_M,
    DOUBT,
    LOST,
    OVERSHOOT_M,
    SEARCH_AFTER,
    SETTLED_AFTER,
    Novelties,
    Patience,
    ScanHealth,
    Verdict,
    _count_places,
    lost_measure,
    scan_health,
)
from dynmap_cli.localization.watching.places import LEAST_BEAMS, NovelPlaces, main_place
from tests.localization.test_states import BEARINGS, POSE, evidence, log_of, ranges_in, world

FRAME = GridFrame(0.1, 0.0, 0.0, 50, 50)
SETTINGS = LocalizationSettings()
CALM = ScanHealth(0.95, 0.0, 0.05, 0.0, 0.0, 0.0)


def health_at(pose, shut, state):
    grid, patch_set = world()
    pool = make_map_pool(grid, [patch_set], SETTINGS)
    placed = place_sweep(sweep_of(log_of([shut]), 0, 30.0), np.asarray(pose))
    return scan_health(placed, pool, {0: state}, Novelties(pool), 0.0)


def changed_after_a_while(pool, ranges):
    """Share of the beams that show a change, when a robot stands and sees the same for six seconds."""
    log = single_laser_log(np.zeros(1, dtype=np.int64), ranges[None, :], BEARINGS, np.zeros((1, 3)))
    placed, novelties = place_sweep(sweep_of(log, 0, 30.0), POSE), Novelties(pool)
    return [scan_health(placed, pool, {0: 0}, novelties, 0.5 * k) for k in range(12)][-1].changed


def test_a_thing_that_stands_close_to_a_wall_is_a_change_and_the_wall_is_not():
    grid, patch_set = world()
    pool, wall = make_map_pool(grid, [patch_set], SETTINGS), ranges_in(True)
    ahead = np.abs(BEARINGS) > np.radians(60.0)
    assert changed_after_a_while(pool, wall) == 0.0
    assert changed_after_a_while(pool, wall - 0.05 * ahead) == 0.0
    assert changed_after_a_while(pool, wall - 0.22 * ahead) > 0.2


def test_a_thing_behind_the_edge_of_a_wall_is_a_thing_and_one_behind_its_middle_is_not():
    limits = np.array([OVERSHOOT_M, APART_M, CLIPPED_M])
    behind, along = np.full(6, 1.0), np.column_stack([np.full(6, 3.0), np.arange(6.0)])
    for step_m, is_edge in ((0.03, True), (0.1, False)):
        clips = np.empty(6, dtype=bool)
        clip_edges(behind, step_m * along, limits, clips)
        assert clips.tolist() == [is_edge] * 6


def estimate(share=1.0, spread_m=0.05):
    return Estimate(POSE, share, spread_m, spread_m)


def test_the_shares_sort_every_beam_once():
    for shut, state in ((True, 0), (True, 1), (False, 0), (False, 1)):
        health = health_at(POSE, shut, state)
        total = health.explained + health.explained_by_other_state + health.unexplained
        assert abs(total - 1) < 1e-9


def test_a_closed_door_that_is_believed_open_is_explained_by_the_other_state():
    assert health_at(POSE, True, 1).explained_by_other_state > 0.05
    assert health_at(POSE, True, 0).explained_by_other_state == 0.0
    assert health_at(POSE, True, 0).explained > 0.98


def test_an_open_door_is_no_sign_of_being_lost_but_a_wrong_pose_is():
    assert health_at(POSE, False, 0).through == 0.0
    assert lost_measure(health_at([0.8, 1.0, 0.6], False, 0)) > DOUBT


def test_neighbouring_beams_go_through_one_place_and_others_through_more():
    row = np.column_stack([np.linspace(0, 2, 20), np.zeros(20)])
    assert _count_places(row) == 1
    assert _count_places(row[[0, 1, 10, 11, 19]]) == 3
    assert _count_places(row[:0]) == 0


def test_beams_seen_through_a_surface_count_only_beyond_it():
    grid, patch_set = world()
    pool = make_map_pool(grid, [patch_set], SETTINGS)
    assert evidence(True, SETTINGS, pool).through[0] == 0.0


def beams_at(*points_m):
    """Three beams on each point."""
    return np.repeat(np.array(points_m), LEAST_BEAMS, axis=0)


def test_what_stays_in_place_is_a_change_and_what_moves_is_not():
    stays, moves = NovelPlaces(FRAME), NovelPlaces(FRAME)
    for k in range(14):
        staying = stays.see(beams_at([2.0, 2.0], [9.9, 9.9]), 0.5 * k)
        moving = moves.see(beams_at([0.3 * k, 2.0]), 0.5 * k)
    assert staying.tolist() == [True] * 3 + [False] * 3
    assert not moving.any()


def test_a_new_side_of_a_thing_is_as_old_as_the_thing():
    places = NovelPlaces(FRAME)
    for k in range(12):
        places.see(beams_at([2.1, 2.1]), 0.5 * k)
    found = places.see(beams_at([2.1, 2.1], [2.3, 2.1], [3.5, 2.1]), 6.0)
    assert found[::LEAST_BEAMS].tolist() == [True, True, False]


def test_a_thing_is_seen_by_three_beams_that_end_side_by_side():
    places = NovelPlaces(FRAME)
    row = np.array([[2.1, 2.1], [2.3, 2.3], [2.5, 2.3], [4.0, 4.0], [4.0, 4.1]])
    for k in range(12):
        found = places.see(row, 0.5 * k)
    assert found.tolist() == [True] * 3 + [False] * 2


def test_a_gap_that_is_seen_piece_by_piece_is_as_old_as_its_first_piece_and_a_thing_is_not():
    gap, thing = NovelPlaces(FRAME, is_fixed=True), NovelPlaces(FRAME)
    for k in range(12):
        along = beams_at([0.3 + 0.1 * k, 2.0])
        in_gap, on_thing = gap.see(along, 0.5 * k), thing.see(along, 0.5 * k)
    assert in_gap.all()
    assert not on_thing.any()


def test_the_place_of_a_change():
    things = np.array([[1.0, 1.0], [1.1, 1.0], [1.2, 1.1], [4.0, 4.0]])
    opening = np.array([[3.0, 3.0], [3.1, 3.0]])
    assert str(main_place(things, opening, ())) == "object 1.1 1.0"
    assert str(main_place(things[3:], opening, ())) == "opening 3.0 3.0"
    assert main_place(things[:0], things[:0], ()) is None
    grid, patch_set = world()
    submaps = make_map_pool(grid, [patch_set], SETTINGS).submaps
    x0, y0, x1, y1 = submaps[0].rectangle_m
    inside = np.array([[(x0 + x1) / 2, (y0 + y1) / 2]])
    assert str(main_place(inside, opening[:0], submaps)) == f"sub-map {submaps[0].submap_id}"


def test_verdicts():
    for scan, expected, where in (
        (CALM, "tracking", estimate()),
        (ScanHealth(0.5, 0.0, 0.5, 0.0, 0.0, 0.0), "tracking", estimate()),
        (ScanHealth(0.5, 0.0, 0.5, 0.0, 0.0, 0.3), "changed", estimate()),
        (ScanHealth(0.8, 0.0, 0.2, 0.15, 0.0, 0.0), "lost", estimate()),
        (ScanHealth(0.8, 0.0, 0.2, 0.05, 0.05, 0.2), "changed", estimate()),
        (CALM, "lost", estimate(share=0.5)),
    ):
        assert Verdict().judge(scan, where) == expected


def test_the_measure_is_that_of_scans_and_of_what_lies_elsewhere():
    verdict = Verdict()
    assert verdict.judge(CALM, estimate()) == "tracking"
    of_scans = verdict.measure
    assert of_scans == lost_measure(CALM)
    verdict.judge(CALM, estimate(share=ONE_MODE_SHARE))
    assert verdict.measure == pytest.approx(of_scans + LOST)
    verdict.judge(CALM, estimate())
    verdict.found_elsewhere()
    assert verdict.measure == pytest.approx(of_scans + LOST)


def test_what_lies_where_the_map_knows_nothing_speaks_for_no_wrong_pose():
    assert lost_measure(ScanHealth(0.2, 0.0, 0.8, 0.0, 0.0, 0.0, off_map=0.8)) == 0.0
    assert lost_measure(ScanHealth(0.2, 0.0, 0.8, 0.1, 0.0, 0.0, off_map=0.6)) > DOUBT


def test_a_scan_of_which_the_map_can_judge_little_changes_no_verdict():
    verdict = Verdict()
    lost = ScanHealth(0.7, 0.0, 0.3, 0.2, 0.0, 0.0)
    unknown = ScanHealth(0.1, 0.0, 0.9, 0.0, 0.0, 0.0, off_map=0.85)
    assert [verdict.judge(scan, estimate()) for scan in (lost, unknown, unknown)] == ["lost"] * 3


def test_a_beam_through_a_wall_says_less_where_the_map_knows_nothing_behind_it():
    into_the_free = lost_measure(ScanHealth(0.9, 0.0, 0.1, 0.1, 0.0, 0.0))
    into_the_unknown = lost_measure(ScanHealth(0.9, 0.0, 0.1, 0.0, 0.1, 0.0))
    on_nothing = lost_measure(CALM)
    assert into_the_free > into_the_unknown > on_nothing > 0.0


def test_one_bad_scan_among_six_is_no_loss_and_no_doubt():
    verdict = Verdict()
    said = [
        verdict.judge(ScanHealth(0.9, 0.0, 0.1, share, 0.0, 0.0), estimate())
        for share in (0, 0, 0.1, 0, 0, 0)
    ]
    assert said[-1] == "tracking"
    assert not verdict.is_in_doubt


def test_where_a_start_was_given_the_robot_is_searched_for_at_once():
    patience = Patience(is_given=True)
    assert patience.is_over(is_in_doubt=False)
    assert not patience.is_over(is_in_doubt=False)


def test_patience_grows_with_every_search_and_is_short_again_after_a_time_without_doubt():
    patience = Patience()
    waits, waited = [], 0
    for _ in range(SEARCH_AFTER * 7):
        waited += 1
        if patience.is_over(is_in_doubt=True):
            waits.append(waited)
            waited = 0
    assert waits == [SEARCH_AFTER, 2 * SEARCH_AFTER, 4 * SEARCH_AFTER]
    assert not any(patience.is_over(is_in_doubt=False) for _ in range(SETTLED_AFTER))
    assert [patience.is_over(is_in_doubt=True) for _ in range(SEARCH_AFTER)][-1]
