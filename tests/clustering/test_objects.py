"""Objects: which cells switch together, and what each visit knows of them."""

import numpy as np
import pytest

from dynmap_cli.clustering.local_maps import Vectors
from dynmap_cli.clustering.objects import find_objects, group_cells, states_of
from dynmap_cli.domain.patches import OFF, ON, UNKNOWN_STATE

NONE_MIXED = np.zeros(12, dtype=bool)
LEAF = np.array([1, 1, 0, 1, 0, 0, 1, 0, 1, 0, 1, 1])
BOX = np.array([0, 1, 1, 0, 0, 1, 0, 0, 1, 1, 0, 1])


def vectors(*columns, component=None):
    """A row of cells with 12 visits each; NaN = unknown."""
    values = np.column_stack(columns).astype(float)
    count = values.shape[1]
    group = np.zeros(count, dtype=np.int64) if component is None else np.asarray(component)
    return Vectors(values, group, int(group.max()) + 1, np.ones((1, count), dtype=bool))


def noisy(pattern, count, draw):
    """Cells that follow a pattern, of which one in twenty does not in a visit, and a fifth is not known."""
    values = np.repeat(np.asarray(pattern, dtype=float)[:, None], count, axis=1)
    wrong = draw.random(values.shape) < 0.05
    values[wrong] = 1.0 - values[wrong]
    values[draw.random(values.shape) < 0.2] = np.nan
    return values


def test_two_things_that_touch_are_two_objects():
    draw = np.random.default_rng(4)
    found = find_objects(vectors(noisy(LEAF, 20, draw), noisy(BOX, 15, draw)), NONE_MIXED, 6)
    assert len(found) == 2
    for thing, first, last, pattern in zip(found, (0, 20), (20, 35), (LEAF, BOX), strict=True):
        assert thing.cells[0, first:last].mean() > 0.8
        assert thing.cells.sum() == thing.cells[0, first:last].sum()
        assert [thing.states[visit] for visit in range(12)] == [ON if on else OFF for on in pattern]
        assert thing.count(ON) == pattern.sum()


def test_a_thing_at_either_of_two_places_is_two_objects_and_so_are_groups_that_do_not_touch():
    here, away = np.repeat(LEAF[:, None], 8, axis=1), np.repeat(1 - LEAF[:, None], 8, axis=1)
    np.testing.assert_array_equal(group_cells(vectors(here, away), NONE_MIXED, 6), [0] * 8 + [1] * 8)
    apart = vectors(here, here, component=[0] * 8 + [1] * 8)
    np.testing.assert_array_equal(group_cells(apart, NONE_MIXED, 6), [0] * 8 + [1] * 8)


def test_things_that_were_there_once_each_are_not_the_same():
    first, second = np.zeros(12), np.zeros(12)
    first[3], second[7] = 1, 1
    both = vectors(np.repeat(first[:, None], 7, axis=1), np.repeat(second[:, None], 7, axis=1))
    np.testing.assert_array_equal(group_cells(both, NONE_MIXED, 6), [0] * 7 + [1] * 7)


def test_few_cells_are_no_object_and_mixed_visits_know_nothing():
    few = vectors(np.repeat(LEAF[:, None], 5, axis=1))
    assert find_objects(few, NONE_MIXED, 6) == ()
    mixed = NONE_MIXED.copy()
    mixed[2] = True
    (thing,) = find_objects(vectors(np.repeat(LEAF[:, None], 6, axis=1)), mixed, 6)
    assert thing.states[2] == UNKNOWN_STATE
    assert thing.states[0] == ON


@pytest.mark.parametrize(
    ("on", "off", "cells", "state"),
    [
        (6, 4, 10, ON),
        (4, 6, 10, OFF),
        (5, 5, 10, UNKNOWN_STATE),
        (3, 0, 12, ON),
        (2, 0, 12, UNKNOWN_STATE),
        (0, 6, 100, OFF),
        (0, 5, 100, UNKNOWN_STATE),
        (0, 0, 10, UNKNOWN_STATE),
    ],
)
def test_a_state_needs_a_majority_of_enough_cells(on, off, cells, state):
    values = np.array([[1.0] * on + [0.0] * off + [np.nan] * (cells - on - off)])
    assert states_of(values, 6).tolist() == [state]
