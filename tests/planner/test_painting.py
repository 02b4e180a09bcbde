"""Painting against a plain loop over the cells."""

import numpy as np
import pytest

from dynmap_cli.domain.grid import FREE, OCCUPIED, UNKNOWN, GridFrame
from dynmap_cli.domain.patches import Patch
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.planner.painting import combined, mask_of, painted

FRAME = GridFrame(0.05, -1.0, 2.0, 12, 15)
VALUES = np.array([OCCUPIED, FREE, UNKNOWN], dtype=np.int8)


def submap(number, row, col, rows, cols, owned=None):
    everywhere = np.ones((rows, cols), dtype=bool)
    window = FRAME.window(row, col, rows, cols)
    return SubMap(number, window, row, col, everywhere, everywhere if owned is None else owned, 1.0)


@pytest.mark.parametrize(("first", "second"), [(FREE, OCCUPIED), (OCCUPIED, FREE)])
def test_states_are_combined_cell_by_cell(first, second):
    draw = np.random.default_rng(1)
    states = [draw.choice(VALUES, (5, 7)) for _ in range(3)]
    found = combined(states, first)
    for cell in np.ndindex(5, 7):
        seen = {int(state[cell]) for state in states}
        assert found[cell] == (first if first in seen else second if second in seen else UNKNOWN)


def test_a_state_changes_only_what_it_knows_and_only_in_its_place():
    draw = np.random.default_rng(2)
    cells, state = draw.choice(VALUES, FRAME.shape), draw.choice(VALUES, (4, 6))
    before = cells.copy()
    found, changed = painted(cells, submap(0, 3, 8, 4, 6), state)
    expected = before.copy()
    for row, col in np.ndindex(4, 6):
        if state[row, col] != UNKNOWN:
            expected[3 + row, 8 + col] = state[row, col]
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(cells, before)
    assert changed == (found != before).sum() > 0


def test_the_mask_is_the_cells_that_submaps_own():
    owned = np.ones((3, 3), dtype=bool)
    owned[0, 0] = False
    mask = mask_of(FRAME, [submap(0, 0, 0, 2, 4), submap(1, 9, 12, 3, 3, owned)])
    assert mask.frame == FRAME
    assert set(np.unique(mask.cells)) == {FREE, OCCUPIED}
    assert (mask.cells == OCCUPIED).sum() == 2 * 4 + 8
    assert mask.cells[9, 12] == FREE
    assert (mask_of(FRAME, ()).cells == FREE).all()


def test_a_cell_of_a_state_is_occupied_free_or_neither():
    patch = Patch(0, 1, np.array([[0.0, 0.099, 0.1, 0.199, 0.2, 1.0, np.nan]], dtype=np.float32))
    expected = [FREE, FREE, UNKNOWN, UNKNOWN, OCCUPIED, OCCUPIED, UNKNOWN]
    assert patch.cells.tolist() == [expected]
