"""Curves: what each round of the filter reached, and which state each visit saw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from PIL import Image, ImageDraw

from dynmap_cli.domain.patches import Visit
from dynmap_cli.report.axes import SMOOTH, Panel, Scale, ruled, scale_over
from dynmap_cli.report.pictures import INK, font_of

_COLOURS = ("#2a6fb5", "#d9822b", "#3a9a5b", "#b03a6b", "#7a5fb0", "#8a6d3b", "#4fb3bf", "#c0b030")
_OPEN = "#c8c8c8"
_WIDTH, _HEIGHT = 800 * SMOOTH, 260 * SMOOTH
_ROW, _LEGEND, _BELOW = 28 * SMOOTH, 24 * SMOOTH, 60 * SMOOTH
_PER_LEGEND_ROW = 5
_BOX, _GAP, _TEXT = 28 * SMOOTH, 8 * SMOOTH, 13 * SMOOTH


@dataclass(frozen=True, slots=True)
class RoundRow:
    """One line of map/em.csv.

    Attributes
    ----------
    log_likelihood : float
    dynamic_share : float
    """

    log_likelihood: float
    dynamic_share: float


def draw_rounds(rows: Sequence[RoundRow]) -> Image.Image:
    """Draw log-likelihood (Eq. 1.7) and share of dynamic beams per round (paper, Fig. 1.8)."""
    sheet = Image.new("RGB", (_WIDTH, _HEIGHT), (255, 255, 255))
    rounds = Scale("round", 0.9, len(rows) + 0.1, tuple((k + 1.0, str(k + 1)) for k in range(len(rows))))
    likelihoods = [row.log_likelihood for row in rows]
    percent = [100.0 * row.dynamic_share for row in rows]
    middle = _WIDTH // 2
    left = Panel(
        sheet, (0, 0, middle, _HEIGHT), rounds, scale_over("log-likelihood", likelihoods), has_grid=True
    )
    shares = ruled("dynamic beams, %", 0.0, max(1.2 * max(percent), 0.1))
    right = Panel(sheet, (middle, 0, _WIDTH, _HEIGHT), rounds, shares, has_grid=True)
    for panel, values, colour in ((left, likelihoods, _COLOURS[0]), (right, percent, _COLOURS[1])):
        points = [panel.to_pixels(number, value) for number, value in enumerate(values, start=1)]
        panel.pen.line(points, fill=colour, width=2 * SMOOTH, joint="curve")
        for point in points:
            panel.pen.circle(point, 3.5 * SMOOTH, fill=colour)
    return sheet.reduce(SMOOTH)


def draw_visits(visits: Sequence[Visit]) -> Image.Image:
    """Draw a row per sub-map and a bar per visit, coloured by the state it saw, grey where it stayed open."""
    numbers = sorted({visit.submap_id for visit in visits})
    start_ns = min(visit.start_ns for visit in visits)
    latest_ns = max(visit.end_ns for visit in visits)
    end_s = max((latest_ns - start_ns) * 1e-9, 1.0)
    legend = _legend(visits)
    above = _LEGEND * -(-len(legend) // _PER_LEGEND_ROW)
    height = above + _ROW * len(numbers) + _BELOW
    sheet = Image.new("RGB", (_WIDTH, height), (255, 255, 255))
    _draw_legend(ImageDraw.Draw(sheet), legend)
    submaps = tuple((float(row), str(number)) for row, number in enumerate(numbers))
    seconds = ruled("seconds from the first visit", -0.03 * end_s, 1.03 * end_s)
    rows = Scale("sub-map", len(numbers) - 0.4, -0.6, submaps)
    panel = Panel(sheet, (0, above, _WIDTH, height), seconds, rows, has_grid=False)
    for visit in visits:
        row, first_s = numbers.index(visit.submap_id), (visit.start_ns - start_ns) * 1e-9
        last_s = first_s + max((visit.end_ns - visit.start_ns) * 1e-9, 0.003 * end_s)
        corners = (*panel.to_pixels(first_s, row - 0.35), *panel.to_pixels(last_s, row + 0.35))
        panel.pen.rectangle(corners, fill=_colour(visit), outline="white")
    return sheet.reduce(SMOOTH)


def _colour(visit: Visit) -> str:
    return _OPEN if visit.patch is None else _COLOURS[visit.patch % len(_COLOURS)]


def _legend(visits: Sequence[Visit]) -> list[tuple[str, str]]:
    """Colour and text of each entry; from the ninth state on a colour stands for several."""
    states = sorted({visit.patch for visit in visits if visit.patch is not None})
    entries = []
    for number, colour in enumerate(_COLOURS):
        own = [str(state) for state in states if state % len(_COLOURS) == number]
        if own:
            entries.append((colour, f"state {', '.join(own)}"))
    if any(visit.patch is None for visit in visits):
        entries.append((_OPEN, "none recognised"))
    return entries


def _draw_legend(pen: ImageDraw.ImageDraw, entries: Sequence[tuple[str, str]]) -> None:
    """Put the entries above the chart, some to a row."""
    step, font = _WIDTH // _PER_LEGEND_ROW, font_of(_TEXT)
    for number, (colour, text) in enumerate(entries):
        left, top = number % _PER_LEGEND_ROW * step + _GAP, number // _PER_LEGEND_ROW * _LEGEND + _GAP
        middle = top + (_LEGEND - _GAP) // 2
        pen.rectangle((left, middle - 5 * SMOOTH, left + _BOX, middle + 5 * SMOOTH), fill=colour)
        pen.text((left + _BOX + _GAP, middle), text, fill=INK, font=font, anchor="lm")
