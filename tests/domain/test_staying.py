"""How long a state lasts."""

import math

import pytest

from dynmap_cli.domain.patches import Visit
from dynmap_cli.domain.staying import stay_probability


def visits(patches, every_s=60.0):
    return [
        Visit(0, k, "log", round(k * every_s * 1e9), round((k * every_s + 10) * 1e9), patch, 1.0)
        for k, patch in enumerate(patches)
    ]


def test_one_state_stays():
    assert stay_probability(visits([0, 0]), 1) == 1.0


def test_without_visits_it_is_that_of_one_change_in_five_minutes():
    nothing = stay_probability([], 2)
    assert nothing == pytest.approx(0.5 + 0.5 * math.exp(-60 / 300), abs=0.06)


def test_the_more_often_the_state_was_the_same_the_longer_it_stays():
    steady = [stay_probability(visits([0] * n), 2) for n in (1, 3, 10, 40)]
    assert steady == sorted(steady)
    assert steady[-1] > 0.97


def test_a_state_that_changes_each_minute_is_a_toss_up():
    assert stay_probability(visits([0, 1] * 20), 2) < 0.6
    assert stay_probability(visits([0, 1] * 20), 2) < stay_probability(visits([0, 0, 1, 1] * 10), 2)


def test_changes_over_days_say_little_of_a_minute():
    daily = stay_probability(visits([0, 1, 0, 1], every_s=86_400.0), 2)
    assert daily > stay_probability(visits([0, 1, 0, 1]), 2) + 0.1


def test_visits_without_a_state_are_passed_over():
    assert stay_probability(visits([0, None, 0]), 2) == stay_probability(
        [visits([0, 0, 0])[k] for k in (0, 2)], 2
    )
