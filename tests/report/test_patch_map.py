"""The picture of the patch map: means in their places, groups apart from one another and on the sheet."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynmap_cli.domain.grid import FREE, OCCUPIED, UNKNOWN, GridFrame, OccupancyGrid
from dynmap_cli.domain.patches import Patch, PatchSet, cells_that_vary
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.report.ink import colour_of_submap
from dynmap_cli.report.patch_map import _GAP, _pushed_down, _with_means, draw_patch_map

FRAME = GridFrame(0.05, -1.0, -2.0, 60, 80)
ROWS, COLS = 6, 8


def submap(number, row, col, name=""):
    mask = np.ones((ROWS, COLS), dtype=bool)
    frame = FRAME.window(row, col, ROWS, COLS)
    return SubMap(number, frame, row, col, mask, mask, 0.12, name)


def states(of, n_patches):
    patches = []
    for number in range(n_patches):
        values = np.zeros((ROWS, COLS), dtype=np.float32)
        values[2, number % COLS] = 0.4
        values[0, 0] = np.nan
        patches.append(Patch(number, 1 + number, values))
    return PatchSet(of.submap_id, of.frame, cells_that_vary(patches), tuple(patches), 0.9)


def grid():
    cells = np.full(FRAME.shape, FREE, dtype=np.int8)
    cells[0], cells[-1] = OCCUPIED, UNKNOWN
    return OccupancyGrid(FRAME, cells)


def test_a_sub_map_shows_the_mean_of_all_visits():
    one = submap(0, 10, 20)
    strength = _with_means(grid(), [one], [states(one, 2)])
    window = strength[10 : 10 + ROWS, 20 : 20 + COLS]
    # One visit of three saw 0.4 in the first cell, two of three in the next; 0.5 is drawn black.
    assert window[2, :3].tolist() == pytest.approx([0.4 / 3 / 0.5, 0.8 / 3 / 0.5, 0.0])
    assert window[0, 0] == 0.0
    assert strength[0].tolist() == [1.0] * 80
    assert strength[-1].tolist() == [-1.0] * 80


@pytest.mark.parametrize("n_submaps", [0, 1, 2, 13])
@pytest.mark.parametrize("n_patches", [1, 9])
def test_any_number_of_sub_maps_and_states_is_drawn_the_same_each_time(n_submaps, n_patches):
    submaps = [submap(k, 4 * k, 5 * k, "a long name of a place" * (k == 1)) for k in range(n_submaps)]
    patch_sets = [states(one, n_patches) for one in submaps[1:]]
    picture = draw_patch_map(grid(), submaps, patch_sets)
    assert np.array_equal(picture, draw_patch_map(grid(), submaps[::-1], patch_sets[::-1]))
    colours = {colour for _, colour in picture.getcolors(maxcolors=10**6)}
    assert (colour_of_submap(1) in colours) is (n_submaps > 1)


@given(st.lists(st.tuples(st.integers(-50, 500), st.integers(1, 40)), max_size=8))
def test_groups_stand_apart_and_on_the_sheet(rows):
    wanted, heights = [top for top, _ in rows], [height for _, height in rows]
    tops = _pushed_down(wanted, heights, 500)
    ends = [top + height for top, height in zip(tops, heights, strict=True)]
    assert all(top >= 0 and end <= 500 for top, end in zip(tops, ends, strict=True))
    assert all(end + _GAP <= top for end, top in zip(ends, tops[1:], strict=False))
