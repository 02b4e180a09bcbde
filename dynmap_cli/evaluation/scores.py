"""What a measure says of one pair of result and truth, and of several together."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dynmap_cli.arrays import F64

COMPLETE_SHARE = 0.99
"""A result that answers less of what was asked for than this has lost, however good the rest is."""
_RESAMPLES = 2000


@dataclass(frozen=True, slots=True)
class Score:
    """Measures of one result.

    Attributes
    ----------
    name : str
        What was measured.
    coverage : float
        Share of what was asked for that has an answer.
    values : dict of str to float
        The unit is in the name; NaN = cannot be said.
    details : dict of str to list of dict
        Tables behind the values: title -> rows of column -> entry.
    series : dict of str to (n,) float64
        Numbers that the figure shows.
    """

    name: str
    coverage: float
    values: Mapping[str, float]
    details: Mapping[str, Sequence[Mapping[str, Any]]] = field(default_factory=dict)
    series: Mapping[str, F64] = field(default_factory=dict)

    @property
    def is_complete(self) -> bool:
        """Whether enough was answered for the values to count."""
        return self.coverage >= COMPLETE_SHARE


@dataclass(frozen=True, slots=True)
class Band:
    """Mean over several results, with the 5 and 95 % quantiles of its bootstrap; NaN where one of them has no value.

    Attributes
    ----------
    mean, low, high : float
    """

    mean: float
    low: float
    high: float


def bands(scores: Sequence[Score], seed: int) -> dict[str, Band]:
    """Bootstrap the mean of each value over the scores; one incomplete score makes all bands NaN.

    Parameters
    ----------
    scores : sequence of Score
        Of the same measure.
    seed : int
    """
    draw = np.random.default_rng(seed).integers(0, len(scores), size=(_RESAMPLES, len(scores)))
    result = {}
    for name in scores[0].values:
        values = np.array([score.values[name] if score.is_complete else math.nan for score in scores])
        if not np.isfinite(values).all():
            result[name] = Band(math.nan, math.nan, math.nan)
            continue
        low, high = np.quantile(values[draw].mean(axis=1), [0.05, 0.95])
        result[name] = Band(float(values.mean()), float(low), float(high))
    return result


def as_record(scores: Sequence[Score], seed: int) -> dict[str, Any]:
    """Everything as JSON knows it; what is not a number becomes null."""
    rows = [
        {
            "name": score.name,
            "coverage": _number(score.coverage),
            "complete": score.is_complete,
            **{name: _number(value) for name, value in score.values.items()},
            "details": {
                title: [{key: _number(entry) for key, entry in row.items()} for row in rows]
                for title, rows in score.details.items()
            },
        }
        for score in scores
    ]
    record: dict[str, Any] = {"results": rows}
    if len(scores) > 1:
        record["bands"] = {
            name: {"mean": _number(band.mean), "p05": _number(band.low), "p95": _number(band.high)}
            for name, band in bands(scores, seed).items()
        }
    return record


def as_lines(scores: Sequence[Score], seed: int) -> list[str]:
    """A table with a row per measure and a column per result, then the tables behind it."""
    header = ["", *(score.name for score in scores)]
    rows = [["coverage", *(_coverage(score) for score in scores)]]
    summary = bands(scores, seed) if len(scores) > 1 else {}
    for name in scores[0].values:
        row = [name, *(_text(score.values[name]) for score in scores)]
        if summary:
            band = summary[name]
            row += [_text(band.mean), _text(band.low), _text(band.high)]
        rows.append(row)
    if summary:
        header += ["mean", "5 %", "95 %"]
        rows[0] += ["", "", ""]
    lines = table(header, rows)
    for score in scores:
        for title, entries in score.details.items():
            if entries:
                lines += ["", f"{title} ({score.name})", *_entries_table(entries)]
    lost = [score.name for score in scores if not score.is_complete]
    if lost:
        lines += ["", f"INCOMPLETE, these rows do not count: {', '.join(lost)}"]
    return lines


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Columns of equal width, two blanks apart; the first to the left, the others to the right."""
    widths = [max(len(row[column]) for row in (header, *rows)) for column in range(len(header))]
    return [
        "  ".join(
            word.ljust(width) if column == 0 else word.rjust(width)
            for column, (word, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in (header, *rows)
    ]


def _entries_table(entries: Sequence[Mapping[str, Any]]) -> list[str]:
    header = list(entries[0])
    return table(header, [[_text(entry[name]) for name in header] for entry in entries])


def _coverage(score: Score) -> str:
    text = f"{100.0 * score.coverage:.1f} %"
    return text if score.is_complete else f"{text} INCOMPLETE"


def _text(value: Any) -> str:
    """Four digits; a dash for what cannot be said."""
    if isinstance(value, (float, np.floating)):
        return f"{value:.4g}" if math.isfinite(value) else "-"
    return str(value)


def _number(value: Any) -> Any:
    """Turn NaN and infinity into null, and numpy numbers into plain ones."""
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value


def mean_or_nan(values: F64) -> float:
    """Mean; NaN of nothing."""
    return float(values.mean()) if values.size else math.nan


def ratio(count: float, total: float) -> float:
    """Count / total; NaN of nothing."""
    return count / total if total else math.nan
