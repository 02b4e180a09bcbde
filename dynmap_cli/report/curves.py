"""Curves: what each round of the filter reached, and which state each visit saw."""

from __future__ import annotations

import io
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from dynmap_cli.domain.patches import Visit
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.domain.times import readable_time

COLOURS = ("#2a6fb5", "#d9822b", "#3a9a5b", "#b03a6b", "#7a5fb0", "#8a6d3b", "#4fb3bf", "#c0b030")
_OPEN = "#c8c8c8"
_PAUSE_NS, _MOST_TICKS, _LEAST_WIDTH = 300 * 10**9, 12, 0.004


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
    left.plot(numbers, [row.log_likelihood for row in rows], "o-", color=COLOURS[0])
    left.set_ylabel("log-likelihood")
    right.plot(numbers, [100.0 * row.dynamic_share for row in rows], "o-", color=COLOURS[1])
    right.set_ylabel("dynamic beams, %")
    right.set_ylim(0.0, max(120.0 * max(row.dynamic_share for row in rows), 0.1))
    for axes in (left, right):
        axes.set_xlabel("round")
        axes.set_xticks(numbers)
        axes.grid(visible=True, color="#e4e4e4")
    return as_png(figure)


def draw_visits(visits: Sequence[Visit], submaps: Sequence[SubMap], first_ns: int) -> bytes:
    """Draw a row per sub-map and a bar per visit, coloured by the state it saw, grey where it stayed open; a PNG.

    A thin line joins visits that saw the same state, with no other between them. Pauses in which no sub-map was
    visited are cut out.

    Parameters
    ----------
    visits : sequence of Visit
    submaps : sequence of SubMap
    first_ns : int
        Stamp of the first scan, t = 0.
    """
    numbers = sorted({visit.submap_id for visit in visits})
    clock = _Clock(visits, first_ns)
    dates_inches = 0.8 if clock.cuts else 0.0
    figure = Figure(figsize=(8.0, 1.6 + dates_inches + 0.28 * len(numbers)), dpi=100, layout="constrained")
    axes = figure.subplots()
    if not visits:
        axes.set_axis_off()
        axes.text(0.5, 0.5, "no sub-map was visited", ha="center", va="center")
        return as_png(figure)
    for row, number in enumerate(numbers):
        own = sorted((v for v in visits if v.submap_id == number), key=lambda v: (v.start_ns, v.sequence))
        spans = [(clock.at(visit.start_ns), clock.at(visit.end_ns)) for visit in own]
        known = [visit for visit in own if visit.patch is not None]
        for before, after in pairwise(known):
            if before.patch == after.patch:
                ends = [clock.at(before.end_ns), clock.at(after.start_ns)]
                axes.plot(ends, [row, row], color=_colour(before), linewidth=1.5, solid_capstyle="butt")
        axes.broken_barh(
            [(start, max(end - start, _LEAST_WIDTH * clock.width)) for start, end in spans],
            (row - 0.35, 0.7),
            facecolors=[_colour(visit) for visit in own],
            edgecolor="white",
            linewidth=0.3,
            zorder=3,
        )
    for edge in clock.cuts:
        axes.axvline(edge, color="#a0a0a0", linewidth=0.8, linestyle=":", zorder=1)
    called = {submap.submap_id: submap.called for submap in submaps}
    axes.set_yticks(range(len(numbers)), [called[number] for number in numbers], parse_math=False)
    axes.set_ylim(len(numbers) - 0.4, -0.6)
    if clock.cuts:
        axes.set_xticks(*clock.ticks(), rotation=30, ha="right")
    axes.set_xlabel(clock.label)
    axes.set_ylabel("sub-map")
    if visits:
        figure.legend(handles=_legend(visits), loc="outside upper left", ncols=6, frameon=False)
    return as_png(figure)


class _Clock:
    """Seconds of the figure: those from the first scan, without the pauses in which no sub-map was visited."""

    def __init__(self, visits: Sequence[Visit], first_ns: int) -> None:
        spans = sorted([(first_ns, first_ns), *((visit.start_ns, visit.end_ns) for visit in visits)])
        self._starts, self._ends = [start for start, _ in spans[:1]], [end for _, end in spans[:1]]
        for start, end in spans[1:]:
            if start - self._ends[-1] > _PAUSE_NS:
                self._starts.append(start)
                self._ends.append(end)
            self._ends[-1] = max(self._ends[-1], end)
        lengths = [(end - start) * 1e-9 for start, end in zip(self._starts, self._ends, strict=True)]
        gap = 0.02 * sum(lengths)
        self._offsets = [sum(lengths[:number]) + number * gap for number in range(len(lengths))]
        self.width = max(sum(lengths) + gap * max(len(lengths) - 1, 0), 1e-9)
        self.cuts = [offset - 0.5 * gap for offset in self._offsets[1:]]
        self.label = (
            f"pauses of over {_PAUSE_NS // (60 * 10**9)} min are cut out"
            if self.cuts
            else "t, seconds from the first scan"
        )

    def at(self, stamp_ns: int) -> float:
        """Place of a stamp, which lies in some visit."""
        number = bisect_right(self._starts, stamp_ns) - 1
        return self._offsets[number] + (stamp_ns - self._starts[number]) * 1e-9

    def ticks(self) -> tuple[list[float], list[str]]:
        """Where stretches start, and times in long ones; at most about `_MOST_TICKS`."""
        step_ns = max(round(self.width / _MOST_TICKS * 1e9), 1)
        stamps: list[int] = []
        for start, end in zip(self._starts, self._ends, strict=True):
            for stamp in range(start, max(end, start + 1), step_ns):
                if not stamps or (self.at(stamp) - self.at(stamps[-1])) * 1e9 > 0.9 * step_ns:
                    stamps.append(stamp)
        return [self.at(stamp) for stamp in stamps], [readable_time(stamp) for stamp in stamps]


def _colour(visit: Visit) -> str:
    """Of the state that a visit saw."""
    return _OPEN if visit.patch is None else COLOURS[visit.patch % len(COLOURS)]


def _legend(visits: Sequence[Visit]) -> list[Patch]:
    """One entry per colour; from the ninth state on a colour stands for several."""
    states = sorted({visit.patch for visit in visits if visit.patch is not None})
    entries = []
    for number, colour in enumerate(COLOURS):
        own = [str(state) for state in states if state % len(COLOURS) == number]
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
