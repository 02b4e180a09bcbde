"""Where and when a recording shows that the map is out of date."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from dynmap_cli.localization.found import HealthRow
from dynmap_cli.localization.watching.health import DOUBT
from dynmap_cli.localization.watching.placement import AGREEING_BEAMS
from dynmap_cli.localization.watching.places import Place

SAME_PLACE_M = 1.5
LEAST_UPDATES = 5
"""What was seen changed in fewer updates is not worth an update of the map."""
MOST_NAMED = 5
ANOTHER_PLACE, ANOTHER_SHARE = 1.8, 0.1
"""A recording is not of the place of the map if the map contradicts the scans by more than this in so large a share of
its updates. The robot is put where most of its scans fit, and places look alike; what it drives through outside the
map counts only where beams go through walls."""
AGREES_SHARE = 0.5
"""Share of the updates in one piece that agree with the map, after which it is that of the place all the same: rooms
look alike, but not one after another. A robot that starts outside the map, or where much has changed, is contradicted
until it comes to where the map is right."""


@dataclass(slots=True)
class ChangedPlace:
    """Updates in which the surroundings were changed in one place.

    Attributes
    ----------
    place : Place
        Where it was worst.
    stamp_ns : int
        When it was worst.
    share : float
        Of the beams then.
    updates : int
    """

    place: Place
    stamp_ns: int
    share: float
    updates: int = 1


def changed_places(rows: Sequence[HealthRow]) -> list[ChangedPlace]:
    """Places of the updates that found changed surroundings, those seen most often first."""
    found: list[ChangedPlace] = []
    for row in rows:
        place, share = row.health.where, row.health.changed
        if row.verdict != "changed" or place is None:
            continue
        known = next((one for one in found if _is_same(one.place, place)), None)
        if known is None:
            found.append(ChangedPlace(place, row.stamp_ns, share))
            continue
        known.updates += 1
        if share > known.share:
            known.place, known.stamp_ns, known.share = place, row.stamp_ns, share
    return sorted(found, key=lambda one: -one.updates)


def places_to_update(rows: Sequence[HealthRow]) -> list[ChangedPlace]:
    """Places for which a map update is advised, those seen most often first; none if the map is of another place."""
    places = [] if is_another_place(rows) else changed_places(rows)
    return [one for one in places if one.updates >= LEAST_UPDATES]


def changed_line(rows: Sequence[HealthRow], first_ns: int) -> str:
    """One sentence on where the map is out of date; empty where it is not, or is of another place."""
    places = [] if is_another_place(rows) else changed_places(rows)
    if not places:
        return ""
    share = sum(one.updates for one in places) / len(rows)
    worst = max(places, key=lambda one: one.share)
    words = (
        f"{100 * share:.0f} % of the run in changed surroundings, worst: {worst.place.called} "
        f"(t = {(worst.stamp_ns - first_ns) * 1e-9:.1f} s, {100 * worst.share:.0f} % of the beams)"
    )
    named = [one.place.called for one in places_to_update(rows)]
    if named:
        n_more = len(named) - MOST_NAMED
        more = f" and {n_more} more {'place' if n_more == 1 else 'places'}" if n_more > 0 else ""
        words += f"; a map update is advised for {', '.join(named[:MOST_NAMED])}{more}"
    return words


def is_another_place(rows: Sequence[HealthRow]) -> bool:
    """Whether a recording was not made in the place of the map: many updates contradict it wherever it is put.

    Particles that sit in several places do not: the map may look the same from all of them.
    """
    contradicted = sum(row.contradiction > ANOTHER_PLACE for row in rows)
    if not rows or contradicted < ANOTHER_SHARE * len(rows):
        return False
    return _most_in_a_row(map(_agrees, rows)) < AGREES_SHARE * len(rows)


def _agrees(row: HealthRow) -> bool:
    """Whether an update shows what the map shows."""
    on_map = row.health.explained + row.health.explained_by_other_state
    return row.contradiction <= DOUBT and on_map >= AGREEING_BEAMS


def _most_in_a_row(flags: Iterable[bool]) -> int:
    """Length of the longest run of true flags."""
    return max((sum(1 for _ in run) for is_true, run in groupby(flags) if is_true), default=0)


def _is_same(one: Place, other: Place) -> bool:
    """Whether two places are the same sub-map, or near each other."""
    if one.submap_id is not None or other.submap_id is not None:
        return one.submap_id == other.submap_id
    return bool(np.hypot(one.x_m - other.x_m, one.y_m - other.y_m) <= SAME_PLACE_M)
