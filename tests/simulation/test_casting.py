"""The casting kernel against its slow twin: every beam against every primitive alone."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dynmap_cli.kernels.simulation import cast_scans
from tests.reference.simulation import plain_cast

NO_GATES = np.empty((0, 2), dtype=np.int32)


def always(count):
    return np.tile(np.array([[-1, 0]], dtype=np.int32), (count, 1))


def cast(
    start,
    end,
    first,
    increment,
    n_beams,
    max_range,
    *,
    segments=(),
    circles=(),
    moving=(),
    discs=(),
    **kwargs,
):
    segments = np.array(segments, dtype=np.float64).reshape(-1, 4)
    circles = np.array(circles, dtype=np.float64).reshape(-1, 3)
    ranges, hits, cosines = np.empty((1, n_beams)), np.empty((1, n_beams), np.int32), np.empty((1, n_beams))
    cast_scans(
        np.array([start], dtype=np.float64),
        np.array([end], dtype=np.float64),
        float(first),
        float(increment),
        float(max_range),
        segments,
        kwargs.get("gates", always(len(segments))),
        np.array(kwargs.get("returns", np.ones(len(segments))), dtype=np.float64),
        circles,
        always(len(circles)),
        np.array([kwargs.get("states", [])], dtype=np.int32).reshape(1, -1),
        np.array(moving, dtype=np.float64).reshape(1, -1, 8),
        np.array(discs, dtype=np.float64).reshape(1, -1, 5),
        np.array(kwargs.get("draws", np.zeros((1, n_beams))), dtype=np.float64),
        ranges,
        hits,
        cosines,
    )
    return ranges[0], hits[0], cosines[0]


def check_against_twin(seed, *, sweep, increment, full_circle):
    draw = np.random.default_rng(seed)
    n_beams = 48
    start = np.array([*draw.uniform(-1, 1, 2), draw.uniform(-7, 7)])
    end = start + sweep * np.array([*draw.uniform(-0.3, 0.3, 2), draw.uniform(-0.6, 0.6)])
    first = -math.pi if full_circle else -1.8
    step = increment * (2 * math.pi / n_beams if full_circle else 3.6 / (n_beams - 1))
    segments = draw.uniform(-6, 6, (5, 4))
    circles = np.column_stack([draw.uniform(-5, 5, (4, 2)), draw.uniform(0.02, 0.8, 4)])
    moving = np.repeat(draw.uniform(-5, 5, (2, 4)), 2, axis=0).reshape(2, 8) + sweep * draw.uniform(
        -0.2, 0.2, (2, 8)
    )
    moving = moving[:, [0, 1, 2, 3, 0, 1, 2, 3]] + sweep * draw.uniform(-0.2, 0.2, (2, 8))
    discs = np.column_stack([draw.uniform(-4, 4, (3, 2)), np.zeros((3, 2)), np.full(3, 0.1)])
    discs[:, 2:4] = discs[:, :2] + sweep * draw.uniform(-0.3, 0.3, (3, 2))
    ranges, hits, _ = cast(
        start,
        end,
        first * increment,
        step,
        n_beams,
        5.0,
        segments=segments,
        circles=circles,
        moving=moving,
        discs=discs,
    )
    all_segments = np.vstack([np.hstack([segments, segments]), moving])
    all_circles = np.vstack([np.column_stack([circles[:, :2], circles[:, :2], circles[:, 2]]), discs])
    alone = plain_cast(start, end, first * increment, step, n_beams, 5.0, all_segments, all_circles)
    order = [0, 1, 2, 3, 4, 7, 8, 9, 10, 5, 6, 11, 12, 13]
    alone = alone[:, order]
    np.testing.assert_allclose(ranges, alone.min(axis=1), atol=1e-7)
    found = np.flatnonzero(np.isfinite(ranges))
    np.testing.assert_allclose(alone[found, hits[found]], ranges[found], atol=1e-7)
    assert (hits[~np.isfinite(ranges)] == -1).all()


@given(seed=st.integers(0, 10**6))
@settings(max_examples=8)
def test_a_still_scan_meets_what_is_nearest_of_all_primitives_alone(seed):
    check_against_twin(seed, sweep=0.0, increment=1.0, full_circle=False)


@given(seed=st.integers(0, 10**6))
@settings(max_examples=8)
def test_a_swept_scan_meets_what_is_nearest_of_all_primitives_alone(seed):
    check_against_twin(seed, sweep=1.0, increment=1.0, full_circle=False)


@given(seed=st.integers(0, 10**6))
@settings(max_examples=8)
def test_a_full_circle_the_other_way_round_meets_the_same(seed):
    check_against_twin(seed, sweep=1.0, increment=-1.0, full_circle=True)


def test_the_cosine_is_that_of_the_angle_to_the_normal():
    _, _, cosines = cast((0, 0, 0), (0, 0, 0), 0.0, math.radians(30), 3, 10.0, segments=[(1, -9, 1, 9)])
    np.testing.assert_allclose(cosines, [1.0, math.cos(math.radians(30)), 0.5], atol=1e-12)
    _, _, cosines = cast((0, 0, 0), (0, 0, 0), 0.0, 0.1, 2, 10.0, circles=[(2.0, 0.0, 0.5)])
    across = 2.0 * math.sin(0.1)
    np.testing.assert_allclose(cosines, [1.0, math.sqrt(1 - (across / 0.5) ** 2)], atol=1e-12)


def test_an_object_is_seen_only_in_its_state():
    gates = np.array([[0, 1]], dtype=np.int32)
    kwargs = {"segments": [(1, -1, 1, 1)], "gates": gates}
    assert cast((0, 0, 0), (0, 0, 0), 0.0, 0.1, 2, 9.0, states=[1], **kwargs)[0][0] == 1.0
    assert cast((0, 0, 0), (0, 0, 0), 0.0, 0.1, 2, 9.0, states=[0], **kwargs)[0][0] == math.inf


def test_glass_lets_its_share_of_the_beams_through():
    n_beams = 4000
    draws = np.random.default_rng(1).random((1, n_beams))
    walls = {"segments": [(1, -5, 1, 5), (2, -5, 2, 5)], "returns": [0.3, 1.0], "draws": draws}
    _, hits, _ = cast((0, 0, 0), (0, 0, 0), -0.2, 1e-4, n_beams, 9.0, **walls)
    assert set(hits.tolist()) == {0, 1}
    assert abs((hits == 0).mean() - 0.3) < 0.03


def test_who_is_absent_is_not_seen():
    ranges, _, _ = cast(
        (0, 0, 0), (0, 0, 0), -0.1, 0.1, 3, 9.0, moving=[np.full(8, np.nan)], discs=[[np.nan] * 4 + [0.1]]
    )
    assert np.isinf(ranges).all()
