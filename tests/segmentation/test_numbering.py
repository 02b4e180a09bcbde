"""Numbers of sub-maps: kept where they overlap, never given twice."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.segmentation.numbering import keep_numbers


def submap(number, x, y, cols=20, rows=10):
    mask = np.ones((rows, cols), dtype=bool)
    return SubMap(number, GridFrame(0.05, x, y, rows, cols), 0, 0, mask, mask, rows * cols * 0.0025)


def test_nothing_known_changes_nothing():
    found = (submap(0, 0.0, 0.0), submap(1, 5.0, 0.0))
    assert keep_numbers(found, ()) == found


def test_those_that_overlap_keep_their_numbers_and_others_get_new_ones():
    known = (submap(4, 5.0, 0.0), submap(2, 0.0, 0.0), submap(7, 50.0, 0.0))
    found = (submap(0, 0.1, 0.0), submap(1, 20.0, 0.0), submap(2, 5.0, 0.1))
    kept = keep_numbers(found, known)
    assert [(one.submap_id, one.frame.origin_x_m) for one in kept] == [(2, 0.1), (4, 5.0), (8, 20.0)]


def test_a_corner_in_common_is_not_enough():
    (kept,) = keep_numbers((submap(0, 0.9, 0.4),), (submap(3, 0.0, 0.0),))
    assert kept.submap_id == 4


@settings(deadline=None, max_examples=50)
@given(st.lists(st.tuples(st.floats(0, 5), st.floats(0, 5)), max_size=6), st.integers(0, 5))
def test_numbers_are_given_once(places, n_known):
    submaps = [submap(number, *place) for number, place in enumerate(places)]
    kept = keep_numbers(submaps, submaps[:n_known])
    numbers = [one.submap_id for one in kept]
    assert len(set(numbers)) == len(submaps)
    assert numbers == sorted(numbers)
