"""Coordinates beside the map."""

import numpy as np
import pytest
from PIL import Image

from dynmap_cli.report.axes import _round_step, _ticks, _words, in_axes


@pytest.mark.parametrize(
    ("least", "step"), [(0.9, 1.0), (1.0, 1.0), (1.2, 2.0), (3.0, 5.0), (7.0, 10.0), (0.03, 0.05)]
)
def test_steps_are_round(least, step):
    assert np.isclose(_round_step(least), step)


def test_ticks_are_multiples_of_the_step_within_the_map():
    assert _ticks(-1.3, 5.0, 1.0) == [-1.0, 0.0, 1.0, 2.0, 3.0]
    assert _ticks(0.2, 0.5, 1.0) == []
    assert _words("x", [(-2.0, 0.0), (0.0, 9.0)]) == ["-2", "x 0 m"]
    assert _words("x", []) == []


@pytest.mark.parametrize("size", [(400, 300), (3, 900), (1, 1), (2300, 20)])
def test_the_map_stays_where_it_is(size):
    image = Image.new("RGB", size, (200, 10, 10))
    drawn = np.asarray(in_axes(image, (-3.0, 2.0), 20.0))
    assert (drawn[: size[1], : size[0]] == (200, 10, 10)).all()
    assert (drawn[size[1] :] != (200, 10, 10)).any()


def test_a_tick_stands_at_its_coordinate():
    """x = 5 m lies 8 m right of the left edge, y = 5 m lies 3 m above the lower one; 20 pixels are a metre."""
    drawn = np.asarray(in_axes(Image.new("RGB", (400, 300)), (-3.0, 2.0), 20.0))
    assert drawn[302, 160].max() < 100
    assert drawn[302, 140].min() > 200
    assert drawn[240, 403].max() < 100
    assert drawn[220, 403].min() > 200
