"""How many states: right numbers on synthetic tables, whatever the order."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynmap_cli.clustering.fuzzy_kmeans import fuzzy_kmeans
from dynmap_cli.clustering.local_maps import Vectors
from dynmap_cli.clustering.model_selection import (
    assign,
    choose_clusters,
    fitting_states,
    largest_contradiction,
    merge_equal,
)
from tests.reference.clustering import plain_rand_index

CELLS = 20


def table(seed, states, counts, noise=0.05, unknown=0.2):
    """Visits of objects: a state is a tuple of on/off per object, each object has CELLS cells."""
    draw = np.random.default_rng(seed)
    truth = np.repeat(np.arange(len(states)), counts)
    values = np.repeat(np.array(states, dtype=float)[truth], CELLS, axis=1)
    flipped = draw.random(values.shape) < noise
    values = np.where(flipped, 1.0 - values, values)
    values[draw.random(values.shape) < unknown] = np.nan
    order = draw.permutation(truth.size)
    component = np.repeat(np.arange(len(states[0])), CELLS)
    cells = np.ones((1, component.size), dtype=bool)
    return Vectors(values[order], component, len(states[0]), cells), truth[order]


@settings(max_examples=10)
@given(st.integers(0, 10_000))
def test_seventeen_maps_with_four_states(seed):
    vectors, truth = table(seed, [(0, 0), (0, 1), (1, 0), (1, 1)], [6, 5, 4, 2])
    clusters = choose_clusters(vectors, 12, 6).clusters
    assert clusters.count == 4
    assert plain_rand_index(truth, clusters.memberships.argmax(axis=1)) == 1.0


@pytest.mark.parametrize("counts", [[3, 3], [1, 9], [30, 10]])
def test_a_door_has_two_states(counts):
    vectors, _ = table(1, [(0,), (1,)], counts)
    assert choose_clusters(vectors, 12, 6).clusters.count == 2


@settings(max_examples=20)
@given(st.integers(0, 10_000), st.integers(1, 30))
def test_one_state_stays_one(seed, count):
    vectors, _ = table(seed, [(0, 1, 0)], [count], noise=0.1, unknown=0.4)
    assert choose_clusters(vectors, 12, 6).clusters.count == 1


def test_the_order_of_the_visits_does_not_matter():
    vectors, _ = table(3, [(0, 0, 1), (0, 1, 0), (1, 0, 0)], [5, 4, 3])
    order = np.random.default_rng(0).permutation(12)
    one = choose_clusters(vectors, 12, 6).clusters.memberships.argmax(axis=1)
    turned = replace(vectors, values=vectors.values[order])
    other = choose_clusters(turned, 12, 6).clusters.memberships.argmax(axis=1)
    assert plain_rand_index(one[order], other) == 1.0


def test_states_are_never_more_than_allowed():
    vectors, _ = table(4, [(0, 0, 1), (0, 1, 0), (1, 0, 0), (1, 1, 1)], [3, 3, 3, 3])
    assert choose_clusters(vectors, 2, 6).clusters.count <= 2


def test_clusters_that_differ_in_few_cells_of_every_object_are_one():
    vectors, truth = table(5, [(0, 0), (0, 1)], [4, 4], noise=0.0, unknown=0.0)
    clusters = fuzzy_kmeans(vectors.values, vectors.values[[truth.argmin(), truth.argmax()]])
    assert largest_contradiction(*clusters.centers, vectors) == CELLS
    assert merge_equal(vectors, clusters, CELLS).count == 2
    assert merge_equal(vectors, clusters, CELLS + 1).count == 1


@pytest.mark.parametrize(("apart", "count"), [(1, 2), (4, 1)])
def test_cells_that_contradict_far_from_one_another_are_noise(apart, count):
    """Eight cells of a long wall of which one state shows the opposite."""
    values = np.zeros((2, 40))
    values[1, : 8 * apart : apart] = 1.0
    vectors = Vectors(values, np.zeros(40, dtype=np.int64), 1, np.ones((1, 40), dtype=bool))
    assert merge_equal(vectors, fuzzy_kmeans(values, values), 6).count == count


def test_a_visit_that_saw_little_is_assigned_only_where_it_leaves_no_doubt():
    vectors, _ = table(6, [(0, 0), (0, 1)], [4, 4], noise=0.0, unknown=0.0)
    clusters = choose_clusters(vectors, 12, 6).clusters
    late = np.full((3, 2 * CELLS), np.nan)
    late[0, :CELLS] = 0.0
    late[1, CELLS : CELLS + 8] = 1.0
    late[2, CELLS : CELLS + 3] = 1.0
    found, share = assign(replace(vectors, values=late), clusters, 6)
    expected = int(clusters.centers[:, -1].argmax())
    assert found.tolist() == [-1, expected, -1]
    assert share[1] > 0.9


def test_a_visit_that_did_not_see_where_states_differ_fits_both():
    vectors, _ = table(6, [(0, 0), (0, 1)], [4, 4], noise=0.0, unknown=0.0)
    clusters = choose_clusters(vectors, 12, 6).clusters
    blind = np.concatenate([np.zeros(CELLS), np.full(CELLS, np.nan)])
    other = np.concatenate([np.ones(CELLS), np.zeros(CELLS)])
    assert fitting_states(blind, vectors, clusters, 6).tolist() == [0, 1]
    assert fitting_states(vectors.values[0], vectors, clusters, 6).size == 1
    assert fitting_states(other, vectors, clusters, 6).size == 0
