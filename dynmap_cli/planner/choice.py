"""Which state of a sub-map is painted, and why."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from dynmap_cli.domain.patches import Visit
from dynmap_cli.domain.times import parse_iso, readable_time
from dynmap_cli.files.trajectory import parse_stamp

_DATE = re.compile(r"(19|20|21)\d{6}")
"""A date as ISO 8601 also writes it; such a count of seconds lies in the year 1970, when no robot drove."""
LATEST, MOST_LIKELY, OPEN, UNION, AT = "latest", "most-likely", "open", "union", "at"


@dataclass(frozen=True, slots=True)
class StateRule:
    """How states are chosen.

    Attributes
    ----------
    kind : str
        `latest` (of the last visit that knows), `most-likely` (seen in most visits), `open` (a cell that is free in
        any state is free), `union` (a cell that is occupied in any state is occupied), or `at` (of the last visit that
        knows and began by a time).
    stamp_ns : int or None
        The time, for `at`.
    """

    kind: str
    stamp_ns: int | None = None


def parse_rule(text: str) -> StateRule:
    """Read a rule as the command line gives it; a time is in seconds since the epoch or ISO 8601, UTC.

    Raises
    ------
    ValueError
        If it is none.
    """
    if text in (LATEST, MOST_LIKELY, OPEN, UNION):
        return StateRule(text)
    kind, _, time = text.partition("=")
    if kind != AT or not time:
        msg = f"expected {LATEST}, {MOST_LIKELY}, {OPEN}, {UNION} or {AT}=TIME"
        raise ValueError(msg)
    readers = (parse_iso, parse_stamp) if _DATE.fullmatch(time) else (parse_stamp, parse_iso)
    for parse in readers:
        try:
            return StateRule(AT, parse(time))
        except (ValueError, OverflowError):
            continue
    msg = "TIME is seconds since the epoch or ISO 8601 in UTC, for instance at=2026-03-02T08:00:00Z"
    raise ValueError(msg)


@dataclass(frozen=True, slots=True)
class Choice:
    """What is painted of a sub-map.

    Attributes
    ----------
    states : tuple of int
        Numbers of the patches; one, or all of them where they are combined; none where nothing is known.
    seen_ns : int or None
        When it was last seen, as far as the rule looks.
    why : str
        In words.
    """

    states: tuple[int, ...]
    seen_ns: int | None
    why: str


def choose_states(rule: StateRule, visits: Sequence[Visit]) -> Choice:
    """Choose among the states that the visits of one sub-map saw.

    Parameters
    ----------
    rule : StateRule
    visits : sequence of Visit
        All of one sub-map.
    """
    ordered = sorted(visits, key=lambda visit: (visit.start_ns, visit.sequence))
    known = [visit for visit in ordered if visit.patch is not None]
    if not known:
        return Choice((), None, f"no state known from {_visits(len(visits))}")
    if rule.kind in (OPEN, UNION):
        return _combined(rule.kind, known)
    if rule.kind == MOST_LIKELY:
        return _most_frequent(known)
    return _last(ordered, known, rule.stamp_ns)


def _last(ordered: Sequence[Visit], known: Sequence[Visit], until_ns: int | None) -> Choice:
    """The state of the last visit that knows it."""
    by_then = [visit for visit in known if until_ns is None or visit.start_ns <= until_ns]
    if not by_then:
        return Choice((), None, f"no state known by then, first seen {readable_time(known[0].start_ns)}")
    last = by_then[-1]
    later = [
        visit
        for visit in ordered[ordered.index(last) + 1 :]
        if visit.patch is None and (until_ns is None or visit.start_ns <= until_ns)
    ]
    words = f"last seen {readable_time(last.end_ns)} in {last.recording}"
    if later:
        words += f"; {_visits(len(later))} after it recognised none"
    return Choice((_patch(last),), last.end_ns, words)


def _most_frequent(known: Sequence[Visit]) -> Choice:
    """The state of most visits; of several the one that was seen last."""
    counts = Counter(_patch(visit) for visit in known)
    most = max(counts.values())
    last = next(visit for visit in reversed(known) if counts[_patch(visit)] == most)
    others = sorted(state for state, count in counts.items() if count == most and state != _patch(last))
    words = f"seen in {most} of {_visits(len(known))}, last {readable_time(last.end_ns)}"
    if others:
        words += f"; as often as state {', '.join(map(str, others))}, but seen later"
    return Choice((_patch(last),), last.end_ns, words)


def _combined(kind: str, known: Sequence[Visit]) -> Choice:
    """All states together."""
    states = tuple(sorted({_patch(visit) for visit in known}))
    what = "free where any of them is free" if kind == OPEN else "occupied where any of them is occupied"
    if len(states) == 1:
        what = "the only one"
    span = f"{readable_time(known[0].start_ns)} to {readable_time(known[-1].end_ns)}"
    return Choice(states, known[-1].end_ns, f"{what}, seen in {_visits(len(known))} from {span}")


def _patch(visit: Visit) -> int:
    """The state of a visit that knows it."""
    assert visit.patch is not None
    return visit.patch


def _visits(count: int) -> str:
    """So many visits."""
    return f"{count} visit{'s' * (count != 1)}"
