"""Tables as Markdown: what was measured, number by number, and why a row has none."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from dynmap_cli.evaluation.scores import Band, Score, bands

Row = list[str]


@dataclass
class Table:
    """One table of the results.

    Attributes
    ----------
    title : str
    about : list of str
        What the columns mean and how it was measured.
    header : list of str
    rows : list of list of str
    short : list of (str, str)
        Rows of the short form.
    """

    title: str
    about: list[str]
    header: list[str]
    rows: list[Row] = field(default_factory=list)
    short: list[tuple[str, str]] = field(default_factory=list)

    def add(self, name: str, make: Callable[[], Sequence[str]]) -> None:
        """Add a row; if it cannot be made, the row says why."""
        try:
            cells = list(make())
        except Exception as err:
            cells = [f"**failed**: {type(err).__name__}: {err}".replace("|", "/").replace("\n", " ")]
        self.rows.append([name, *cells, *([""] * (len(self.header) - 1 - len(cells)))])

    def remark(self, what: str, make: Callable[[], str]) -> None:
        """Add a line to the short form; if it cannot be made, the line says why."""
        try:
            text = make()
        except Exception as err:
            text = f"failed: {type(err).__name__}: {err}".replace("|", "/").replace("\n", " ")
        self.short.append((what, text))

    def lines(self) -> list[str]:
        """The table as Markdown."""
        found = [f"## {self.title}", "", *self.about, ""]
        found += ["| " + " | ".join(self.header) + " |", "|" + "---|" * len(self.header)]
        return [*found, *("| " + " | ".join(row) + " |" for row in self.rows), ""]


def number(value: float, digits: int = 3) -> str:
    """A number with fixed digits; a dash for what cannot be said."""
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"


def percent(value: float, digits: int = 1) -> str:
    """A share as percent."""
    return f"{100 * value:.{digits}f} %" if math.isfinite(value) else "-"


def banded(band: Band, digits: int = 3) -> str:
    """Mean with its 5 and 95 % band; without where all are equal."""
    if not math.isfinite(band.mean):
        return "-"
    mean, low, high = (f"{value:.{digits}f}" for value in (band.mean, band.low, band.high))
    return mean if low == high else f"{mean} ({low} to {high})"


def bands_of(scores: Sequence[Score]) -> dict[str, Band]:
    """Bands over seeds; a value that some seeds do not have (nothing changed in view) is taken over the others.

    An incomplete result still voids all values, as in `dynmap evaluate`.
    """
    found = bands(scores, 0)
    for name in scores[0].values:
        known = [score for score in scores if math.isfinite(score.values[name])]
        if 0 < len(known) < len(scores) and all(score.is_complete for score in scores):
            found[name] = bands([Score(s.name, s.coverage, {name: s.values[name]}) for s in known], 0)[name]
    return found
