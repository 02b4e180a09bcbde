"""Beliefs of objects against a door of two states."""

import numpy as np
import pytest

from dynmap_cli.evaluation.object_beliefs import BelievedObject, object_measures, parse_beliefs
from tests.evaluation.test_states import door

SHARES = {(0, 3): {("door", "open"): 0.1, ("door", "closed"): 0.9}}


def test_truth_against_itself_is_perfect_and_its_opposite_never_right():
    _, truth = door()
    stamps, closed = truth.trajectory.stamps_ns, truth.object_states[:, 0].astype(np.float64)
    for belief, right in ((closed, 1.0), (1.0 - closed, 0.0)):
        values = object_measures({(0, 3): BelievedObject(stamps, belief)}, SHARES, truth, 0.8)
        assert values == {
            "object_accuracy": right,
            "object_sure_share": 1.0,
            "object_accuracy_when_sure": right,
        }


def test_what_is_partly_covered_or_unknown_to_the_map_does_not_count():
    _, truth = door()
    believed = {key: BelievedObject(truth.trajectory.stamps_ns, np.ones(80)) for key in ((0, 3), (0, 4))}
    shares = {(0, 3): {("door", "open"): 0.5, ("door", "closed"): 0.9}}
    assert object_measures(believed, shares, truth, 0.8)["object_accuracy"] == 1.0
    assert np.isnan(object_measures(believed, {}, truth, 0.8)["object_accuracy"])


def test_rows_are_read_by_object():
    rows = [
        {"stamp_s": f"{stamp}.0", "submap": "2", "object": str(thing), "probability_on": "0.25"}
        for stamp in (1, 2)
        for thing in (0, 1)
    ]
    found = parse_beliefs(rows)
    assert set(found) == {(2, 0), (2, 1)}
    assert found[2, 1].stamps_ns.tolist() == [10**9, 2 * 10**9]
    assert found[2, 1].probability_on == pytest.approx([0.25, 0.25])
