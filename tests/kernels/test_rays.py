"""Laws of the plain traversal."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tests.bench.rays import cells_on_ray

inside = st.floats(0.0, 20.0, exclude_max=True)


def walk(x0, y0, x1, y1, rows=20, cols=20):
    cells, lengths = np.empty((64, 2), dtype=np.int64), np.empty(64)
    count = cells_on_ray(x0, y0, x1, y1, rows, cols, cells, lengths)
    return cells[:count], lengths[:count]


@given(inside, inside, inside, inside)
def test_lengths_add_up_to_the_length_of_the_ray(x0, y0, x1, y1):
    _, lengths = walk(x0, y0, x1, y1)
    assert math.isclose(lengths.sum(), math.hypot(x1 - x0, y1 - y0), abs_tol=1e-9)


@given(inside, inside, inside, inside)
def test_it_starts_and_ends_in_the_cells_of_its_ends(x0, y0, x1, y1):
    cells, _ = walk(x0, y0, x1, y1)
    assert tuple(cells[0]) == (int(y0), int(x0))
    assert abs(cells[-1] - [int(y1), int(x1)]).sum() <= 1


@given(inside, inside, inside, inside)
def test_each_length_is_that_of_the_segment_clipped_to_the_cell(x0, y0, x1, y1):
    cells, lengths = walk(x0, y0, x1, y1)
    for (row, col), length in zip(cells, lengths, strict=True):
        enter, leave = 0.0, 1.0
        for start, delta, low in ((x0, x1 - x0, col), (y0, y1 - y0, row)):
            if abs(delta) > 1e-12:
                a, b = sorted(((low - start) / delta, (low + 1 - start) / delta))
                enter, leave = max(enter, a), min(leave, b)
        assert math.isclose(length, max(leave - enter, 0) * math.hypot(x1 - x0, y1 - y0), abs_tol=1e-6)
