"""Words on a map that hide neither one another nor what is drawn, as far as there is room, and its legend."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw

from dynmap_cli.arrays import F64
from dynmap_cli.report.ink import PAPER, UNSEEN, Colour, font_of, font_pixels

Box = tuple[float, float, float, float]
_GAP, _PADDING, _LEGEND_GAP = 5, 3, 20
_DISTANCES = (0, 20, 45, 80, 125)
"""Pixels by which a label may stand off what it names; a line joins the two from the second on."""
_OVERLAP_COST, _FAR_COST = 20.0, 4.0
"""A pixel on another label or sub-map weighs as so many of what is drawn, a pixel of distance as a few."""


@dataclass(frozen=True, slots=True)
class Label:
    """What is written beside a rectangle.

    Attributes
    ----------
    text : str
    box : tuple of four float
        Left, top, right and bottom of what it names, pixels.
    colour : tuple of int
    """

    text: str
    box: Box
    colour: Colour


def draw_labels(image: Image.Image, labels: Sequence[Label]) -> None:
    """Write labels beside their rectangles, each where it hides least; the first ones choose first.

    Drawn last, a label lies on a ground of its own.
    """
    font = font_of(font_pixels(image.size))
    pen = ImageDraw.Draw(image)
    hidden = _sums(image)
    taken: list[Box] = []
    for label in labels:
        left, top, right, bottom = pen.textbbox((0, 0), label.text, font=font)
        size = (right - left + 2 * _PADDING, bottom - top + 2 * _PADDING)
        others = [*taken, *(other.box for other in labels)]
        _, _, place, away = min(
            (_cost(place, away, others, hidden), number, place, away)
            for number, (place, away) in enumerate(_places(label.box, size, image.size))
        )
        if away:
            pen.line((*_middle(place), *_middle(label.box)), fill=label.colour, width=1)
        pen.rectangle(place, fill=PAPER, outline=label.colour)
        pen.text(
            (place[0] + _PADDING - left, place[1] + _PADDING - top), label.text, fill=label.colour, font=font
        )
        taken.append(place)


def above_legend(image: Image.Image, words: Sequence[tuple[str, Colour]]) -> Image.Image:
    """Put what the colours mean below a picture, in as many lines as its width asks for."""
    font = font_of(font_pixels(image.size))
    width = max(image.width, math.ceil(max(font.getlength(text) for text, _ in words)) + _LEGEND_GAP)
    rows: list[list[tuple[float, str, Colour]]] = [[]]
    x = 0.5 * _LEGEND_GAP
    for text, colour in words:
        length = font.getlength(text)
        if rows[-1] and x + length > width:
            rows.append([])
            x = 0.5 * _LEGEND_GAP
        rows[-1].append((x, text, colour))
        x += length + _LEGEND_GAP
    _, top, _, bottom = font.getbbox("Ay")
    step = math.ceil(1.4 * (bottom - top))
    sheet = Image.new("RGB", (width, image.height + len(rows) * step + _GAP), PAPER)
    sheet.paste(image, (0, 0))
    pen = ImageDraw.Draw(sheet)
    for number, row in enumerate(rows):
        for left, text, colour in row:
            pen.text((left, image.height + (number + 0.5) * step), text, fill=colour, font=font, anchor="lm")
    return sheet


def _places(box: Box, size: tuple[float, float], most: tuple[int, int]) -> Iterator[tuple[Box, int]]:
    """Places around a rectangle, the nearest first, moved into the picture; with the pixels they stand off."""
    left, top, right, bottom = box
    width, height = size
    for away in _DISTANCES:
        gap = _GAP + away
        before_x, before_y, after_x, after_y = (
            left - gap - width,
            top - gap - height,
            right + gap,
            bottom + gap,
        )
        for x, y in (
            (after_x, top), (after_x, bottom - height), (before_x, top), (before_x, bottom - height),
            (left, before_y), (left, after_y), (right - width, before_y), (right - width, after_y),
            (after_x, before_y), (after_x, after_y), (before_x, before_y), (before_x, after_y),
        ):  # fmt: skip
            inside_x, inside_y = (
                float(round(min(max(value, 0), max(limit - 1 - length, 0))))
                for value, limit, length in ((x, most[0], width), (y, most[1], height))
            )
            yield (inside_x, inside_y, inside_x + width, inside_y + height), away


def _cost(place: Box, away: int, others: Sequence[Box], hidden: F64) -> float:
    """What a label hides there, in pixels."""
    left, top, right, bottom = (math.ceil(value) for value in place)
    rows, cols = hidden.shape
    top, bottom, left, right = (
        min(top, rows - 1),
        min(bottom, rows - 1),
        min(left, cols - 1),
        min(right, cols - 1),
    )
    drawn = hidden[bottom, right] - hidden[top, right] - hidden[bottom, left] + hidden[top, left]
    common = sum(
        max(min(place[2], other[2]) - max(place[0], other[0]), 0.0)
        * max(min(place[3], other[3]) - max(place[1], other[1]), 0.0)
        for other in others
    )
    return float(drawn) + _OVERLAP_COST * common + _FAR_COST * away


def _sums(image: Image.Image) -> F64:
    """(rows + 1, cols + 1) how many pixels above and left of a corner are drawn on."""
    pixels = np.asarray(image)
    is_drawn = ~((pixels == np.array(PAPER)).all(axis=2) | (pixels == np.array(UNSEEN)).all(axis=2))
    sums = np.zeros((pixels.shape[0] + 1, pixels.shape[1] + 1))
    sums[1:, 1:] = is_drawn.cumsum(axis=0).cumsum(axis=1)
    return sums


def _middle(box: Box) -> tuple[float, float]:
    """Centre of a rectangle."""
    return 0.5 * (box[0] + box[2]), 0.5 * (box[1] + box[3])
