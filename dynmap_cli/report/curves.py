"""Curves: what each round of the filter reached, and which state each visit saw."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from dynmap_cli.domain.patches import Visit

_COLOURS = ("#2a6fb5", "#d9822b", "#3a9a5b", "#b03a6b", "#7a5fb0", "#8a6d3b", "#4fb3bf", "#c0b030")
_OPEN = "#c8c8c8"


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


def draw_rounds(rows: Sequence[RoundRow]) -> bytes:
    """Draw log-likelihood (Eq. 1.7) and share of dynamic beams per round (paper, Fig. 1.8); a PNG."""
    figure = Figure(figsize=(8.0, 2.6), dpi=100, layout="constrained")
    left, right = figure.subplots(1, 2)
    numbers = np.arange(1, len(rows) + 1)
    left.plot(numbers, [row.log_likelihood for row in rows], "o-", color=_COLOURS[0])
    left.set_ylabel("log-likelihood")
    right.plot(numbers, [100.0 * row.dynamic_share for row in rows], "o-", color=_COLOURS[1])
    right.set_ylabel("dynamic beams, %")
    right.set_ylim(0.0, max(120.0 * max(row.dynamic_share for row in rows), 0.1))
    for axes in (left, right):
        axes.set_xlabel("round")
        axes.set_xticks(numbers)
        axes.grid(visible=True, color="#e4e4e4")
    return as_png(figure)


def draw_visits(visits: Sequence[Visit]) -> bytes:
    """Draw a row per sub-map and a bar per visit, coloured by the state it saw, grey where it stayed open; a PNG."""
    numbers = sorted({visit.submap_id for visit in visits})
    start_ns = min(visit.start_ns for visit in visits)
    end_s = max((visit.end_ns - start_ns) * 1e-9 for visit in visits)
    figure = Figure(figsize=(8.0, 1.4 + 0.28 * len(numbers)), dpi=100, layout="constrained")
    axes = figure.subplots()
    for row, number in enumerate(numbers):
        own = [visit for visit in visits if visit.submap_id == number]
        spans = [
            ((visit.start_ns - start_ns) * 1e-9, max((visit.end_ns - visit.start_ns) * 1e-9, 0.003 * end_s))
            for visit in own
        ]
        colours = [_OPEN if visit.patch is None else _COLOURS[visit.patch % len(_COLOURS)] for visit in own]
        axes.broken_barh(spans, (row - 0.35, 0.7), facecolors=colours, edgecolor="white", linewidth=0.5)
    axes.set_yticks(range(len(numbers)), [str(number) for number in numbers])
    axes.set_ylim(len(numbers) - 0.4, -0.6)
    axes.set_xlabel("seconds from the first visit")
    axes.set_ylabel("sub-map")
    figure.legend(handles=_legend(visits), loc="outside upper left", ncols=6, frameon=False)
    return as_png(figure)


def _legend(visits: Sequence[Visit]) -> list[Patch]:
    """One entry per colour; from the ninth state on a colour stands for several."""
    states = sorted({visit.patch for visit in visits if visit.patch is not None})
    entries = []
    for number, colour in enumerate(_COLOURS):
        own = [str(state) for state in states if state % len(_COLOURS) == number]
        if own:
            entries.append(Patch(color=colour, label=f"state {', '.join(own)}"))
    if any(visit.patch is None for visit in visits):
        entries.append(Patch(color=_OPEN, label="none recognised"))
    return entries


def as_png(figure: Figure) -> bytes:
    """Render without anything of the machine or the hour in it."""
    stream = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()
