"""Coordinates beside a picture of the map, so that a place on it can be named in metres."""

from __future__ import annotations

import math
from collections.abc import Sequence

from PIL import Image, ImageDraw

from dynmap_cli.report.ink import INK, PAPER, font_of, font_pixels

_TICK_PIXELS, _GAP_PIXELS = 6, 4
_APART = 6
"""Ticks are at least so many heights of a letter apart."""


def in_axes(image: Image.Image, origin_m: tuple[float, float], pixels_per_m: float) -> Image.Image:
    """Put x below and y to the right of a map, whose place in the picture stays the same.

    Parameters
    ----------
    image : Image
    origin_m : tuple of two float
        x and y of its lower left corner in the map frame.
    pixels_per_m : float
    """
    width, height = image.size
    letter = font_pixels(image.size)
    font = font_of(letter)
    step_m = _round_step(_APART * letter / pixels_per_m)
    columns = [
        (x, (x - origin_m[0]) * pixels_per_m) for x in _ticks(origin_m[0], width / pixels_per_m, step_m)
    ]
    rows = [
        (y, height - (y - origin_m[1]) * pixels_per_m)
        for y in _ticks(origin_m[1], height / pixels_per_m, step_m)
    ]
    x_words, y_words = _words("x", columns), _words("y", rows)
    edge = _TICK_PIXELS + _GAP_PIXELS
    right = edge + math.ceil(max((font.getlength(word) for word in y_words), default=0.0)) + _GAP_PIXELS
    sheet = Image.new("RGB", (width + right, height + edge + math.ceil(1.4 * letter)), PAPER)
    sheet.paste(image, (0, 0))
    pen = ImageDraw.Draw(sheet)
    for (_, at), word in zip(columns, x_words, strict=True):
        pen.line((at, height, at, height + _TICK_PIXELS), fill=INK, width=2)
        half = 0.5 * font.getlength(word)
        middle = min(max(at, half + _GAP_PIXELS), max(width + right - half, half))
        pen.text((middle, height + edge), word, fill=INK, font=font, anchor="mt")
    for (_, at), word in zip(rows, y_words, strict=True):
        pen.line((width, at, width + _TICK_PIXELS, at), fill=INK, width=2)
        middle = min(max(at, 0.5 * letter), height - 0.5 * letter)
        pen.text((width + edge, middle), word, fill=INK, font=font, anchor="lm")
    return sheet


def _round_step(least: float) -> float:
    """The smallest of 1, 2, 5, 10, ... (times a power of ten) that is no less."""
    decade = 10.0 ** math.floor(math.log10(least))
    return next(step * decade for step in (1.0, 2.0, 5.0, 10.0) if step * decade >= least * (1.0 - 1e-9))


def _ticks(first: float, length: float, step: float) -> list[float]:
    """Multiples of a step along an edge."""
    return [
        round(k * step, 9) for k in range(math.ceil(first / step), math.floor((first + length) / step) + 1)
    ]


def _words(axis: str, ticks: Sequence[tuple[float, float]]) -> list[str]:
    """What stands at the ticks; the last one says which axis it is."""
    words = [f"{value:g}" for value, _ in ticks]
    if words:
        words[-1] = f"{axis} {words[-1]} m"
    return words
