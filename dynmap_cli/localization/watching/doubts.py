"""Whether what a localization found can be believed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynmap_cli.localization.found import HealthRow
from dynmap_cli.localization.watching.placement import AGREEING_BEAMS

_MUCH_LOST = 0.2
_MUCH_CHANGED = 1.0 / 3.0
"""Of the updates: more than in offices whose doors all stand open and that lost several walls, up to a quarter."""


def doubts(
    rows: Sequence[HealthRow], alike: Sequence[str], *, lost_share: float, is_elsewhere: bool
) -> list[str]:
    """A robot that is lost for much of a recording is probably somewhere else, or where places look alike.

    Parameters
    ----------
    rows : sequence of HealthRow
    alike : sequence of str
        Drives that fit the map from several places, one sentence each.
    lost_share : float
        Of the updates.
    is_elsewhere : bool
        Whether the recording was not made in the place of the map.

    Returns
    -------
    list of str
        Sentences; none where nothing speaks against the results.
    """
    if is_elsewhere:
        return [
            "this is not the place of the map: many of the scans contradict it wherever the robot is put; "
            "do not trust states and poses"
        ]
    if lost_share <= _MUCH_LOST:
        return [*alike, *_of_changes(rows)]
    return list(alike) or [
        f"lost for {100 * lost_share:.0f} % of the recording: it probably shows another place than the map, or one "
        "that changed a lot; do not trust states and poses"
    ]


def began_outside(rows: Sequence[HealthRow], first_ns: int) -> str:
    """One sentence where the recording begins in a room that the map does not show, and comes into the map; else "".

    Parameters
    ----------
    rows : sequence of HealthRow
    first_ns : int
        Stamp of the first scan, t = 0.
    """
    first = next((k for k, row in enumerate(rows) if row.verdict != "lost"), len(rows))
    if first == len(rows) or not any(row.health.off_map >= AGREEING_BEAMS for row in rows[:first]):
        return ""
    seconds = (rows[first].stamp_ns - first_ns) * 1e-9
    return (
        f"not in the map until t = {seconds:.1f} s: until then no place in it fits for long, as in a room that was "
        "never mapped; poses and states from before say nothing"
    )


def _of_changes(rows: Sequence[HealthRow]) -> list[str]:
    """Where hardly a scan shows what the map shows, it may be another place that looks alike."""
    share = sum(row.verdict == "changed" for row in rows) / max(len(rows), 1)
    if share <= _MUCH_CHANGED:
        return []
    fitting = np.mean([row.health.explained + row.health.explained_by_other_state for row in rows])
    return [
        f"the surroundings differ from the map in {100 * share:.0f} % of the recording, though {100 * fitting:.0f} % "
        "of the beams fit it: something has changed, or the map is a coarse one, or it was made in another place that "
        "looks alike; look at the localization.png of `dynmap localize` before using poses and states"
    ]
