"""Laws and twins of the fuzzy k-means with unknown cells."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from dynmap_cli.clustering.fuzzy_kmeans import (
    EPSILON,
    centers_of,
    fuzzy_kmeans,
    memberships_of,
    squared_distances,
)
from tests.reference.clustering import plain_distance, plain_fuzzy_kmeans

cell = st.one_of(st.just(np.nan), st.floats(0.0, 1.0))
vectors = hnp.arrays(np.float64, (5, 7), elements=cell)


@given(vectors, vectors)
def test_distances_are_those_of_the_printed_equation(a, b):
    expected = [[plain_distance(x, y, EPSILON) for y in b] for x in a]
    np.testing.assert_allclose(squared_distances(a, b), expected, atol=1e-9)


@given(vectors)
def test_a_vector_is_at_no_distance_from_itself(a):
    np.testing.assert_allclose(np.diag(squared_distances(a, a)), 0.0, atol=1e-9)
    np.testing.assert_allclose(squared_distances(a, a), squared_distances(a, a).T, atol=1e-9)


@given(vectors, st.integers(1, 4))
def test_memberships_add_up_to_one_and_the_nearest_has_most(a, k):
    distances = squared_distances(a, a[:k])
    memberships = memberships_of(distances)
    np.testing.assert_allclose(memberships.sum(axis=1), 1.0)
    at_best = np.take_along_axis(distances, memberships.argmax(axis=1)[:, None], axis=1)[:, 0]
    np.testing.assert_allclose(at_best, distances.min(axis=1), atol=1e-9)


@given(vectors)
def test_means_stay_between_the_values_and_unknown_where_no_member_knows(a):
    memberships = np.eye(2)[[0, 0, 1, 1, 1]]
    centers = centers_of(a, memberships)
    for k, members in enumerate((a[:2], a[2:])):
        unknown = np.isnan(members).all(axis=0)
        np.testing.assert_array_equal(np.isnan(centers[k]), unknown)
        expected = [col[~np.isnan(col)].mean() for col in members.T[~unknown]]
        np.testing.assert_allclose(centers[k][~unknown], expected, atol=1e-9)


def test_known_vectors_cluster_as_the_textbook_says():
    draw = np.random.default_rng(5)
    states = (draw.random((3, 12)) < 0.5).astype(float)
    table = np.clip(np.repeat(states, [5, 4, 3], axis=0) + 0.15 * draw.standard_normal((12, 12)), 0.0, 1.0)
    clusters = fuzzy_kmeans(table, table[[0, 5, 9]])
    centers, memberships = plain_fuzzy_kmeans(table.tolist(), table[[0, 5, 9]].tolist())
    np.testing.assert_allclose(clusters.memberships, memberships, atol=1e-4)
    np.testing.assert_allclose(clusters.centers, centers, atol=1e-4)


def test_a_cluster_without_members_is_left_out():
    table = np.array([[0.0, 0.0], [0.0, 0.1], [1.0, 1.0]])
    clusters = fuzzy_kmeans(table, np.array([[0.0, 0.0], [1.0, 1.0], [50.0, 50.0]]))
    assert clusters.count == 2
