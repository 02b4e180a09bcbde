"""Numbers of patches: kept where they show the same, on rectangles that moved by whole cells."""

from dataclasses import replace

import numpy as np
import pytest

from dynmap_cli.clustering.numbering import keep_numbers
from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.patches import ChangingObject, Patch, PatchSet, Visit, cells_that_vary

FRAME = GridFrame(0.05, 1.0, 2.0, 12, 16)


def patch(number, first_col, support=3):
    """A box of six columns on free ground."""
    reflectance = np.zeros(FRAME.shape, dtype=np.float32)
    reflectance[3:9, first_col : first_col + 3] = 1.0
    return Patch(number, support, reflectance)


def patch_set(*patches):
    return PatchSet(5, FRAME, cells_that_vary(patches), tuple(patches), 0.9)


def visit(sequence, number):
    return Visit(5, sequence, "log", 0, 1, number, 1.0 if number is not None else float("nan"))


def test_states_keep_their_numbers_whatever_their_order():
    known = patch_set(patch(0, 2), patch(1, 7), patch(3, 12))
    found = patch_set(patch(0, 12), patch(1, 2), patch(2, 7))
    visits = [visit(0, 0), visit(1, 1), visit(2, 2), visit(3, None)]
    (kept,), seen = keep_numbers([found], visits, [known])
    assert [one.patch_id for one in kept.patches] == [0, 1, 3]
    assert [int(np.argmax(one.reflectance[5])) for one in kept.patches] == [2, 7, 12]
    assert [one.patch for one in seen] == [3, 0, 1, None]


def test_a_new_state_gets_a_new_number():
    known = patch_set(patch(0, 2), patch(1, 7))
    (kept,), seen = keep_numbers([patch_set(patch(0, 12), patch(1, 7), patch(2, 2))], [visit(0, 0)], [known])
    assert [one.patch_id for one in kept.patches] == [0, 1, 2]
    assert seen[0].patch == 2


@pytest.mark.parametrize(("rows", "cols"), [(2, 3), (-2, 1), (0, -3)])
def test_a_rectangle_that_grew_or_moved_is_compared_cell_by_cell(rows, cols):
    known = patch_set(patch(0, 5), patch(1, 9))
    moved = GridFrame(0.05, 1.0 + 0.05 * cols, 2.0 + 0.05 * rows, 12, 16)
    shown = [
        replace(one, reflectance=np.roll(one.reflectance, (-rows, -cols), (0, 1))) for one in known.patches
    ]
    found = PatchSet(5, moved, cells_that_vary(shown), tuple(reversed(shown)), 0.9)
    found = replace(found, patches=(replace(shown[1], patch_id=0), replace(shown[0], patch_id=1)))
    (kept,), _ = keep_numbers([found], [], [known])
    assert [int(np.argmax(one.reflectance[5 - rows])) for one in kept.patches] == [5 - cols, 9 - cols]


def test_sub_maps_that_were_not_known_are_left_as_they_are():
    found = patch_set(patch(0, 12), patch(1, 7))
    assert keep_numbers([found], [visit(0, 1)], [])[0] == (found,)


def test_a_state_that_knows_little_keeps_its_number():
    """It agrees with another one as well as with itself."""
    whole, other = patch(0, 2), patch(1, 9)
    values = np.full(FRAME.shape, np.nan, dtype=np.float32)
    values[3:9, 2] = 1.0
    part = Patch(2, 1, values)
    known = patch_set(whole, other, part)
    for order in ((0, 1, 2), (2, 0, 1), (1, 2, 0)):
        shown = [known.patches[number] for number in order]
        found = patch_set(*(replace(one, patch_id=k) for k, one in enumerate(shown)))
        (kept,), _ = keep_numbers([found], [], [known])
        assert [int(np.isnan(one.reflectance).any()) for one in kept.patches] == [0, 0, 1]
        assert [int(np.nanargmax(one.reflectance[5])) for one in kept.patches] == [2, 9, 2]


def thing(number, first_col):
    cells = np.zeros(FRAME.shape, dtype=bool)
    cells[3:9, first_col : first_col + 3] = True
    return ChangingObject(number, cells, {0: "on"})


def test_objects_keep_their_numbers_where_they_share_most_cells():
    known = replace(patch_set(patch(0, 2)), objects=(thing(0, 2), thing(2, 7)))
    found = replace(patch_set(patch(0, 2)), objects=(thing(0, 7), thing(1, 12), thing(2, 2)))
    (kept,), _ = keep_numbers([found], [], [known])
    assert [one.object_id for one in kept.objects] == [0, 2, 3]
    assert [int(one.cells.any(axis=0).argmax()) for one in kept.objects] == [2, 7, 12]
    (alone,), _ = keep_numbers([found], [], [patch_set(patch(0, 2))])
    assert alone.objects == found.objects
