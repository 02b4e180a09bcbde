"""Sub-maps corrected by hand: polygons cell by cell, what they take from others, who is meant by a number."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dynmap_cli.domain.corrections import Addition, Drop, Name, Place
from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.submaps import Rectangle
from dynmap_cli.segmentation.corrections import apply_corrections, cells_inside
from dynmap_cli.segmentation.numbering import keep_numbers
from dynmap_cli.segmentation.regions import make_submaps

FRAME = GridFrame(0.1, -1.0, -2.0, 40, 50)


def submap(number, row, col, rows=4, cols=6):
    cells = np.argwhere(np.ones((rows, cols), dtype=bool)) + np.array([row, col])
    return replace(make_submaps([cells], FRAME, 1)[0], submap_id=number)


def place(one, number=None):
    return Place(one.submap_id if number is None else number, one.rectangle)


def square(row, col, size):
    """Polygon around so many cells."""
    x, y = FRAME.origin_x_m + 0.1 * col, FRAME.origin_y_m + 0.1 * row
    return ((x, y), (x + 0.1 * size, y), (x + 0.1 * size, y + 0.1 * size), (x, y + 0.1 * size))


def is_inside(x, y, corners):
    """Even-odd rule, a point at a time."""
    inside = False
    for (x0, y0), (x1, y1) in zip(corners, [*corners[1:], corners[0]], strict=True):
        if (y0 <= y) != (y1 <= y) and x < x0 + (y - y0) * (x1 - x0) / (y1 - y0):
            inside = not inside
    return inside


@given(st.lists(st.tuples(st.floats(-3, 6), st.floats(-4, 4)), min_size=3, max_size=8))
def test_a_polygon_owns_the_cells_whose_centres_lie_inside(corners):
    found = cells_inside(np.array(corners), FRAME)
    cells = np.argwhere(np.ones(FRAME.shape, dtype=bool))
    plain = [is_inside(x, y, corners) for x, y in FRAME.to_points(cells)]
    assert np.array_equal(found.ravel(), plain)


def test_drop_and_name_in_order():
    found = (submap(0, 5, 5), submap(1, 20, 20), submap(2, 30, 30))
    said = (Name(place(found[2]), "dock"), Drop(place(found[1])), Name(place(found[2]), "gate"))
    made, lines = apply_corrections(found, said, FRAME, 1)
    assert [(one.submap_id, one.name) for one in made] == [(0, ""), (2, "gate")]
    assert len(lines) == 3
    assert not any(line.startswith("warning") for line in lines)


def test_a_number_is_found_again_by_its_place():
    one, other = submap(4, 5, 5), submap(0, 20, 20)
    made, _ = apply_corrections((one, other), (Drop(place(other, 7)),), FRAME, 1)
    assert [submap.submap_id for submap in made] == [4]
    # Number 4 was elsewhere when this was said: the one that lies there now is meant.
    made, _ = apply_corrections((one, other), (Drop(place(other, 4)),), FRAME, 1)
    assert [submap.submap_id for submap in made] == [4]


def test_what_is_not_there_any_more_is_said_and_changes_nothing():
    found = (submap(0, 5, 5),)
    made, (line,) = apply_corrections(found, (Drop(Place(3, Rectangle(3.0, 1.0, 3.5, 1.5))),), FRAME, 1)
    assert [one.submap_id for one in made] == [0]
    assert line == "warning: correction 1: sub-map 3 is dropped, but nothing is found there any more"


def test_a_polygon_takes_its_cells_from_others_and_the_place_of_those_that_lie_in_it():
    within, beside = submap(0, 10, 10, 3, 3), submap(1, 10, 17, 4, 8)
    (left, added), _ = apply_corrections((within, beside), (Addition(9, square(8, 8, 12)),), FRAME, 2)
    assert (left.submap_id, added.submap_id) == (1, 9)
    assert added.by_hand
    assert added.owned.sum() == 12 * 12
    assert np.array_equal(added.owned, added.contested)
    assert added.frame.shape == (16, 16)
    total = np.zeros(FRAME.shape, dtype=int)
    for one in (left, added):
        rows, cols = one.frame.shape
        total[one.row : one.row + rows, one.col : one.col + cols] += one.owned
    assert total.max() == 1
    assert left.contested.any()


def test_a_polygon_outside_of_the_map_adds_nothing():
    made, (line,) = apply_corrections((), (Addition(0, ((90, 90), (91, 90), (91, 91))),), FRAME, 2)
    assert made == ()
    assert line.startswith("warning: correction 1: sub-map 0 is added")


def test_numbers_given_by_hand_are_not_given_again():
    found = (submap(0, 5, 5), submap(1, 20, 20))
    assert [one.submap_id for one in keep_numbers(found, (), taken=[1])] == [0, 2]
    assert [one.submap_id for one in keep_numbers(found, found[:1], taken=[1])] == [0, 2]


def test_nested_rectangles_keep_their_numbers():
    """Each overlaps the other wholly; who is alike decides."""
    outer, inner = submap(0, 5, 5, 20, 20), submap(1, 10, 10, 3, 3)
    for found in ((outer, inner), (inner, outer)):
        renumbered = [replace(one, submap_id=k) for k, one in enumerate(found)]
        sizes = {one.submap_id: one.frame.shape for one in keep_numbers(renumbered, (outer, inner))}
        assert sizes == {0: outer.frame.shape, 1: inner.frame.shape}
