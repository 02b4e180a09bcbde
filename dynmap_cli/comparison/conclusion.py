"""What a comparison comes to, in one line: which areas changed, what else did, and what that does to the pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dynmap_cli.arrays import F64
from dynmap_cli.comparison.courses import Course
from dynmap_cli.domain.patches import Visit
from dynmap_cli.domain.points import point_for_people
from dynmap_cli.localization.beliefs.state_tables import PatchBelief
from dynmap_cli.localization.summary import sure_states
from dynmap_cli.localization.watching.changes import changed_line, is_another_place
from dynmap_cli.localization.watching.doubts import doubts

_MORE_LOST = 0.05
"""A map in which the robot is lost for so much more of the time than in the patch map is worse."""


def conclusion(courses: Sequence[Course], called: Mapping[int, str], first_ns: int) -> str:
    """Say what changed and where, or that nothing did, and what it does to the pose.

    Parameters
    ----------
    courses : sequence of Course
        The first in the patch map.
    called : mapping of int to str
        Number and name of each sub-map, by its number.
    first_ns : int
        Stamp of the first scan, t = 0.
    """
    first = courses[0]
    against = doubts(
        first.health, (), lost_share=float(first.is_lost.mean()), is_elsewhere=is_another_place(first.health)
    )
    if against:
        return f"conclusion: none, in the patch map {against[0]}"
    elsewhere = changed_line(first.health, first_ns) or "nothing else changed"
    return f"conclusion: {_areas(first, called)}; {elsewhere}; {_poses(courses)}"


def _areas(course: Course, called: Mapping[int, str]) -> str:
    """Sub-maps that were in another state than when they were mapped last, or changed while the robot was about."""
    by_submap: dict[int, list[PatchBelief]] = {}
    for row in course.states:
        by_submap.setdefault(row.submap_id, []).append(row)
    if not by_submap:
        return "no sub-map came into view"
    frames = {one.submap_id: one.frame for one in course.compared.patch_sets}
    changed, n_undecided = [], 0
    for number, rows in sorted(by_submap.items()):
        seen = [state for _, state in sure_states(rows)]
        n_undecided += not seen
        before = _mapped_last(course.compared.visits, number)
        if len({*before, *seen}) > 1 and seen:
            was = f"last mapped in state {before[0]}, " if before else ""
            place = point_for_people(*frames[number].center_m)
            name = called.get(number, str(number))
            changed.append(f"{name} at {place} m ({was}seen in {' -> '.join(seen)})")
    doubt = f", {n_undecided} stayed undecided" if n_undecided else ""
    which = f": {', '.join(changed)}" if changed else ""
    return f"{len(changed)} of {len(by_submap)} sub-maps in view changed{which}{doubt}"


def _mapped_last(visits: Sequence[Visit], number: int) -> list[str]:
    """State that the last visit saw which recognised one; none where nothing is known of it."""
    known = [one for one in visits if one.submap_id == number and one.patch is not None]
    return [str(max(known, key=lambda one: one.end_ns).patch)] if known else []


def _poses(courses: Sequence[Course]) -> str:
    """Whether the other maps put the robot elsewhere than the patch map, or lose it."""
    first = courses[0]
    cell_m = first.compared.grid.frame.resolution_m
    has_truth = bool(np.isfinite(first.pose_error_m).any())
    words = []
    for course in courses[1:]:
        if has_truth:
            worse_m = _mean(course.pose_error_m) - _mean(first.pose_error_m)
            what = f"the pose {abs(worse_m):.2f} m {'worse' if worse_m > 0 else 'better'}"
        else:
            worse_m = _mean(course.away_from_m(first))
            what = f"{worse_m:.2f} m from the patch map"
        lost_share = float(course.is_lost.mean())
        differences = [what] if abs(worse_m) > cell_m else []
        if lost_share > float(first.is_lost.mean()) + _MORE_LOST:
            differences.append(f"lost for {100 * lost_share:.0f} %")
        if differences:
            words.append(f"{course.compared.name} ({', '.join(differences)})")
    if words:
        return f"poses differ from those in the patch map in: {', '.join(words)}"
    measured = "errors of the poses agree" if has_truth else "poses agree"
    return f"in all maps {measured} within a cell of {cell_m:g} m on average, so states hardly matter for the pose here"


def _mean(values: F64) -> float:
    """Of those that are numbers; 0 where there is none."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else 0.0
