"""Whether the map has ever spoken for the place where the robot is believed to be.

What lies where the map knows nothing speaks neither for nor against a pose. That holds for a robot that the map showed
before it drove out. One that starts in a room never mapped is put where its first scans happen to fit, and soon drives
out of the map there, where nothing contradicts it any more. So a place has to be confirmed: it was chosen because the
scans of the next metres fit, and only what fits beyond them says more. Until then every end where the map knows nothing
counts as one that ends on nothing in the open.
"""

from __future__ import annotations

from collections import deque

SCANS = 6
AGREEING_BEAMS = 0.5
"""Share of the beams that end on the map in a scan that agrees with it."""
CONFIRMED_AFTER = 60
"""Agreeing updates without a doubt between: `update_min_d` apart they reach beyond the scans of a global start."""


class Placement:
    """One place, from the start or the search that put the robot there.

    Parameters
    ----------
    is_given : bool
        Whether somebody said that the robot is here: then it is as if it were confirmed.
    """

    def __init__(self, *, is_given: bool = False) -> None:
        self._agreeing = CONFIRMED_AFTER if is_given else 0
        self._is_confirmed = is_given
        self._off_map: deque[float] = deque(maxlen=SCANS)

    @property
    def is_confirmed(self) -> bool:
        """Whether scans beyond those that the place was chosen by agreed with the map."""
        return self._is_confirmed

    @property
    def speaks_for_it(self) -> bool:
        """Whether any scan agreed with the map since the last doubt."""
        return self._agreeing > 0

    @property
    def uncharted(self) -> float:
        """Mean share of the beams of the last scans that end where the map knows nothing; 0 once confirmed."""
        if self._is_confirmed or not self._off_map:
            return 0.0
        return sum(self._off_map) / len(self._off_map)

    def see(self, on_map: float, off_map: float) -> None:
        """Take into account which shares of the beams of one more scan end on the map, and where it knows nothing."""
        self._off_map.append(off_map)
        self._agreeing += on_map >= AGREEING_BEAMS

    def judge(self, *, is_in_doubt: bool) -> None:
        """Begin anew where the scans contradict the map; a place that is confirmed stays so."""
        if is_in_doubt:
            self._agreeing = 0
        self._is_confirmed |= self._agreeing >= CONFIRMED_AFTER
