"""The one line that a comparison comes to."""

from dataclasses import replace

import numpy as np
import pytest

from dynmap_cli.comparison.conclusion import conclusion
from dynmap_cli.comparison.courses import Course
from dynmap_cli.comparison.maps import ComparedMap
from dynmap_cli.domain.grid import FREE, GridFrame, OccupancyGrid
from dynmap_cli.domain.patches import Patch, PatchSet, Visit
from dynmap_cli.localization.beliefs.state_tables import PatchBelief
from dynmap_cli.localization.found import HealthRow
from dynmap_cli.localization.watching.health import ScanHealth
from dynmap_cli.localization.watching.places import Place

FRAME = GridFrame(0.05, -1.0, -2.0, 100, 120)
N = 20
SECONDS = np.arange(N, dtype=np.int64) * 10**9


def door():
    """Sub-map 7 with two states."""
    patches = tuple(Patch(k, 3, np.full((10, 20), value, np.float32)) for k, value in enumerate((0.0, 0.9)))
    return PatchSet(7, FRAME.window(70, 40, 10, 20), np.ones((10, 20), dtype=bool), patches, 0.9)


def visit(patch, start_ns):
    return Visit(7, start_ns, "a.mcap", start_ns, start_ns + 1, patch, 1.0 if patch is not None else np.nan)


def beliefs(*states):
    """Belief in state 0 and 1 of the door at each second; None = undecided."""
    table = {0: (0.9, 0.1), 1: (0.1, 0.9), None: (0.5, 0.5)}
    return [PatchBelief(int(SECONDS[k]), 7, (0, 1), np.array(table[s])) for k, s in enumerate(states)]


def course(name="patch map", states=(), shift_m=0.0, n_lost=0, error_m=np.nan, changed=0):
    """A robot that stands; the map was left with the door in state 0."""
    grid = OccupancyGrid(FRAME, np.full(FRAME.shape, FREE, dtype=np.int8))
    visits = (visit(0, 5), visit(1, 2), visit(None, 9))
    poses = np.tile([shift_m, 0.0, 0.0], (N, 1))
    place = Place("object", 1.0, 2.0)
    fine = ScanHealth(1.0, 0.0, 0.0, through=0.0, opened=0.0, changed=0.0)
    rows = []
    for k in range(N):
        verdict = "lost" if k < n_lost else "changed" if k < changed else "tracking"
        health = replace(fine, changed=0.3, where=place) if verdict == "changed" else fine
        rows.append(HealthRow(int(SECONDS[k]), health, -1.0, 500.0, 0.0, verdict, 0.0, 0.0))
    full = np.full(N, 0.05)
    is_lost = np.arange(N) < n_lost
    error = np.full(N, error_m)
    compared = ComparedMap(name, "", grid, (door(),), visits)
    return Course(compared, SECONDS, poses, full, error, error, full, is_lost, beliefs(*states), rows)


def line(*courses):
    return conclusion(courses, {7: "7 (lab)"}, 0)


@pytest.mark.parametrize(
    ("states", "words"),
    [
        ((), "conclusion: no sub-map came into view; nothing else changed; "),
        ((0, 0, None), "conclusion: 0 of 1 sub-maps in view changed; nothing"),
        ((None, None), "conclusion: 0 of 1 sub-maps in view changed, 1 stayed undecided; nothing"),
        (
            (1, 1, None, 0),
            "conclusion: 1 of 1 sub-maps in view changed: 7 (lab) at (1.5, 1.8) m "
            "(last mapped in state 0, seen in 1 -> 0); nothing",
        ),
    ],
)
def test_what_changed_is_said_and_where(states, words):
    assert line(course(states=states), course("all beams")).startswith(words)


def test_what_changed_outside_of_submaps_is_said():
    words = line(course(changed=6), course("all beams"))
    assert "a map update is advised for the object at (1.0, 2.0) m" in words


@pytest.mark.parametrize(
    ("others", "end"),
    [
        ((course("state 1", shift_m=0.01),), "in all maps poses agree within a cell of 0.05 m on average, "),
        ((course("state 1", shift_m=0.2),), "in: state 1 (0.20 m from the patch map)"),
        ((course("state 1", n_lost=4), course("all beams")), "in: state 1 (lost for 20 %)"),
    ],
)
def test_maps_that_put_the_robot_elsewhere_are_named(others, end):
    assert end in line(course(), *others)


def test_with_truth_errors_are_compared():
    words = line(course(error_m=0.1), course("all beams", error_m=0.12), course("state 1", error_m=0.02))
    assert words.endswith("in: state 1 (the pose 0.08 m better)")
    assert "errors of the poses agree" in line(course(error_m=0.1), course("state 1", error_m=0.1))


def test_nothing_is_concluded_where_the_robot_is_lost():
    assert line(course(n_lost=10), course("all beams")).startswith(
        "conclusion: none, in the patch map lost for 50 %"
    )
    assert line(course(changed=10), course("all beams")).startswith(
        "conclusion: none, in the patch map the surr"
    )
