"""What a localization found, in numbers and in sentences."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dynmap_cli.domain.patches import NEVER_MAPPED, SURE
from dynmap_cli.domain.poses import Trajectory
from dynmap_cli.localization.beliefs.state_tables import PatchBelief
from dynmap_cli.localization.found import Localization
from dynmap_cli.localization.watching.changes import (
    ChangedPlace,
    changed_line,
    is_another_place,
    places_to_update,
)

VERDICTS = ("tracking", "changed", "lost")


def summarize(
    found: Localization, believed: Sequence[PatchBelief], names: Mapping[int, str]
) -> dict[str, Any]:
    """What was found, as numbers and as sentences.

    Parameters
    ----------
    found : Localization
    believed : sequence of PatchBelief
        By time.
    names : mapping of int to str
        What people call the sub-maps, "" = nothing.
    """
    verdicts = Counter(row.verdict for row in found.health)
    n_updates = max(len(found.health), 1)
    n_scans = int(found.trajectory.stamps_ns.size)
    shares = {verdict: verdicts[verdict] / n_updates for verdict in VERDICTS}
    words = [f"{_percent(shares['tracking'])} tracking"]
    if verdicts["changed"]:
        words.append(f"{_percent(shares['changed'])} in changed surroundings")
    words.append(f"{_percent(shares['lost'])} lost" if verdicts["lost"] else "never lost")
    if found.searches:
        times = "once" if len(found.searches) == 1 else f"{len(found.searches)} times"
        words.append(f"searched for in the whole map {times}")
    first_ns = int(found.trajectory.stamps_ns[0]) if n_scans else 0
    lines = [f"{n_scans} scans{_from_start(found.trajectory)}: {', '.join(words)}"]
    if changed := changed_line(found.health, first_ns):
        lines.append(changed)
    by_submap: dict[int, list[PatchBelief]] = {}
    for row in believed:
        by_submap.setdefault(row.submap_id, []).append(row)
    lines += [
        f"sub-map {_called(submap_id, names)}: {_history(rows, first_ns)}"
        for submap_id, rows in sorted(by_submap.items())
    ]
    return {
        "scans": n_scans,
        "updates": len(found.health),
        "path_m": round(found.trajectory.length_m(), 3),
        **{verdict: round(share, 4) for verdict, share in shares.items()},
        "another_place": is_another_place(found.health),
        "drives_alike": len(found.alike),
        "searches": len(found.searches),
        "submaps_seen": len(by_submap),
        "places_to_update": [_as_row(one) for one in places_to_update(found.health)],
        "lines": lines,
    }


def _as_row(changed: ChangedPlace) -> dict[str, Any]:
    """A place where the map is out of date, for programs and for the picture."""
    place = changed.place
    return {
        "kind": place.kind,
        "submap": place.submap_id,
        "x_m": round(place.x_m, 3),
        "y_m": round(place.y_m, 3),
        "updates": changed.updates,
    }


def _percent(share: float) -> str:
    """A share for people."""
    return "< 1 %" if 0.0 < share < 0.005 else f"{100 * share:.0f} %"


def _from_start(trajectory: Trajectory) -> str:
    """Where the robot was found to start."""
    if not trajectory.stamps_ns.size:
        return ""
    x_m, y_m, yaw_rad = trajectory.poses[0].tolist()
    return f" from ({x_m:.2f}, {y_m:.2f}) m, {math.degrees(yaw_rad):.0f} deg"


def _called(submap_id: int, names: Mapping[int, str]) -> str:
    """Number and name of a sub-map."""
    name = names.get(submap_id, "")
    return f"{submap_id} ({name})" if name else str(submap_id)


def sure_states(rows: Sequence[PatchBelief]) -> list[tuple[int, str]]:
    """States of one sub-map in the order in which they were believed: since which stamp, and what each is called."""
    found: list[tuple[int, str]] = []
    current = None
    for row in rows:
        state = int(np.argmax(row.belief))
        if state == current or row.belief[state] < SURE:
            continue
        found.append((row.stamp_ns, _state(row, state)))
        current = state
    return found


def _history(rows: Sequence[PatchBelief], first_ns: int) -> str:
    """States of one sub-map in the order in which they were believed, with the times of the changes."""
    words: list[str] = []
    for stamp_ns, called in sure_states(rows):
        seen = f"-> {called}, seen from t = {(stamp_ns - first_ns) * 1e-9:.1f} s"
        words.append(seen if words else f"state {called}")
    last = rows[-1]
    likeliest = int(np.argmax(last.belief))
    probability = f"({last.belief[likeliest]:.2f})"
    if last.belief[likeliest] >= SURE:
        return f"{' '.join(words)} {probability}"
    in_the_end = f"undecided, likeliest state {_state(last, likeliest)} {probability}"
    return f"{' '.join(words)}; in the end {in_the_end}" if words else f"seen, its state stayed {in_the_end}"


def _state(row: PatchBelief, state: int) -> str:
    """What a state is called: its number, or the combination of objects that is nearest to one never mapped."""
    return row.description if row.patch_ids[state] == NEVER_MAPPED else str(row.patch_ids[state])
