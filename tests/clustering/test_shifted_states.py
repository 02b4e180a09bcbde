"""States that are one, seen from poses that are off."""

import numpy as np
import pytest

from dynmap_cli.clustering.local_maps import LocalMaps, shifted
from dynmap_cli.clustering.shifted_states import lay_over_same_state
from dynmap_cli.domain.grid import FREE, OCCUPIED, UNKNOWN

SHAPE = (30, 40)
STATE_OF = np.array([0, 0, 0, 1])


def with_box(row, col, *, wall=()):
    """Free space with the outline of a box of 8 x 8 cells; beside what is occupied nothing is known."""
    states = np.full(SHAPE, FREE, dtype=np.int8)
    occupied = np.zeros(SHAPE, dtype=bool)
    occupied[row : row + 8, col : col + 8] = True
    occupied[row + 1 : row + 7, col + 1 : col + 7] = False
    occupied[:, list(wall)] = True
    beside = np.zeros(SHAPE, dtype=bool)
    for shift in [(r, c) for r in (-1, 0, 1) for c in (-1, 0, 1)]:
        beside |= shifted(occupied, shift, False)
    states[beside] = UNKNOWN
    states[occupied] = OCCUPIED
    return states


def maps_of(frequent, rare):
    states = np.stack([frequent, frequent, frequent, rare])
    return LocalMaps(states, states.astype(np.float32), np.zeros(4, dtype=bool))


@pytest.mark.parametrize("shift", [(0, 2), (-2, 0), (2, -2)])
def test_a_state_that_lies_two_cells_off_is_laid_over_the_other(shift):
    box = with_box(10, 15)
    moved = lay_over_same_state(maps_of(box, shifted(box, shift, UNKNOWN)), STATE_OF, 6)
    inside = (slice(4, 26), slice(4, 36))
    np.testing.assert_array_equal(moved.states[3][inside], box[inside])
    np.testing.assert_array_equal(moved.reflectance[3][inside], box[inside])
    np.testing.assert_array_equal(moved.states[:3], [box] * 3)


@pytest.mark.parametrize(
    "other",
    [
        with_box(10, 20),
        np.full(SHAPE, FREE, dtype=np.int8),
        np.full(SHAPE, UNKNOWN, dtype=np.int8),
        with_box(10, 15),
        with_box(10, 17, wall=[5]),
    ],
    ids=["elsewhere", "no box", "nothing known", "the same", "the wall did not move"],
)
def test_other_states_stay(other):
    wall = [5] if (other[:, 5] == OCCUPIED).all() else []
    assert lay_over_same_state(maps_of(with_box(10, 15, wall=wall), other), STATE_OF, 6) is None


def test_maps_without_a_state_stay():
    box = with_box(10, 15)
    maps = maps_of(box, shifted(box, (0, 2), UNKNOWN))
    assert lay_over_same_state(maps, np.array([0, 0, 0, -1]), 6) is None
    assert lay_over_same_state(maps, np.full(4, -1), 6) is None
