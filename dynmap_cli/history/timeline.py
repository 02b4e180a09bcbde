"""The visits of all sub-maps in time order, and what they say about each sub-map."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from dynmap_cli.domain.patches import Visit
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.files.trajectory import format_stamp

TIMELINE_HEADER = "submap,visit,recording,enter_s,leave_s,state,membership,remark"


@dataclass(frozen=True, slots=True)
class History:
    """What the visits of a sub-map saw.

    Attributes
    ----------
    submap_id : int
    called : str
        Its number, and its name where it has one.
    visits : tuple of Visit
        In time order.
    stay_probability : float or None
        As learned: probability that the state is the same one minute later; None where no state is known.
    """

    submap_id: int
    called: str
    visits: tuple[Visit, ...]
    stay_probability: float | None

    @property
    def seen(self) -> dict[int, int]:
        """State -> number of visits that saw it."""
        return dict(sorted(Counter(self.states).items()))

    @property
    def states(self) -> tuple[int, ...]:
        """The states in the order in which they were seen; visits without one are passed over."""
        return tuple(visit.patch for visit in self.visits if visit.patch is not None)

    @property
    def transitions(self) -> dict[tuple[int, int], int]:
        """(before, after) -> how often one state followed another; what lay between two visits nobody saw."""
        return dict(sorted(Counter(pair for pair in pairwise(self.states) if pair[0] != pair[1]).items()))

    @property
    def open_visits(self) -> dict[str, int]:
        """Remark -> number of visits without a state."""
        return dict(sorted(Counter(visit.remark for visit in self.visits if visit.patch is None).items()))


def histories_of(
    submaps: Sequence[SubMap], visits: Sequence[Visit], stay_probabilities: Mapping[int, float]
) -> tuple[History, ...]:
    """Sort visits by sub-map and time.

    Parameters
    ----------
    submaps : sequence of SubMap
        All of them, also those that nobody visited.
    visits : sequence of Visit
    stay_probabilities : mapping of int to float
        Of the sub-maps whose states are known.
    """
    ordered = in_time_order(visits)
    return tuple(
        History(
            submap.submap_id,
            submap.called,
            tuple(visit for visit in ordered if visit.submap_id == submap.submap_id),
            stay_probabilities.get(submap.submap_id),
        )
        for submap in submaps
    )


def in_time_order(visits: Sequence[Visit]) -> list[Visit]:
    """By entering; where several sub-maps are entered at once, by their numbers."""
    return sorted(visits, key=lambda visit: (visit.start_ns, visit.submap_id, visit.sequence))


def as_csv(visits: Sequence[Visit]) -> bytes:
    """One row per visit and sub-map, in time order; state and membership are empty where none was recognised."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(TIMELINE_HEADER.split(","))
    for visit in in_time_order(visits):
        known = visit.patch is not None
        writer.writerow(
            [
                visit.submap_id,
                visit.sequence,
                visit.recording,
                format_stamp(visit.start_ns),
                format_stamp(visit.end_ns),
                visit.patch if known else "",
                f"{visit.membership:.6f}" if known else "",
                visit.remark,
            ]
        )
    return stream.getvalue().encode("utf-8", errors="backslashreplace")


def describe(history: History, place: str) -> str:
    """Say in a sentence how often each state was seen, how often it changed, and how long it stays.

    Parameters
    ----------
    history : History
    place : str
        Where the sub-map is.
    """
    count = len(history.visits)
    seen = ", ".join(f"state {state} in {number}" for state, number in history.seen.items())
    words = [f"{count} visit{'s' * (count != 1)}" + (f" ({seen})" if seen else "")]
    words += [f"{number} {remark}" for remark, number in history.open_visits.items()]
    if history.seen:
        total = sum(history.transitions.values())
        pairs = ", ".join(f"{a} -> {b}: {number}" for (a, b), number in history.transitions.items())
        words.append(f"{total} transition{'s' * (total != 1)}" + (f" ({pairs})" if pairs else ""))
    if history.stay_probability is not None:
        words.append(f"stays for a minute with probability {history.stay_probability:.3f}")
    return f"sub-map {history.called} at {place}: {', '.join(words)}"
