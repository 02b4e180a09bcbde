"""How much one scan counts."""

import numpy as np
import pytest

from dynmap_cli.localization.sensing.weighing import LEAST_EFFECTIVE, Weighing
from dynmap_cli.localization.settings import LocalizationSettings


def weighing(sensor):
    return Weighing(None, LocalizationSettings(sensor=sensor), None, np.zeros((60, 2)), 0.25)


def effective(weights):
    return np.square(weights.sum()) / np.square(weights).sum()


@pytest.mark.parametrize("n_states", [None, 3])
def test_after_the_beam_model_enough_particles_count(n_states):
    random = np.random.default_rng(0)
    sharp = random.normal(scale=200.0, size=500 if n_states is None else (500, n_states))
    weights = random.random(500)
    found = weighing("beam").tempered(sharp, weights)
    best = found if n_states is None else found.max(axis=1)
    assert effective(weights * np.exp(best - best.max())) >= LEAST_EFFECTIVE
    shares = found / sharp
    np.testing.assert_allclose(shares, shares.ravel()[0])


def test_what_leaves_enough_counts_in_full():
    mild = np.random.default_rng(1).normal(scale=0.5, size=500)
    for sensor in ("beam", "likelihood_field"):
        np.testing.assert_array_equal(weighing(sensor).tempered(mild, np.ones(500)), 0.25 * mild)


def test_states_that_are_none_say_nothing():
    sharp = np.random.default_rng(2).normal(scale=200.0, size=(500, 2))
    padded = np.column_stack([sharp, np.full(500, -np.inf)])
    found = weighing("beam").tempered(padded, np.ones(500))
    np.testing.assert_array_equal(found[:, :2], weighing("beam").tempered(sharp, np.ones(500)))
