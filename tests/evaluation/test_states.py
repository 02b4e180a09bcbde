"""Laws of the measures of states."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.patches import Visit
from dynmap_cli.domain.poses import Trajectory, inverse, transform_points
from dynmap_cli.domain.scans import single_laser_log
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.evaluation.states import (
    LearnedStates,
    adjusted_rand_index,
    patch_meanings,
    reach_of_objects,
    score_states,
    true_configuration,
)
from dynmap_cli.evaluation.truth import Run, TrueObject, Truth

LABELS = st.lists(st.integers(0, 3), min_size=2, max_size=12)


@given(LABELS, st.permutations(range(4)))
def test_names_of_groups_do_not_matter(labels, names):
    assert adjusted_rand_index(labels, [names[label] for label in labels]) == pytest.approx(1.0)


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 2)), min_size=2, max_size=10))
def test_rand_index_matches_a_plain_count_of_pairs(pairs):
    first, second = zip(*pairs, strict=True)
    n, both, a, b = len(pairs), 0, 0, 0
    for i in range(n):
        for j in range(i):
            same_a, same_b = first[i] == first[j], second[i] == second[j]
            both, a, b = both + (same_a and same_b), a + same_a, b + same_b
    expected, most = a * b / (n * (n - 1) / 2), (a + b) / 2
    plain = 1.0 if most == expected else (both - expected) / (most - expected)
    assert adjusted_rand_index(first, second) == pytest.approx(plain)


def test_one_group_says_nothing_about_two():
    assert adjusted_rand_index([0] * 6, [0, 1, 0, 1, 0, 1]) == pytest.approx(0.0)
    assert np.isnan(adjusted_rand_index([], []))


def door(frame_turn=(0.0, 0.0, 0.0)):
    """A door that is open for ten scans, closed for ten, and so on; the sub-map lies in a turned frame."""
    stamps = np.arange(80, dtype=np.int64) * 10**9
    states = (np.arange(80) // 10 % 2).astype(np.int32)[:, None]
    thing = TrueObject("door", 10, ("open", "closed"))
    poses = np.column_stack([np.linspace(0, 3, 80), np.sin(np.arange(80)), np.zeros(80)])
    empty = np.zeros((80, 1), dtype=np.int32)
    truth = Truth(Trajectory(stamps, poses), empty, states, (thing,), 0, 1, 2, 3, 10)
    turn = np.array(frame_turn)
    corner = transform_points(inverse(turn), np.array([1.5, 1.5])) - 0.25
    frame = GridFrame(0.05, corner[0], corner[1], 10, 10)
    submap = SubMap(0, frame, 0, 0, np.ones((10, 10), bool), np.ones((10, 10), bool), 0.25)
    visits = tuple(
        Visit(0, k, "log", (10 * k + 1) * 10**9, (10 * k + 8) * 10**9, k % 2, 1.0) for k in range(8)
    )
    return LearnedStates((submap,), visits, turn, {0: {"door": frozenset({"open", "closed"})}}), truth


def test_right_states_are_perfect():
    score = score_states("door", *door())
    assert score.values["adjusted_rand_index"] == 1.0
    assert score.values["objects_found_share"] == 1.0
    assert score.values["right_number_of_states_share"] == 1.0
    assert score.values["submaps_without_object"] == 0.0
    assert score.is_complete


def test_shuffled_states_are_not():
    learned, truth = door()
    visits = tuple(replace(visit, patch=visit.sequence // 4) for visit in learned.visits)
    assert (
        score_states("shuffled", replace(learned, visits=visits), truth).values["adjusted_rand_index"] < 0.1
    )


def test_open_visits_are_counted_and_no_answer_is_not_good():
    learned, truth = door()
    visits = tuple(replace(visit, patch=None) for visit in learned.visits)
    score = score_states("open", replace(learned, visits=visits), truth)
    assert np.isnan(score.values["adjusted_rand_index"])
    assert score.values["visits_assigned_share"] == 0.0


def test_a_change_during_a_visit_keeps_it_out_of_the_index():
    learned, truth = door()
    mixed = replace(learned.visits[0], end_ns=12 * 10**9, patch=1)
    score = score_states("mixed", replace(learned, visits=(mixed, *learned.visits[1:])), truth)
    assert score.values["adjusted_rand_index"] == 1.0
    assert score.details["sub-maps"][0]["changed_meanwhile"] == 1


def test_a_submap_elsewhere_is_false_and_the_door_is_missed():
    learned, truth = door()
    score = score_states("away", replace(learned, reach={0: {}}), truth)
    assert score.values["submaps_without_object"] == 1.0
    assert score.values["objects_found_share"] == 0.0
    assert np.isnan(score.values["adjusted_rand_index"])


def test_a_patch_means_what_was_there_most_often():
    learned, truth = door()
    assert patch_meanings(0, learned.reach[0], learned.visits, truth) == {
        0: (("door", "open"),),
        1: (("door", "closed"),),
    }


def test_an_object_reaches_where_its_beams_end_whatever_the_frame_of_the_map():
    """A box that stands at one of three places, two of which lie in the sub-map."""
    count, stamps = 60, np.arange(60, dtype=np.int64) * 10**9
    bearings = np.linspace(-0.2, 0.2, 21)
    ranges = np.repeat([1.0, 1.5, 4.0], 20)[:, None] / np.cos(bearings)
    classes = np.full((count, 21), 10, dtype=np.int32)
    states = np.repeat(np.arange(3, dtype=np.int32), 20)[:, None]
    thing = TrueObject("box", 10, ("near", "middle", "far"))
    turned = np.tile([3.0, -2.0, 0.0], (count, 1))
    log = single_laser_log(stamps, ranges.astype(np.float32), bearings, np.zeros((count, 3)))
    truth = Truth(Trajectory(stamps, np.zeros((count, 3))), classes, states, (thing,), 0, 1, 2, 3, 10)
    run = Run(Path("run"), log, turned, np.ones((count, 21), np.float32), np.zeros((count, 21), bool), {})
    everywhere = np.ones((20, 20), dtype=bool)
    submap = SubMap(7, GridFrame(0.05, 3.8, -2.5, 20, 20), 0, 0, everywhere, everywhere, 1.0)
    assert reach_of_objects(run, truth, (submap,)) == {7: {"box": {"near", "middle"}}}
    last = Visit(7, 0, "log", 50 * 10**9, 55 * 10**9, 0, 1.0)
    assert true_configuration(last, {"box": frozenset({"near", "middle"})}, truth) == (("box", "elsewhere"),)
