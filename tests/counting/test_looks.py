"""Looks: who stands for a while is told from glass, which reflects a part of the beams all the time."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynmap_cli.counting.counts import frame_of_scans
from dynmap_cli.counting.em import FilterParams, expectation_of, filter_beams
from dynmap_cli.counting.evidence import EvidenceParams
from dynmap_cli.counting.looks import count_looks, filter_by_looks, time_windows
from dynmap_cli.domain.scans import single_laser_log

N_SCANS, RATE_HZ, WALL_M, THING_M = 600, 10, 3.0, 2.0
LOOK_S, LOOK_PRIOR = 5.0, 0.8


def scene(is_there):
    """One minute before a wall; *is_there* (n_scans, n_beams) says which beams meet a thing in front of it."""
    bearings = np.radians(np.linspace(-4.0, 4.0, 9))
    ranges = np.where(is_there, THING_M, WALL_M) / np.cos(bearings)
    stamps_ns = np.arange(N_SCANS) * (10**9 // RATE_HZ)
    return single_laser_log(stamps_ns, ranges.astype(np.float32), bearings, np.zeros((N_SCANS, 3)))


def filtered(log):
    poses = log.odometry.copy()
    frame = frame_of_scans(log, poses, 30.0, 0.05)
    by_beams = filter_beams(log, poses, frame, FilterParams())
    by_looks = filter_by_looks(
        by_beams, log, poses, look_s=LOOK_S, look_prior=LOOK_PRIOR, usable_range_m=30.0
    )
    return by_beams, by_looks


def standing(first_s, last_s):
    times_s = np.arange(N_SCANS) / RATE_HZ
    return np.repeat(((times_s >= first_s) & (times_s < last_s))[:, None], 9, axis=1)


@pytest.mark.parametrize("seconds", [5, 10, 20])
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
    np.testing.assert_array_equal(by_looks.static_probability, by_beams.static_probability)


def test_a_wall_that_stops_to_answer_is_not_seen_free():
    is_there = standing(12, 22)
    log = scene(is_there)
    ranges = np.where(is_there, log.ranges_m, np.float32(np.inf))
    by_beams, by_looks = filtered(replace(log, ranges_m=ranges))
    np.testing.assert_array_equal(by_looks.static_probability, by_beams.static_probability)


def test_what_is_there_half_of_the_time_stays():
    is_there = standing(0, 30)
    assert (filtered(scene(is_there))[1].static_probability > 0.5).all()


def test_a_place_seen_free_too_rarely_says_nothing():
    is_there = standing(0, 50)
    by_beams, by_looks = filtered(scene(is_there))
    np.testing.assert_array_equal(by_looks.static_probability, by_beams.static_probability)


def test_hits_are_neither_lost_nor_made():
    by_beams, by_looks = filtered(scene(standing(12, 22)))
    before, after = by_beams.counting_map, by_looks.counting_map
    np.testing.assert_allclose(
        after.static_hits + after.dynamic_hits, before.static_hits + before.dynamic_hits
    )
    np.testing.assert_array_equal(after.passed_cells, before.passed_cells)
    assert (after.static_hits <= before.static_hits).all()
    assert by_looks.static_probability.shape == by_beams.static_probability.shape


def test_looks_are_counted_once_per_window():
    log = scene(standing(10, 20))
    poses = log.odometry.copy()
    looks = count_looks(log, poses, frame_of_scans(log, poses, 30.0, 0.05), LOOK_S, EvidenceParams())
    assert looks.n_looks == len(time_windows(log, LOOK_S)) == 12
    assert (looks.occupied + looks.free <= 12).all()
    distance_m = np.linalg.norm(looks.surface.frame.to_points(looks.surface.cells) - [THING_M, 0.0], axis=1)
    nearest = distance_m.argmin()
    assert (looks.occupied[nearest], looks.free[nearest]) == (2, 10)


@given(share=st.floats(0.0, 1.0), other=st.floats(0.0, 1.0), prior=st.floats(0.51, 0.99))
def test_expectation_rises_with_the_share_and_crosses_one_half_at_the_threshold(share, other, prior):
    low, high = expectation_of(np.array([[min(share, other), max(share, other)]]), prior)[0]
    assert 0.0 <= low <= high <= 1.0
    at_threshold = expectation_of(np.array([[2.0 * (1.0 - prior)]]), prior)[0, 0]
    assert at_threshold == pytest.approx(0.5, abs=1e-9)
