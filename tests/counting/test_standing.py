"""Who stands for a while is told from glass, which reflects a part of the beams all the time."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynmap_cli.counting.em import FilterParams, expectation_of, filter_beams
from dynmap_cli.counting.frames import frame_of_scans
from dynmap_cli.counting.standing import LookParams, filter_by_looks
from dynmap_cli.domain.scans import single_laser_log
from dynmap_cli.kernels.standing import count_kept, judge_beams
from tests.counting.scenes import N_SCANS, RATE_HZ, THING_M, WALL_M, scene, standing

PAUSE_S = 1000.0
DEFAULTS = LookParams()


def filtered(log, params=DEFAULTS):
    poses = log.odometry.copy()
    frame = frame_of_scans(log, poses, 30.0, 0.05)
    by_beams = filter_beams(log, poses, frame, FilterParams())
    return by_beams, filter_by_looks(by_beams, log, poses, params, usable_range_m=30.0)


@pytest.mark.parametrize("seconds", [5, 10, 20, 30])
def test_who_stands_for_a_while_is_found(seconds):
    is_there = standing(12, 12 + seconds)
    by_beams, by_looks = filtered(scene(is_there))
    assert (by_looks.static_probability[is_there] < 0.5).all()
    assert (by_looks.static_probability[~is_there] > 0.5).all()
    if seconds >= 10:
        assert (by_beams.static_probability[is_there] > 0.5).all()


def test_glass_stays():
    is_there = np.random.default_rng(2).random((N_SCANS, 9)) < 0.3
    by_beams, by_looks = filtered(scene(is_there))
    assert (by_looks.static_probability > 0.5).all()
    assert (by_looks.static_probability >= by_beams.static_probability).all()


def test_a_wall_that_stops_to_answer_is_not_seen_free():
    is_there = standing(12, 22)
    log = scene(is_there)
    ranges = np.where(is_there, log.ranges_m, np.float32(np.inf))
    by_beams, by_looks = filtered(replace(log, ranges_m=ranges))
    assert (by_beams.static_probability[is_there] > 0.5).all()
    assert (by_looks.static_probability[is_there] > 0.5).all()


def test_what_was_there_on_one_of_two_visits_stays():
    is_there = standing(0, 30)
    _, by_looks = filtered(scene(is_there, pause_s=PAUSE_S))
    assert (by_looks.static_probability > 0.5).all()


def test_who_leaves_while_watched_is_found():
    is_there = standing(0, 30)
    _, by_looks = filtered(scene(is_there))
    assert (by_looks.static_probability[is_there] < 0.5).all()
    assert (filtered(scene(is_there), LookParams(watch_s=0.0))[1].static_probability > 0.5).all()


def test_a_place_seen_free_too_rarely_says_nothing():
    is_there = standing(0, 50)
    by_looks = filtered(scene(is_there))[1]
    assert (by_looks.static_probability > 0.5).all()


@pytest.mark.parametrize(("first_m", "is_found"), [(0.0, False), (0.5, True)])
def test_what_hangs_on_a_wall_is_no_thing_of_its_own(first_m, is_found):
    """Half of the time something slants out of the wall, as a door leaf does, or stands before it."""
    bearings = np.radians(np.linspace(-40.0, 40.0, 161))
    is_there = np.zeros((N_SCANS, 161), dtype=bool)
    is_there[: N_SCANS // 2, 60:90] = True
    before_wall_m = np.zeros((N_SCANS, 161))
    before_wall_m[: N_SCANS // 2, 60:90] = np.linspace(first_m, 1.0, 30)
    ranges = (WALL_M - before_wall_m) / np.cos(bearings)
    stamps_ns = np.arange(N_SCANS) * (10**9 // RATE_HZ)
    log = single_laser_log(stamps_ns, ranges.astype(np.float32), bearings, np.zeros((N_SCANS, 3)))
    is_dynamic = filtered(log)[1].static_probability < 0.5
    assert not is_dynamic[~is_there].any()
    assert is_dynamic[is_there].mean() > 0.9 if is_found else not is_dynamic.any()


def test_what_only_grazing_beams_contradict_stays():
    """Beams that end less than 0.3 m behind a place do not say that it was free."""
    is_there = standing(0, 3)
    log = scene(is_there, thing_m=2.85)
    without = filtered(log, LookParams(crossing_prior=0.0))[1]
    assert (without.static_probability[is_there] < 0.5).all()
    assert (filtered(log)[1].static_probability[is_there] > 0.5).all()


def test_a_small_thing_seen_once_is_unknown_and_a_wall_is_not():
    bearings = np.radians(np.linspace(-40.0, 40.0, 161))
    is_there = np.zeros((200, 161), dtype=bool)
    is_there[:, 75:86] = True
    ranges = np.where(is_there, THING_M, WALL_M) / np.cos(bearings)
    stamps_ns = np.arange(200) * (10**9 // RATE_HZ)
    _, by_looks = filtered(
        single_laser_log(stamps_ns, ranges.astype(np.float32), bearings, np.zeros((200, 3)))
    )
    assert (by_looks.static_probability > 0.5).all()
    assert by_looks.is_unknown[is_there].all()
    assert (by_looks.static_probability[is_there] <= 0.9 + 1e-6).all()
    is_wall = np.abs(bearings) > np.radians(8.0)
    assert not by_looks.is_unknown[:, is_wall].any()


@pytest.mark.parametrize(("shift_m", "is_found"), [(0.2, True), (0.0, False)])
def test_who_shifts_while_standing_is_found(shift_m, is_found):
    """Half a metre wide, in view for 35 seconds, and never gone."""
    bearings = np.radians(np.linspace(-40.0, 40.0, 161))
    middle_m = shift_m * (np.arange(350) // 100 % 2)
    is_there = np.abs(THING_M * np.tan(bearings) - middle_m[:, None]) < 0.25
    ranges = np.where(is_there, THING_M, WALL_M) / np.cos(bearings)
    stamps_ns = np.arange(350) * (10**9 // RATE_HZ)
    log = single_laser_log(stamps_ns, ranges.astype(np.float32), bearings, np.zeros((350, 3)))
    by_looks = filtered(log)[1]
    is_dynamic = by_looks.static_probability < 0.5
    assert not is_dynamic[~is_there].any()
    assert (is_dynamic[is_there].mean() > 0.9) == is_found
    assert (by_looks.is_unknown[is_there].mean() > 0.9) != is_found


def test_a_small_thing_seen_again_is_static():
    is_there = standing(0, 60, slice(3, 6))
    _, by_looks = filtered(scene(is_there, pause_s=PAUSE_S))
    assert (by_looks.static_probability > 0.5).all()
    assert not by_looks.is_unknown[is_there].any()


def test_what_is_called_dynamic_is_not_unknown():
    _, by_looks = filtered(scene(standing(12, 22)))
    assert not (by_looks.is_unknown & (by_looks.static_probability < 0.5)).any()


def test_hits_are_neither_lost_nor_made():
    by_beams, by_looks = filtered(scene(standing(12, 22)))
    before, after = by_beams.counting_map, by_looks.counting_map
    np.testing.assert_allclose(
        after.static_hits + after.dynamic_hits, before.static_hits + before.dynamic_hits
    )
    np.testing.assert_array_equal(after.passed_cells, before.passed_cells)
    assert (after.static_hits <= before.static_hits).all()
    assert by_looks.static_probability.shape == by_beams.static_probability.shape


def test_the_map_counts_the_beams_with_their_e():
    _, by_looks = filtered(scene(standing(12, 22)))
    np.testing.assert_allclose(
        by_looks.counting_map.static_hits.sum(), by_looks.static_probability.sum(dtype=np.float64), rtol=1e-6
    )


@given(share=st.floats(0.0, 1.0), other=st.floats(0.0, 1.0), prior=st.floats(0.51, 0.99))
def test_expectation_rises_with_the_share_and_crosses_one_half_at_the_threshold(share, other, prior):
    low, high = expectation_of(np.array([[min(share, other), max(share, other)]]), prior)[0]
    assert 0.0 <= low <= high <= 1.0
    at_threshold = expectation_of(np.array([[2.0 * (1.0 - prior)]]), prior)[0, 0]
    assert at_threshold == pytest.approx(0.5, abs=1e-9)


@given(st.integers(0, 2**32 - 1))
def test_beams_are_judged_as_by_the_plain_rules(seed):
    draw = np.random.default_rng(seed)
    n_cells, shape = 12, (5, 7)
    cells = draw.integers(-1, n_cells, shape).astype(np.int32)
    by_beams, least, most, places, things = (
        (draw.integers(0, 9, size) / 8).astype(np.float32)
        for size in (shape, n_cells, n_cells, n_cells, n_cells)
    )
    by_beams[cells < 0] = np.nan
    can_be_open = draw.integers(0, 2, n_cells).astype(np.uint8)
    hits, expected_hits = np.zeros(n_cells), np.zeros(n_cells)
    expected_e, expected_open = np.full(shape, np.nan, dtype=np.float32), np.zeros(shape, dtype=bool)
    for at in zip(*np.nonzero(cells >= 0), strict=True):
        cell = cells[at]
        e = min(max(by_beams[at], least[cell]), most[cell])
        expected_hits[cell] += e >= 0.5
        is_open = e >= 0.5 and bool(can_be_open[cell])
        e = min([e, places[cell], *([things[cell], np.float32(0.9)] if is_open else [])])
        expected_e[at], expected_open[at] = max(e, np.float32(0.01)), is_open and e >= 0.5
    count_kept(cells, by_beams, least, most, hits)
    np.testing.assert_array_equal(hits, expected_hits)
    is_open = np.ones(shape, dtype=bool)
    bounds = float(np.float32(0.9)), float(np.float32(0.01))
    judge_beams(cells, by_beams, least, most, places, things, can_be_open, *bounds, by_beams, is_open)
    np.testing.assert_array_equal(by_beams, expected_e)
    np.testing.assert_array_equal(is_open, expected_open)
