"""One figure per measure, as PNG."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dynmap_cli.arrays import F64
from dynmap_cli.evaluation.scores import Score
from dynmap_cli.files.atomic import replacing


def plot_distributions(path: Path, scores: Sequence[Score]) -> None:
    """Share of the errors that are below each value, one panel per series."""
    names = list(scores[0].series)
    figure = Figure(figsize=(4.5 * len(names), 3.4), dpi=110, layout="constrained")
    for axes, name in zip(np.atleast_1d(figure.subplots(1, len(names))), names, strict=True):
        for score in scores:
            errors = np.sort(score.series[name])
            share = np.arange(1, errors.size + 1) / max(errors.size, 1)
            axes.plot(errors, 100.0 * share, label=score.name)
        axes.set_xlabel(name)
        axes.set_ylabel("below, %")
        axes.grid(visible=True, color="#e4e4e4")
        axes.legend()
    _save(path, figure)


def plot_paths(path: Path, scores: Sequence[Score]) -> None:
    """Paths seen from above, one panel per result."""
    figure = Figure(figsize=(5.0 * len(scores), 4.6), dpi=110, layout="constrained")
    for axes, score in zip(np.atleast_1d(figure.subplots(1, len(scores))), scores, strict=True):
        for name, points in score.series.items():
            axes.plot(points[:, 0], points[:, 1], linewidth=0.9, label=name)
        axes.set_aspect("equal")
        axes.set_title(score.name)
        axes.set_xlabel("x, m")
        axes.set_ylabel("y, m")
        axes.legend()
    _save(path, figure)


def plot_bars(path: Path, scores: Sequence[Score], names: Sequence[str], label: str) -> None:
    """Bars of some values, grouped by value, one colour per result."""
    figure = Figure(figsize=(1.6 + 1.3 * len(names), 3.4), dpi=110, layout="constrained")
    axes = figure.subplots()
    width = 0.8 / len(scores)
    places: F64 = np.arange(len(names), dtype=np.float64)
    for number, score in enumerate(scores):
        shift = (number - 0.5 * (len(scores) - 1)) * width
        axes.bar(places + shift, [score.values[name] for name in names], width, label=score.name)
    axes.set_xticks(places, [name.replace("_", "\n") for name in names])
    axes.set_ylabel(label)
    axes.legend(loc="lower right")
    _save(path, figure)


def plot_over_time(path: Path, scores: Sequence[Score]) -> None:
    """Series over the series "seconds", one panel each, on a logarithmic axis."""
    names = [name for name in scores[0].series if name != "seconds"]
    figure = Figure(figsize=(8.0, 2.4 * len(names)), dpi=110, layout="constrained")
    for axes, name in zip(np.atleast_1d(figure.subplots(len(names), 1)), names, strict=True):
        for score in scores:
            axes.semilogy(score.series["seconds"], score.series[name], linewidth=0.9, label=score.name)
        axes.set_xlabel("s")
        axes.set_ylabel(name)
        axes.grid(visible=True, color="#e4e4e4")
        axes.legend()
    _save(path, figure)


def _save(path: Path, figure: Figure) -> None:
    with replacing(path) as part:
        part.write_bytes(_as_png(figure))


def _as_png(figure: Figure) -> bytes:
    """Render without anything of the machine or the hour in it."""
    stream = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()
