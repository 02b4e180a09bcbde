"""Laws of the map transition model."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynmap_cli.localization.beliefs.transitions import (
    change_rate,
    look_back,
    nearest_submaps,
    predict_belief,
    state_priors,
)
from tests.reference.localization import plain_state_prior


def submap(n_states=2, stay=0.8, rectangle=(0.0, 0.0, 1.0, 1.0)):
    drawn = np.full(n_states, 1.0 / n_states)
    return SimpleNamespace(n_states=n_states, stay_probability=stay, rectangle_m=rectangle, drawn=drawn)


def same_probability(area, seconds):
    return float(predict_belief(np.eye(area.n_states)[0], area, seconds)[0])


@given(st.integers(2, 6), st.floats(0.52, 0.999))
def test_after_a_minute_the_state_is_the_same_with_the_stay_probability(n_states, stay):
    assert math.isclose(same_probability(submap(n_states, stay), 60.0), stay, rel_tol=1e-6)


@given(st.integers(2, 5), st.floats(0.0, 1.0), st.floats(0.0, 500.0), st.floats(0.0, 500.0))
def test_two_waits_are_one_long_wait(n_states, stay, first, second):
    area, belief = submap(n_states, stay), np.eye(n_states)[0]
    in_steps = predict_belief(predict_belief(belief, area, first), area, second)
    at_once = predict_belief(belief, area, first + second)
    np.testing.assert_allclose(in_steps, at_once, atol=1e-9)


@given(st.integers(2, 5), st.floats(0.0, 1.0))
def test_in_the_end_nothing_is_known(n_states, stay):
    area = submap(n_states, stay)
    belief = predict_belief(np.eye(n_states)[0], area, 1e7)
    np.testing.assert_allclose(belief, 1 / n_states, atol=1e-6)


def test_a_changed_state_is_one_of_those_drawn_and_looking_back_takes_the_same_way():
    area = SimpleNamespace(n_states=3, stay_probability=0.7, drawn=np.array([0.6, 0.3, 0.1]))
    np.testing.assert_allclose(predict_belief(np.eye(3)[2], area, 1e7), area.drawn, atol=1e-9)
    np.testing.assert_allclose(predict_belief(area.drawn, area, 20.0), area.drawn)
    ratio, chain = np.array([1.0, 2.0, 5.0]), predict_belief(np.eye(3), area, 20.0)
    np.testing.assert_allclose(look_back(ratio, area, 20.0), chain @ ratio)


def test_where_nothing_is_known_states_last_five_minutes():
    for stay in (math.nan, 0.0):
        assert change_rate(stay, 2) == 1 / 300
    assert change_rate(1.0, 2) > 0
    assert same_probability(submap(n_states=1), 1e9) == 1.0


def test_particles_keep_change_and_bring_in_states_as_the_slow_twin_says():
    random, areas = np.random.default_rng(0), (submap(3, 0.7), submap(4, 0.7))
    was_in, now_in = random.integers(-1, 2, (2, 200)).astype(np.int32)
    states = np.where(was_in < 0, -1, random.integers(0, 3, 200)).astype(np.int32)
    beliefs = ([0.5, 0.3, 0.2], [0.1, 0.2, 0.3, 0.4])
    found = state_priors(was_in, states, now_in, areas, 20.0, lambda number: np.array(beliefs[number]))
    np.testing.assert_allclose(found.sum(axis=1), 1.0)
    for k, row in enumerate(found):
        area = areas[now_in[k]]
        same = same_probability(area, 20.0)
        exact = plain_state_prior(was_in[k], states[k], now_in[k], area.n_states, same, beliefs[now_in[k]])
        np.testing.assert_allclose(row[: len(exact)], exact)
        assert not row[len(exact) :].any()


@pytest.mark.parametrize(("x", "expected"), [(0.5, 0), (2.4, 0), (2.7, 1), (9.0, -1)])
def test_a_particle_is_in_the_nearest_submap_within_reach(x, expected):
    areas = (submap(), submap(rectangle=(4.0, 0.0, 5.0, 1.0)))
    assert nearest_submaps(np.array([[x, 0.5]]), areas, 2.0).tolist() == [expected]
    assert nearest_submaps(np.empty((0, 2)), areas, 2.0).size == 0
