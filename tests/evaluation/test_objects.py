"""States of objects against a box that comes and goes."""

from pathlib import Path

import numpy as np
import pytest

from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.patches import ChangingObject, Patch, PatchSet, Visit
from dynmap_cli.domain.poses import Trajectory
from dynmap_cli.domain.scans import single_laser_log
from dynmap_cli.evaluation.objects import score_objects
from dynmap_cli.evaluation.truth import Run, TrueObject, Truth

FRAME = GridFrame(0.05, 0.5, -0.5, 20, 20)
VISITS = tuple(Visit(7, k, "log", 10 * k * 10**9, (10 * k + 9) * 10**9, 0, 1.0) for k in range(4))


def world():
    """A box 1 m ahead that is there in every other ten seconds, before a wall."""
    count, stamps = 40, np.arange(40, dtype=np.int64) * 10**9
    bearings = np.linspace(-0.2, 0.2, 41)
    there = np.arange(count) // 10 % 2 == 0
    ranges = np.where(there, 1.02, 4.0)[:, None] / np.cos(bearings)
    classes = np.broadcast_to(np.where(there, 10, 0)[:, None], ranges.shape).astype(np.int32)
    states = np.where(there, 0, 1).astype(np.int32)[:, None]
    thing = TrueObject("box", 10, ("here", "absent"))
    log = single_laser_log(stamps, ranges.astype(np.float32), bearings, np.zeros((count, 3)))
    truth = Truth(Trajectory(stamps, np.zeros((count, 3))), classes, states, (thing,), 0, 1, 2, 3, 10)
    shape = ranges.shape
    run = Run(Path("run"), log, np.zeros((count, 3)), np.ones(shape, np.float32), np.zeros(shape, bool), {})
    return run, truth


def patch_set(states, behind=()):
    """The front of the box as an object, and others behind it that no beam may hit."""
    front, hidden = np.zeros(FRAME.shape, dtype=bool), np.zeros(FRAME.shape, dtype=bool)
    front[6:14, 10] = True
    hidden[0:2, 0:8] = True
    objects = [ChangingObject(0, front, dict(enumerate(states)))]
    objects += [ChangingObject(1, hidden, dict(enumerate(behind)))] if behind else []
    patch = Patch(0, 4, np.zeros(FRAME.shape, np.float32))
    return PatchSet(7, FRAME, front, (patch,), 0.5, objects=tuple(objects))


@pytest.mark.parametrize(
    ("states", "right", "unknown"),
    [
        (["on", "off", "on", "off"], 1.0, 0.0),
        (["on", "off", "off", "off"], 0.75, 0.0),
        (["on", "off", "unknown", "unknown"], 1.0, 0.5),
    ],
)
def test_shares_of_right_and_unknown_states(states, right, unknown):
    run, truth = world()
    values = score_objects("box", run, [patch_set(states)], VISITS, truth).values
    assert values["object_states"] == 4.0
    assert values["object_states_right_share"] == right
    assert values["object_states_unknown_share"] == unknown
    assert values["object_states_in_view_unknown_share"] == unknown


def test_what_no_beam_reached_is_not_in_view():
    run, truth = world()
    found = patch_set(["on", "off", "on", "off"], behind=["unknown"] * 4)
    values = score_objects("box", run, [found], VISITS, truth).values
    assert values["object_states_unknown_share"] == 0.5
    assert values["object_states_in_view_unknown_share"] == 0.0


def test_a_change_during_a_visit_does_not_count():
    run, truth = world()
    whole = Visit(7, 0, "log", 0, 19 * 10**9, 0, 1.0)
    values = score_objects("box", run, [patch_set(["on"])], [whole], truth).values
    assert values["object_states"] == 0.0
