"""The figures of a comparison: errors over time (paper, Fig. 1.13), beliefs in states over time (Fig. 1.15)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from dynmap_cli.arrays import F64
from dynmap_cli.comparison.courses import Course
from dynmap_cli.domain.patches import NEVER_MAPPED
from dynmap_cli.report.curves import COLOURS, as_png

MOST_SUBMAPS = 8
"""Sub-maps in the figure of beliefs, those that were in view most often."""
_LEAST_M = 1e-3
_PAUSE_S = 5.0


def draw_courses(courses: Sequence[Course], first_ns: int, *, with_truth: bool) -> bytes:
    """Draw error (where there is truth), distance from the pose in the patch map, and spread, by time; a PNG.

    *first_ns* is the stamp of the first scan, t = 0.
    """
    panels = ["spread of the particles, m", "away from the patch map, m"]
    if with_truth:
        panels.insert(0, "error of the particles, m")
    figure = Figure(figsize=(9.0, 0.6 + 2.3 * len(panels)), dpi=100, layout="constrained")
    grid = np.atleast_1d(figure.subplots(len(panels), 1, sharex=True))
    for axes, panel in zip(grid, panels, strict=True):
        for number, course in reversed(list(enumerate(courses))):
            values = {
                "error of the particles, m": course.error_m,
                "spread of the particles, m": course.spread_m,
                "away from the patch map, m": course.away_from_m(courses[0]),
            }[panel]
            if number == 0 and panel.startswith("away"):
                continue
            times = np.asarray((course.stamps_ns - first_ns) * 1e-9, dtype=np.float64)
            seconds, shown = _with_gaps(times, np.maximum(values, _LEAST_M))
            axes.plot(
                seconds,
                shown,
                color=COLOURS[number % len(COLOURS)],
                linewidth=1.6 if number == 0 else 0.9,
                label=course.compared.name,
            )
        axes.set_yscale("log")
        lowest, highest = axes.dataLim.intervaly
        if np.isfinite([lowest, highest]).all():
            axes.set_ylim(10.0 ** np.floor(np.log10(lowest)), 10.0 ** np.ceil(np.log10(highest * 1.01)))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter("")
        axes.set_ylabel(panel)
        axes.grid(visible=True, color="#e4e4e4")
    grid[-1].set_xlabel("t, seconds from the first scan")
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles[::-1], labels[::-1], loc="outside upper left", ncols=4, frameon=False)
    return as_png(figure)


def draw_beliefs(course: Course, called: Mapping[int, str], first_ns: int) -> bytes:
    """Draw the probability of each state over time, a panel per sub-map that was seen, of which there are some; a PNG.

    Parameters
    ----------
    course : Course
        In the patch map.
    called : mapping of int to str
        Number and name of each sub-map, by its number.
    first_ns : int
        Stamp of the first scan, t = 0.
    """
    counts: dict[int, int] = {}
    for row in course.states:
        counts[row.submap_id] = counts.get(row.submap_id, 0) + 1
    shown = sorted(sorted(counts, key=lambda number: (-counts[number], number))[:MOST_SUBMAPS])
    figure = Figure(figsize=(9.0, 0.8 + 1.6 * len(shown)), dpi=100, layout="constrained")
    grid = np.atleast_1d(figure.subplots(len(shown), 1, sharex=True))
    for axes, number in zip(grid, shown, strict=True):
        rows = [row for row in course.states if row.submap_id == number]
        seconds = np.array([(row.stamp_ns - first_ns) * 1e-9 for row in rows])
        for state, patch_id in enumerate(rows[0].patch_ids):
            spread, values = _with_gaps(seconds, np.array([row.belief[state] for row in rows]))
            label = "never mapped" if patch_id == NEVER_MAPPED else f"state {patch_id}"
            colour = COLOURS[patch_id % len(COLOURS)]
            axes.plot(spread, values, ".-", markersize=3, linewidth=1.0, color=colour, label=label)
        axes.set_ylim(-0.05, 1.05)
        name = called.get(number, str(number))
        axes.set_title(f"sub-map {name}", loc="left", fontsize=9, parse_math=False)
        axes.set_ylabel("probability")
        axes.grid(visible=True, color="#e4e4e4")
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, frameon=False)
    grid[-1].set_xlabel("t, seconds from the first scan")
    return as_png(figure)


def _with_gaps(seconds: F64, values: F64) -> tuple[F64, F64]:
    """Put a hole where nothing was measured for long, so that no line is drawn across it."""
    gaps = np.flatnonzero(np.diff(seconds) > _PAUSE_S) + 1
    return np.insert(seconds, gaps, np.nan), np.insert(values, gaps, np.nan)
