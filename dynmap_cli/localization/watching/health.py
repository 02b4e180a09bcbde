"""Tells a lost robot from a map that is out of date.

Neither the likelihood nor the share of explained beams tells the two apart: a place with eight new boxes
looks worse than a wrong pose. But people and new objects *shorten* beams; only a wrong pose, or a wall
that was torn down, lets beams pass *through* walls. What lies where the map knows nothing speaks neither
for nor against a pose, so shares are taken of the beams that the map can judge: a robot that drives into a
room that was never mapped is not lost. What remains in doubt is settled by a search for a better pose in
the whole map: a robot that is lost fits better somewhere else. The lost measure adds up what scans,
particles and search say, each in units of what makes a robot lost on its own:

    measure = mean of six scans + LOST (1 - share of the best place) / (1 - 0.8)
              + 5 (mean share that ends where the map knows nothing, until the place is confirmed, see `Placement`)
              + LOST (where a search found a better place)

The last term stands in the update in which a search moved the robot. A start that was given is searched
for in its first update, as whoever gave it may be wrong.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import B1, F64
from dynmap_cli.kernels.novelties import clip_edges
from dynmap_cli.kernels.sweeps import are_marked, explain_by_states, sort_beams, walls_crossed
from dynmap_cli.localization.beliefs.states import BEYOND_M, LEAST_SINE, PlacedSweep
from dynmap_cli.localization.particles.particle_filter import ONE_MODE_SHARE, Estimate
from dynmap_cli.localization.sensing.map_pool import MapPool
from dynmap_cli.localization.watching.placement import SCANS, Placement
from dynmap_cli.localization.watching.places import OPENING_CELLS, NovelPlaces, Place, main_place

OVERSHOOT_M = 0.5
APART_M = 0.6
"""Beams next to each other that cross walls further apart than this go through in two places."""
CLIPPED_M = 0.2
"""Beams that go through a wall in a narrower place clip its edge: a thing behind it is seen past the wall."""
UNEXPLAINED_WEIGHT, THROUGH_WEIGHT, OPENED_WEIGHT = 5.0, 25.0, 5.0
"""Of the share of the judged beams that end on nothing in the open, that go through a wall and end where the map
knows that nothing is, and that go through a wall and end where it knows nothing, as through a door that was shut."""
LEAST_JUDGED = 0.25
"""A scan of which the map can judge a smaller share of the beams says nothing of the pose."""
DOUBT, LOST = 1.2, 2.5
"""Of the mean of the lost measure: from where on the map is searched for a better pose, and from where on
the robot is lost even if there is none."""
_BEHIND_M = np.array([OVERSHOOT_M, BEYOND_M])
_EDGE_M = np.array([OVERSHOOT_M, APART_M, CLIPPED_M])
CHANGED_SHARE = 0.05
SEARCH_AFTER = 3
"""Updates in a row in doubt before the whole map is searched; doubled after each search."""
SETTLED_AFTER = 60
"""Updates in a row without doubt after which patience is short again."""


@dataclass(frozen=True, slots=True)
class ScanHealth:
    """How one scan fits the maps from the best pose; shares of the beams with a return.

    Attributes
    ----------
    explained : float
        End near something in the map, in the likeliest states.
    explained_by_other_state : float
        End near something in another state of a sub-map.
    unexplained : float
        The rest.
    through : float
        Unexplained, went through static walls and end where the map is free.
    opened : float
        Unexplained, went through static walls and end where the map knows nothing.
    changed : float
        Show what the map has not, a thing or an opening, and something has been seen there for 5 s.
    where : Place or None
        Where most of these are.
    off_map : float
        Unexplained, but in the open where the map knows nothing: no sign of a wrong pose.
    """

    explained: float
    explained_by_other_state: float
    unexplained: float
    through: float
    opened: float
    changed: float
    where: Place | None = None
    off_map: float = 0.0

    @property
    def judged(self) -> float:
        """Share of the beams of which the map can say whether they fit."""
        return 1.0 - self.off_map - self.opened


class Novelties:
    """What was seen that the map has not: things, and openings in walls."""

    def __init__(self, pool: MapPool) -> None:
        self.things = NovelPlaces(pool.frame)
        self.openings = NovelPlaces(pool.frame, OPENING_CELLS, is_fixed=True)


def scan_health(
    placed: PlacedSweep, pool: MapPool, likeliest: Mapping[int, int], novelties: Novelties, now_s: float
) -> ScanHealth:
    """Sort the beams of a scan by what explains them.

    Parameters
    ----------
    placed : PlacedSweep
    pool : MapPool
    likeliest : mapping of int to int
        Index of the likeliest state of each sub-map, by the index of the sub-map.
    novelties : Novelties
        Takes note of what the map does not explain.
    now_s : float
    """
    now, other = _explained(placed.ends_m, pool, likeliest)
    crossings, behind_m = _walls_crossed(placed, pool)
    counts, (is_thing, is_opening) = np.empty(7, dtype=np.int64), np.empty((2, now.size), dtype=np.bool_)
    in_free = _in_free(placed.ends_m, pool)
    on_map = np.logical_or(*_explained(placed.ends_m, pool, likeliest, closely=True))
    clips = np.empty_like(now)
    clip_edges(behind_m, crossings, _EDGE_M, clips)
    sort_beams(
        placed.hits, now, other, behind_m, in_free, on_map, clips, _BEHIND_M, counts, is_thing, is_opening
    )
    n_hits, explained, by_other, unexplained, into_free, opened, off_map = counts.tolist()
    n_hits = max(n_hits, 1)
    is_opening[is_opening] = novelties.openings.see(crossings[is_opening], now_s)
    is_thing[is_thing] = novelties.things.see(placed.ends_m[is_thing], now_s)
    is_thing &= ~is_opening
    return ScanHealth(
        explained=explained / n_hits,
        explained_by_other_state=by_other / n_hits,
        unexplained=unexplained / n_hits,
        through=into_free / n_hits,
        opened=opened / n_hits,
        changed=int((is_thing | is_opening).sum()) / n_hits,
        where=main_place(
            placed.ends_m[is_thing], crossings[is_opening], [pool.submaps[number] for number in likeliest]
        ),
        off_map=off_map / n_hits,
    )


class Verdict:
    """Judges the last six scans, the particles and the last search together: tracking, changed or lost."""

    def __init__(self, *, is_given: bool = False) -> None:
        self._measures: deque[float] = deque(maxlen=SCANS)
        self._elsewhere = 0.0
        self.placement = Placement(is_given=is_given)

    @property
    def is_in_doubt(self) -> bool:
        """Whether the robot may be lost."""
        return self.contradiction > DOUBT or self.is_off_map

    @property
    def is_off_map(self) -> bool:
        """Whether the robot is where the map shows nothing, and nothing it showed before says that it came there."""
        uncharted = self._uncharted
        return uncharted > 0.0 and self.contradiction + uncharted > LOST

    @property
    def _uncharted(self) -> float:
        """How much speaks for a wrong pose as the map knows too little, where it has not confirmed the place."""
        return UNEXPLAINED_WEIGHT * self.placement.uncharted

    @property
    def measure(self) -> float:
        """How much speaks for a wrong pose; the robot is lost above `LOST`.

        The mean of the measures of the scans, and as much as makes the robot lost for each `1 - ONE_MODE_SHARE` of
        the particles' weight that lies elsewhere, and for a better place that a search found.
        """
        return self.contradiction + self._uncharted + LOST * self._elsewhere

    def judge(self, health: ScanHealth, estimate: Estimate) -> str:
        """Take one more scan into account."""
        if health.judged >= LEAST_JUDGED:
            self._measures.append(lost_measure(health))
        self.placement.see(health.explained + health.explained_by_other_state, health.off_map)
        self.placement.judge(is_in_doubt=self.contradiction > DOUBT)
        self._elsewhere = (1.0 - estimate.share) / (1.0 - ONE_MODE_SHARE)
        if self.measure > LOST:
            return "lost"
        return "changed" if health.changed > CHANGED_SHARE else "tracking"

    def found_elsewhere(self) -> None:
        """Take into account that a search found a better place."""
        self._elsewhere += 1.0

    @property
    def contradiction(self) -> float:
        """Mean of the lost measures of the last scans: how much the map contradicts them at the best pose."""
        return sum(self._measures) / max(len(self._measures), 1)


def lost_measure(health: ScanHealth) -> float:
    """How much one scan speaks for a wrong pose."""
    in_the_open = health.unexplained - health.off_map - health.through - health.opened
    weighed = (
        UNEXPLAINED_WEIGHT * in_the_open + THROUGH_WEIGHT * health.through + OPENED_WEIGHT * health.opened
    )
    return weighed / max(health.judged, LEAST_JUDGED)


class Patience:
    """Counts updates in doubt until the whole map has to be searched.

    Parameters
    ----------
    is_given : bool
        Whether somebody else said where the robot starts: then it is searched for after the first update in any case.
    """

    def __init__(self, *, is_given: bool = False) -> None:
        self._doubts, self._settled, self._patience, self._is_given = 0, 0, SEARCH_AFTER, is_given

    def is_over(self, *, is_in_doubt: bool, is_off_map: bool = False) -> bool:
        """Take one more update into account.

        A robot that is not in the map yet comes into it sooner or later: once it has gone as far as the scans of a
        search reach, all it sees is new, and it is searched for again.
        """
        if self._is_given:
            self._is_given = False
            return True
        if not is_in_doubt:
            self._doubts, self._settled = 0, self._settled + 1
            if self._settled >= SETTLED_AFTER:
                self._patience = SEARCH_AFTER
            return False
        self._doubts, self._settled = self._doubts + 1, 0
        if is_off_map:
            self._patience = min(self._patience, SETTLED_AFTER)
        if self._doubts < self._patience:
            return False
        self._doubts, self._patience = 0, 2 * self._patience
        return True


def count_places_through(placed: PlacedSweep, pool: MapPool) -> int:
    """In how many places beams go through walls of the static map and end near nothing in any state."""
    crossings, behind_m = _walls_crossed(placed, pool)
    through = (behind_m > OVERSHOOT_M) & placed.hits
    now, other = _explained(placed.ends_m[through], pool, dict.fromkeys(range(len(pool.submaps)), 0))
    return _count_places(crossings[through][~(now | other)])


def ends_off_map(placed: PlacedSweep, pool: MapPool) -> B1:
    """Which beams end near nothing in any state, through no wall, where the map knows nothing."""
    _, behind_m = _walls_crossed(placed, pool)
    through = behind_m > OVERSHOOT_M
    now, other = _explained(placed.ends_m, pool, dict.fromkeys(range(len(pool.submaps)), 0))
    return placed.hits & ~(now | other | through | _in_free(placed.ends_m, pool))


def _in_free(points_m: F64, pool: MapPool) -> B1:
    """Which points (n, 2) lie where the map is free."""
    free = np.empty(len(points_m), dtype=np.bool_)
    are_marked(points_m, pool.frame.corner, pool.free, free)
    return free


def _count_places(crossings_m: F64) -> int:
    """In how many places neighbouring beams cross walls; points (n, 2) in the order of the beams."""
    if not len(crossings_m):
        return 0
    steps = np.diff(crossings_m, axis=0)
    return 1 + int((np.hypot(steps[:, 0], steps[:, 1]) > APART_M).sum())


def _explained(
    ends_m: F64, pool: MapPool, likeliest: Mapping[int, int], *, closely: bool = False
) -> tuple[B1, B1]:
    """Which ends lie near something in the likeliest states, or *closely* on it, and which only in other states."""
    now, other = np.empty(len(ends_m), dtype=np.bool_), np.zeros(len(ends_m), dtype=np.bool_)
    are_marked(ends_m, pool.frame.corner, pool.on_map if closely else pool.explained, now)
    for number, state in likeliest.items():
        submap = pool.submaps[number]
        near = submap.on_map if closely else submap.explained
        explain_by_states(ends_m, submap.frame.corner, submap.owned, near, state, now, other)
    return now, other


def _walls_crossed(placed: PlacedSweep, pool: MapPool) -> tuple[F64, F64]:
    """Where each beam crosses the first static surface on its way (n, 2), and how far behind it ends (n,).

    A beam that crosses none ends -inf behind it, and its point is the sensor.
    """
    crossings = np.empty((placed.lengths_m.size, 2))
    behind_m = np.empty(placed.lengths_m.size)
    walls_crossed(
        pool.surfaces,
        pool.frame.corner,
        placed.sensor_m,
        placed.directions_rad,
        placed.lengths_m,
        LEAST_SINE,
        crossings,
        behind_m,
    )
    return crossings, behind_m
