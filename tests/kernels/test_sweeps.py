"""Twins of the kernels that read a placed scan."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dynmap_cli.domain.poses import transform_points
from dynmap_cli.kernels.crossings import first_crossing, passing_share
from dynmap_cli.kernels.novelties import clip_edges, see_places
from dynmap_cli.kernels.sweeps import (
    are_marked,
    explain_by_states,
    place_beams,
    sort_beams,
    walls_crossed,
    weigh_states,
)
from tests.reference.localization import (
    plain_clips,
    plain_first_crossing,
    plain_passing_share,
    plain_state_evidence,
    plain_staying,
)

CELL = np.array([1.0, -2.0, 0.05])


@given(st.integers(0, 10_000))
def test_explained_ends_are_their_plain_twin(seed):
    random = np.random.default_rng(seed)
    shape, cell = (7, 9), np.array([1.0, -2.0, 0.05])
    static, owned = random.random((2, *shape)) < 0.5
    states, state = random.random((3, *shape)) < 0.3, int(random.integers(3))
    ends = random.uniform((0.8, -2.2), (1.8, -1.4), (40, 2))
    now, other = np.empty(40, bool), np.zeros(40, bool)
    are_marked(ends, cell, static, now)
    explain_by_states(ends, cell, owned, states, state, now, other)
    for k, (x, y) in enumerate(ends):
        row, col = math.floor((y + 2.0) / 0.05), math.floor((x - 1.0) / 0.05)
        if 0 <= row < 7 and 0 <= col < 9 and owned[row, col]:
            assert now[k] == states[state, row, col]
            assert other[k] == (any(states[:, row, col]) and not states[state, row, col])
        else:
            assert now[k] == static[min(max(row, 0), 6), min(max(col, 0), 8)]
            assert not other[k]


def surfaces_of(random, shape):
    codes = random.choice([1, 46, 91, 136, 255], shape)
    return np.where(random.random(shape) < 0.15, codes, 0).astype(np.uint8)


def passes_of(random, surfaces):
    shares = random.random(surfaces.shape)
    return np.where((random.random(surfaces.shape) < 0.1) & (surfaces == 0), np.nan, shares).astype(
        np.float32
    )


@given(st.integers(0, 10_000))
@settings(max_examples=30)
def test_first_crossing_is_its_plain_twin(seed):
    random = np.random.default_rng(seed)
    surfaces = surfaces_of(random, (9, 11))
    x, y = random.uniform(-4, 15), random.uniform(-4, 13)
    direction = random.uniform(-np.pi, np.pi)
    found = first_crossing(surfaces, x, y, math.cos(direction), math.sin(direction), 12.0, 0.34)
    twins = plain_first_crossing(surfaces, x, y, direction, 12.0, 0.34, 2e-3)
    for mine, twin in zip(found, twins, strict=True):
        if math.isfinite(mine) and math.isfinite(twin):
            assert abs(mine - twin) < 5e-3 or _grazes_a_corner(x, y, direction, min(mine, twin))
        elif math.isfinite(mine) != math.isfinite(twin):
            assert _grazes_a_corner(x, y, direction, min(mine, twin))


def _grazes_a_corner(x, y, direction, at):
    """Whether the twin may have stepped over a cell that the ray only touches."""
    px, py = x + at * math.cos(direction), y + at * math.sin(direction)
    return (abs(px - round(px)) < 0.02 and abs(py - round(py)) < 0.02) or at > 11.99


@given(st.integers(0, 10_000))
@settings(max_examples=30)
def test_the_share_of_beams_that_pass_is_its_plain_twin(seed):
    random = np.random.default_rng(seed)
    surfaces = surfaces_of(random, (9, 11))
    passes = passes_of(random, surfaces)
    x, y = random.uniform(-4, 15), random.uniform(-4, 13)
    direction, beyond = random.uniform(-np.pi, np.pi), random.uniform(0.0, 6.0)
    ahead = math.cos(direction), math.sin(direction)
    enter, share = passing_share(surfaces, passes, x, y, *ahead, 12.0, beyond, 0.34)
    entered, twin = plain_passing_share(surfaces, passes, x, y, direction, 12.0, beyond, 0.34, 2e-3)
    corners = np.argwhere(np.ones((10, 12)))[:, ::-1] - (x, y)
    if np.abs(corners @ (-ahead[1], ahead[0])).min() > 0.02:  # else the twin may step over a cell
        assert math.isinf(entered) if enter > 11.99 else abs(enter - entered) < 5e-3
        assert math.isclose(share, twin, rel_tol=1e-6) or _ends_at_a_border(x, y, ahead, 12.0 - beyond)


def _ends_at_a_border(x, y, ahead, at):
    """Whether it is a matter of one step of the twin which cells are crossed."""
    point = x + at * ahead[0], y + at * ahead[1]
    return min(abs(value - round(value)) for value in point) < 0.01


def test_a_beam_that_slides_along_a_wall_crosses_nothing():
    surfaces = np.zeros((20, 20), dtype=np.uint8)
    surfaces[10, :] = 1  # a wall along x
    assert math.isinf(first_crossing(surfaces, 2.0, 9.0, math.cos(0.1), math.sin(0.1), 17.0, 0.34)[1])
    assert math.isclose(first_crossing(surfaces, 2.0, 9.0, 0.0, 1.0, 17.0, 0.34)[1], 1.0)


@given(st.integers(0, 10_000))
def test_beams_go_through_the_surfaces_that_they_cross_before_they_end(seed):
    random = np.random.default_rng(seed)
    surfaces, sensor = surfaces_of(random, (9, 11)), random.uniform((0.9, -2.1), (1.6, -1.5))
    directions, lengths = random.uniform(-np.pi, np.pi, 6), random.uniform(0.0, 1.0, 6)
    crossings, behind = np.empty((6, 2)), np.empty(6)
    walls_crossed(surfaces, CELL, sensor, directions, lengths, 0.34, crossings, behind)
    x, y = (sensor - CELL[:2]) / 0.05
    for k in range(6):
        ahead = np.array([math.cos(directions[k]), math.sin(directions[k])])
        crossed = 0.05 * first_crossing(surfaces, x, y, ahead[0], ahead[1], lengths[k] / 0.05, 0.34)[1]
        np.testing.assert_allclose(behind[k], lengths[k] - crossed)
        np.testing.assert_allclose(
            crossings[k], sensor + (crossed if math.isfinite(crossed) else 0.0) * ahead
        )


@given(st.integers(0, 10_000))
def test_what_a_scan_says_of_states_is_its_plain_twin(seed):
    random = np.random.default_rng(seed)
    shape, n_states, n = (9, 11), int(random.integers(1, 4)), 12
    surfaces, owned = surfaces_of(random, (n_states, *shape)), random.random(shape) < 0.6
    passes = passes_of(random, surfaces)
    fields = random.normal(-2.0, 1.0, (n_states, *shape)).astype(np.float32)
    pool = np.concatenate([np.zeros(50, np.float32), fields.ravel()])
    start = 50 + 99 * np.arange(n_states)
    sensor, directions = random.uniform((0.9, -2.1), (1.6, -1.5)), random.uniform(-np.pi, np.pi, n)
    lengths, hits = random.uniform(0.0, 1.0, n), random.random(n) < 0.8
    ends = sensor + lengths[:, None] * np.column_stack([np.cos(directions), np.sin(directions)])
    limits, values = np.array([0.34, 0.1, 0.3, math.log(2.0)]), np.array([-0.1, -5.0])
    beams = (sensor, directions, lengths, ends, hits)
    at_ends, through, told = np.empty(n_states), np.empty(n_states), np.empty(2, np.int64)
    switches = np.array([[thing, *random.integers(n_states, size=2)] for thing in (0, 0, 1)], dtype=np.int64)
    out = at_ends, through, told
    count = weigh_states(surfaces, passes, owned, pool, start, CELL, *beams, values, limits, switches, *out)
    expected = plain_state_evidence(
        surfaces, passes, owned, fields, CELL, beams, values, limits, switches, passing_share
    )
    np.testing.assert_allclose(at_ends, expected[0], atol=1e-9)
    np.testing.assert_allclose(through, expected[1], atol=1e-9)
    assert count == expected[2]
    assert told.tolist() == expected[3]


@given(st.integers(0, 10_000), st.integers(0, 30))
def test_every_beam_is_sorted_once(seed, n):
    random = np.random.default_rng(seed)
    hits, now, other, in_free, on_map, clips = random.random((6, n)) < 0.5
    other &= ~now
    behind = np.where(random.random(n) < 0.3, -np.inf, random.uniform(-1.0, 2.0, n))
    through = behind > 0.5
    counts, things, openings = np.empty(7, np.int64), np.empty(n, bool), np.empty(n, bool)
    out = counts, things, openings
    sort_beams(hits, now, other, behind, in_free, on_map, clips, np.array([0.5, 0.3]), *out)
    new = hits & ~(now | other)
    masks = (hits, hits & now, hits & other, new, new & through & in_free, new & through & ~in_free)
    expected = [int(mask.sum()) for mask in masks]
    assert counts.tolist() == [*expected, int((new & ~through & ~in_free).sum())]
    assert things.tolist() == ((new & clips) | (hits & ~on_map & ~through)).tolist()
    assert openings.tolist() == (hits & (behind > 0.3)).tolist()


@given(st.integers(0, 10_000), st.integers(0, 30))
def test_beams_that_clip_edges_are_their_plain_twin(seed, n):
    random = np.random.default_rng(seed)
    behind = np.where(random.random(n) < 0.3, -np.inf, random.uniform(-1.0, 2.0, n))
    crossings = np.cumsum(random.exponential(0.15, (n, 2)) * (random.random((n, 1)) < 0.7), axis=0)
    out = np.empty(n, bool)
    clip_edges(behind, crossings, np.array([0.5, 0.6, 0.2]), out)
    assert out.tolist() == plain_clips(behind, crossings, 0.5, 0.6, 0.2)


@given(st.integers(0, 10_000), st.integers(1, 3), st.integers(1, 3), st.booleans())
def test_what_stays_is_its_plain_twin(seed, least_beams, least_cells, is_fixed):
    random = np.random.default_rng(seed)
    first = np.full((8, 9), -np.inf)
    last, plain_first, plain_last = first.copy(), first.copy(), first.copy()
    limits = np.array([2.5, 1.0, least_beams, least_cells])
    for step in range(8):
        points = random.uniform((0.9, -2.1), (2.0, -1.1), (int(random.integers(1, 12)), 2))
        out = np.empty(len(points), bool)
        see_places(points, CELL, 2, 0.5 * step, limits, is_fixed, first, last, out)
        notes = plain_first, plain_last
        assert out.tolist() == plain_staying(points, CELL, 2, 0.5 * step, limits, is_fixed, *notes)
        assert (first == plain_first).all()
        assert (last == plain_last).all()


@given(st.floats(-10, 10), st.floats(-10, 10), st.floats(-4, 4), st.floats(-4, 4), st.floats(0, 30))
def test_a_placed_beam_ends_where_its_pose_sees_it(x, y, yaw, direction, length):
    directions, ends = np.empty(1), np.empty((1, 2))
    place_beams(np.array([direction]), np.array([length]), np.array([x, y, yaw]), directions, ends)
    seen = np.array([length * math.cos(direction), length * math.sin(direction)])
    np.testing.assert_allclose(ends[0], transform_points(np.array([x, y, yaw]), seen), atol=1e-9)
    assert directions[0] == direction + yaw
