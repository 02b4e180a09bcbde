"""Scales and the drawing of data between them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from dynmap_cli.report.axes import Panel, Scale, ruled, scale_over
from dynmap_cli.report.curves import RoundRow, draw_rounds


@given(st.floats(-1e7, 1e7), st.floats(1e-3, 1e7))
def test_a_scale_marks_round_numbers_between_its_ends(first, length):
    scale = ruled("x", first, first + length)
    values = np.array([value for value, _ in scale.ticks])
    assert 2 <= values.size <= 7
    assert (values >= first - 1e-6 * length).all()
    assert (values <= first + length * (1 + 1e-6)).all()
    steps = np.diff(values)
    mantissa = steps[0] / 10.0 ** np.floor(np.log10(steps[0]) + 1e-6)
    assert np.abs(mantissa - np.array([1.0, 2.0, 5.0])).min() < 1e-3
    assert len({text for _, text in scale.ticks}) == values.size


def test_what_is_written_beside_a_tick_has_the_decimals_it_needs():
    assert [text for _, text in ruled("x", -2_327_000.0, -2_321_000.0, 4).ticks] == [
        "-2,326,000",
        "-2,324,000",
        "-2,322,000",
    ]
    assert [text for _, text in ruled("x", 0.0, 0.25).ticks] == [
        "0.00",
        "0.05",
        "0.10",
        "0.15",
        "0.20",
        "0.25",
    ]


@pytest.mark.parametrize("values", [[0.0], [5.0, 5.0], [-3.0, -2.0]])
def test_a_scale_holds_its_values(values):
    scale = scale_over("x", values)
    assert scale.first < min(values) <= max(values) < scale.last


def test_data_lie_between_the_ends_of_both_scales():
    sheet = Image.new("RGB", (400, 300), (255, 255, 255))
    across, up = Scale("x", 0.0, 2.0, ()), Scale("y", 10.0, 0.0, ())
    panel = Panel(sheet, (0, 0, 400, 300), across, up, has_grid=False)
    left, bottom = panel.to_pixels(0.0, 10.0)
    right, top = panel.to_pixels(2.0, 0.0)
    assert 0 < left < right < 400
    assert 0 < top < bottom < 300
    assert panel.to_pixels(1.0, 5.0) == pytest.approx(((left + right) / 2, (top + bottom) / 2))


def test_one_round_is_a_dot_and_likelihoods_that_stay_are_drawn():
    for rows in ([RoundRow(-12.5, 0.0)], [RoundRow(0.0, 0.1)] * 3):
        pixels = np.asarray(draw_rounds(rows))
        assert (pixels == (42, 111, 181)).all(axis=2).any()
        assert (pixels == (217, 130, 43)).all(axis=2).any()
