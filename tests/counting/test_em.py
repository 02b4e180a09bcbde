"""The EM filter against Eq. 1.6-1.15 as printed, and its laws."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynmap_cli.counting.counts import count_beams
from dynmap_cli.counting.em import (
    FilterParams,
    em_step,
    expected_log_likelihood,
    filter_beams,
    fixed_point,
)
from dynmap_cli.domain.grid import CountingMap
from dynmap_cli.kernels.em import add_to_cells, static_probability
from tests.counting.test_counts import FRAME, random_world
from tests.reference.counting import (
    plain_alpha_beta,
    plain_beams,
    plain_fixed_point,
    plain_log_likelihood,
    plain_static_probability,
)

share = st.floats(0.0, 1.0)
prior = st.floats(0.51, 0.99)


@given(m=share, p=prior)
def test_static_probability_matches_the_printed_equation(m, p):
    out = np.empty(1)
    static_probability(np.array([m]), p, out)
    np.testing.assert_allclose(out[0], plain_static_probability(m, p), atol=1e-12)


@given(m=share, n=share, p=prior)
def test_a_more_reflective_end_cell_is_never_less_static(m, n, p):
    out = np.empty(2)
    static_probability(np.array([min(m, n), max(m, n)]), p, out)
    assert out[0] <= out[1]


@pytest.mark.parametrize("h", [0.0, 0.02, 0.04, 0.07, 0.1, 0.3, 0.526, 0.8, 1.0])
@pytest.mark.parametrize("em", ["closed", "iterative"])
def test_the_fixed_point_is_where_many_plain_steps_end(h, em):
    m = fixed_point(np.array([[h * 40.0]]), np.array([[(1 - h) * 40.0]]), FilterParams(em=em))
    np.testing.assert_allclose(m[0, 0], plain_fixed_point(h, 0.95), atol=1e-9)


@given(p=prior, h=share)
def test_a_cell_survives_iff_its_hit_share_is_over_the_odds_against(p, h):
    m = fixed_point(np.array([[h]]), np.array([[1 - h]]), FilterParams(static_prior=p))[0, 0]
    if abs(h - (1 - p) / p) > 1e-9:
        assert (m > 0) == (h > (1 - p) / p)


@given(st.integers(0, 10**6))
def test_m_step_and_likelihood_match_the_printed_sums(seed):
    log, poses, weights = random_world(seed)
    beams = plain_beams(log, poses, FRAME, 2.5)
    alpha, beta = plain_alpha_beta(beams, weights.astype(float), FRAME.shape)
    counts = count_beams(log, poses, FRAME, 2.5, weights=weights)
    seen = alpha + beta > 0
    expected = alpha[seen] / (alpha + beta)[seen]
    np.testing.assert_allclose(counts.reflectance[seen], expected, atol=1e-9)
    m = np.zeros(FRAME.shape)
    m[seen] = expected
    plain = plain_log_likelihood(beams, weights.astype(float), m)
    np.testing.assert_allclose(expected_log_likelihood(counts), plain, rtol=1e-9, atol=1e-9)


@given(
    st.lists(
        st.tuples(st.integers(0, 50), st.floats(0.0, 50.0).map(lambda x: round(x, 6))),
        min_size=1,
        max_size=30,
    ),
    prior,
)
def test_likelihood_never_falls_at_fixed_poses(cells, p):
    hits = np.array([float(h) for h, _ in cells])
    passed = np.array([length for _, length in cells])
    seen = hits + passed > 0
    hits, passed = hits[seen], passed[seen]
    if hits.size == 0:
        return
    h = hits / (hits + passed)
    m, values = h * p, []
    for _ in range(30):
        alpha = m * (hits + passed)
        counts = CountingMap.of_grids(FRAME, alpha, hits - alpha, passed, np.zeros((*alpha.shape, 2)))
        values.append(expected_log_likelihood(counts))
        m = em_step(m, h, p)
    assert (np.diff(values) >= -1e-9 * max(1.0, abs(values[0]))).all()


def test_without_support_it_is_the_paper_to_the_letter():
    log, poses, _ = random_world(7, n_scans=30)
    params = FilterParams(support_cells=0, usable_range_m=2.5, stop_at_walls=False)
    result = filter_beams(log, poses, FRAME, params)
    raw = count_beams(log, poses, FRAME, 2.5)
    with np.errstate(invalid="ignore"):
        share_of_hits = raw.static_hits / (raw.static_hits + raw.passed_cells)
    for scan, beam, _, end in plain_beams(log, poses, FRAME, 2.5):
        e = result.static_probability[scan, beam]
        if end is None:
            assert math.isnan(e)
        else:
            m = plain_fixed_point(share_of_hits[end], 0.95, 3000)
            np.testing.assert_allclose(e, plain_static_probability(m, 0.95), atol=1e-3)


def test_closed_form_and_iteration_give_the_same_labels():
    log, poses, _ = random_world(9, n_scans=60)
    closed, iterative = (
        filter_beams(log, poses, FRAME, FilterParams(usable_range_m=2.5, em=em))
        for em in ("closed", "iterative")
    )
    np.testing.assert_array_equal(closed.static_probability < 0.5, iterative.static_probability < 0.5)


def test_someone_who_crosses_the_view_is_found_and_the_wall_stays():
    n_scans, n_beams = 60, 61
    bearings = np.linspace(-0.6, 0.6, n_beams)
    ranges = np.tile(4.0 / np.cos(bearings), (n_scans, 1)).astype(np.float32)
    walker = np.zeros(ranges.shape, dtype=bool)
    for scan in range(n_scans):
        walker[scan, scan : scan + 4] = True
    ranges[walker] = 2.0
    from dynmap_cli.domain.scans import single_laser_log

    log = single_laser_log(np.arange(n_scans) * 10**8, ranges, bearings, np.zeros((n_scans, 3)))
    e = filter_beams(log, np.zeros((n_scans, 3)), FRAME, FilterParams()).static_probability
    assert (e[walker] < 0.5).all()
    assert (e[~walker] > 0.5).all()


def test_sums_over_cells_match_the_plain_sums():
    draw = np.random.default_rng(5)
    cells = draw.integers(-1, 12, size=(30, 20)).astype(np.int32)
    values = draw.random((30, 20)).astype(np.float32)
    sums, plain = np.zeros(12), np.zeros(12)
    add_to_cells(cells, values, sums)
    np.add.at(plain, cells[cells >= 0], values[cells >= 0])
    np.testing.assert_allclose(sums, plain)
