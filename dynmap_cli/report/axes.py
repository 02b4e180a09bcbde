"""Axes of a chart, drawn with Pillow: a frame with scales on two sides, and data to pixels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from PIL import Image, ImageDraw

from dynmap_cli.report.pictures import INK, font_of

SMOOTH = 2
"""Charts are drawn this many times too large and reduced, which smooths slanted lines."""
_TICK_PIXELS, _GAP_PIXELS, _TEXT_PIXELS = 4 * SMOOTH, 4 * SMOOTH, 13 * SMOOTH
_GRID = (228, 228, 228)
_STEPS = (1.0, 2.0, 5.0)


@dataclass(frozen=True, slots=True)
class Scale:
    """One side of a chart.

    Attributes
    ----------
    label : str
    first, last : float
        Values at the left or lower end, and at the other one.
    ticks : tuple of (float, str)
        Values that are marked, with what is written beside them.
    """

    label: str
    first: float
    last: float
    ticks: tuple[tuple[float, str], ...]


def scale_over(label: str, values: Sequence[float], most_ticks: int = 6) -> Scale:
    """Scale that holds some values with a margin of a twentieth, and marks multiples of 1, 2, 5, 10, ..."""
    low, high = min(values), max(values)
    margin = 0.05 * (high - low) or 0.5 * max(abs(high), 1.0) * 1e-3
    return ruled(label, low - margin, high + margin, most_ticks)


def ruled(label: str, first: float, last: float, most_ticks: int = 6) -> Scale:
    """Scale from one value to a larger one that marks multiples of 1, 2, 5, 10, ..."""
    decade = 10.0 ** math.floor(math.log10((last - first) / most_ticks))
    step = next(
        size * decade for size in (*_STEPS, 10.0) if math.floor((last - first) / (size * decade)) < most_ticks
    )
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    numbers = range(math.ceil(first / step - 1e-9), math.floor(last / step + 1e-9) + 1)
    return Scale(
        label, first, last, tuple((number * step, f"{number * step:,.{decimals}f}") for number in numbers)
    )


class Panel:
    """A rectangle of a drawing in which data are drawn between two scales.

    Parameters
    ----------
    sheet : Image
        Drawn `SMOOTH` times too large.
    outer : (4,) int
        Left, top, right, bottom of the rectangle with its scales.
    x, y : Scale
    has_grid : bool
        Whether lines cross the rectangle at the ticks.
    """

    def __init__(
        self, sheet: Image.Image, outer: tuple[int, int, int, int], x: Scale, y: Scale, *, has_grid: bool
    ) -> None:
        self._sheet, self.pen, self._font = sheet, ImageDraw.Draw(sheet), font_of(_TEXT_PIXELS)
        self._x, self._y = x, y
        beside = max((math.ceil(self._font.getlength(text)) for _, text in y.ticks), default=0)
        line = _TEXT_PIXELS + _GAP_PIXELS
        self._left = outer[0] + line + beside + _GAP_PIXELS + _TICK_PIXELS
        self._top, self._right = outer[1] + _GAP_PIXELS, outer[2] - 2 * _GAP_PIXELS
        self._bottom = outer[3] - 2 * line - _TICK_PIXELS
        self._draw_scales(outer, has_grid=has_grid)

    def to_pixels(self, x: float, y: float) -> tuple[float, float]:
        """Where a point lies in the drawing."""
        right = (x - self._x.first) / (self._x.last - self._x.first)
        up = (y - self._y.first) / (self._y.last - self._y.first)
        return (
            self._left + right * (self._right - self._left),
            self._bottom - up * (self._bottom - self._top),
        )

    def _draw_scales(self, outer: tuple[int, int, int, int], *, has_grid: bool) -> None:
        """Draw frame, ticks and labels."""
        left, top, right, bottom = self._left, self._top, self._right, self._bottom
        for value, text in self._x.ticks:
            x, _ = self.to_pixels(value, self._y.first)
            if has_grid:
                self.pen.line((x, top, x, bottom), fill=_GRID, width=SMOOTH)
            self.pen.line((x, bottom, x, bottom + _TICK_PIXELS), fill=INK, width=SMOOTH)
            below = (x, bottom + _TICK_PIXELS + _GAP_PIXELS)
            self.pen.text(below, text, fill=INK, font=self._font, anchor="mt")
        for value, text in self._y.ticks:
            _, y = self.to_pixels(self._x.first, value)
            if has_grid:
                self.pen.line((left, y, right, y), fill=_GRID, width=SMOOTH)
            self.pen.line((left - _TICK_PIXELS, y, left, y), fill=INK, width=SMOOTH)
            beside = (left - _TICK_PIXELS - _GAP_PIXELS, y)
            self.pen.text(beside, text, fill=INK, font=self._font, anchor="rm")
        self.pen.rectangle((left, top, right, bottom), outline=INK, width=SMOOTH)
        middle = (left + right) / 2
        self.pen.text((middle, outer[3]), self._x.label, fill=INK, font=self._font, anchor="md")
        length = math.ceil(self._font.getlength(self._y.label))
        upright = Image.new("RGB", (length, _TEXT_PIXELS + _GAP_PIXELS), (255, 255, 255))
        ImageDraw.Draw(upright).text((0, 0), self._y.label, fill=INK, font=self._font)
        self._sheet.paste(upright.rotate(90, expand=True), (outer[0], (top + bottom - length) // 2))
