"""Where a map is out of date, and whether it is the right one."""

from dataclasses import replace

import numpy as np
import pytest

from dynmap_cli.domain.poses import Trajectory
from dynmap_cli.localization.found import HealthRow, Localization
from dynmap_cli.localization.summary import summarize
from dynmap_cli.localization.watching.changes import (
    changed_line,
    changed_places,
    is_another_place,
    places_to_update,
)
from dynmap_cli.localization.watching.health import ScanHealth
from dynmap_cli.localization.watching.places import Place


def row(second, verdict="tracking", place=None, changed=0.0, lost=0.0):
    health = ScanHealth(1.0, 0.0, 0.0, 0.0, 0.0, changed, place)
    return HealthRow(second * 10**9, health, -1.0, 500.0, 0.0, verdict, lost, contradiction=lost)


BOX, SAME_BOX, GAP = Place("object", 3.0, 4.0), Place("object", 3.5, 4.2), Place("opening", 8.0, 1.0)
DOOR = Place("sub-map", 3.0, 4.0, 7)


def test_updates_in_one_place_are_counted_together_and_the_worst_is_named():
    rows = [
        row(0),
        *(row(k, "changed", BOX, 0.1) for k in range(1, 6)),
        row(6, "changed", SAME_BOX, 0.3),
        row(7, "changed", GAP, 0.2),
        row(8, "lost", GAP, 0.9),
        row(9),
    ]
    first, second = changed_places(rows)
    assert (first.updates, first.place, first.stamp_ns) == (6, SAME_BOX, 6 * 10**9)
    assert (second.updates, second.place) == (1, GAP)
    assert changed_line(rows, 0) == (
        "70 % of the run in changed surroundings, worst: the object at (3.5, 4.2) m (t = 6.0 s, 30 % of the beams); "
        "a map update is advised for the object at (3.5, 4.2) m"
    )
    assert places_to_update(rows) == [first]


def test_a_sub_map_is_a_place_of_its_own():
    rows = [row(k, "changed", place, 0.1) for k in range(6) for place in (BOX, DOOR)]
    assert [str(one.place) for one in changed_places(rows)] == ["object 3.0 4.0", "sub-map 7"]
    assert "advised for the object at (3.0, 4.0) m, sub-map 7" in changed_line(rows, 0)


def test_nothing_changed_nothing_said():
    assert changed_line([row(0), row(1, "lost", BOX, 0.5)], 0) == ""
    assert changed_line([], 0) == ""


def test_a_recording_of_another_place_contradicts_the_map_in_many_updates():
    rows = [row(k, lost=3.0 * (k in (6, 13))) for k in range(20)]
    assert is_another_place(rows)
    assert not is_another_place(rows[7:])
    assert not is_another_place([])


def test_a_map_that_agrees_with_most_of_a_recording_in_one_piece_is_of_its_place():
    """A robot may start outside of the map; but what the map does not show does not agree with it."""
    agrees = [row(k, lost=3.0 * (k < 8)) for k in range(20)]
    assert not is_another_place(agrees)
    off_map = [replace(one, health=replace(one.health, explained=0.4, off_map=0.6)) for one in agrees]
    assert is_another_place(off_map)


def test_particles_in_two_places_that_look_alike_do_not_contradict_the_map():
    assert not is_another_place([replace(row(k), lost=3.0) for k in range(20)])


def test_no_update_is_advised_for_the_map_of_another_place():
    assert changed_line([row(k, "changed", BOX, 0.1, lost=3.0) for k in range(9)], 0) == ""
    assert places_to_update([row(k, "changed", BOX, 0.1, lost=3.0) for k in range(9)]) == []


@pytest.mark.parametrize(("n_wrong", "is_other"), [(0, False), (2, True)])
def test_scripts_are_told_by_a_word_of_the_summary(n_wrong, is_other):
    rows = [row(k, lost=3.0 * (k in (6, 13)[:n_wrong])) for k in range(20)]
    stamps_ns = np.array([one.stamp_ns for one in rows])
    path = Trajectory(stamps_ns, np.zeros((20, 3)))
    found = Localization(path, poses=[], states=[], health=rows, searches=[], clouds=[], warnings=[])
    summary = summarize(found, [], {})
    assert summary["another_place"] is is_other
    assert (summary["tracking"], summary["changed"], summary["lost"]) == (1.0, 0.0, 0.0)


def test_scripts_are_told_where_the_map_is_out_of_date():
    rows = [row(k, "changed", place, 0.1) for k in range(6) for place in (BOX, DOOR)]
    path = Trajectory(np.zeros(1, dtype=np.int64), np.zeros((1, 3)))
    found = Localization(path, poses=[], states=[], health=rows, searches=[], clouds=[], warnings=[])
    assert summarize(found, [], {})["places_to_update"] == [
        {"kind": "object", "submap": None, "x_m": 3.0, "y_m": 4.0, "updates": 6},
        {"kind": "sub-map", "submap": 7, "x_m": DOOR.x_m, "y_m": DOOR.y_m, "updates": 6},
    ]
