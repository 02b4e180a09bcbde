"""The sample recordings through the whole chain: what is found is what was there."""

import numpy as np
import pytest

from dynmap_cli.domain.poses import compose, inverse
from dynmap_cli.evaluation.trajectories import absolute_errors_m
from tests.golden.corridor import STATES, away_m, compare_with_plain_maps

NEAR_M, TRAVEL_M, SURE = 2.0, 2.0, 0.95


def test_the_path_is_within_5_cm(corridor):
    errors = absolute_errors_m(corridor.mapped, corridor.monday.true_poses)
    assert np.sqrt(np.mean(errors**2)) < 0.05


def test_both_doors_become_sub_maps_and_nothing_else_does(corridor):
    found = {corridor.submap_of(door).submap_id for door in corridor.doors()}
    assert len(found) == len(corridor.patch_sets) == 2


@pytest.mark.parametrize("door", ["office", "kitchen"])
def test_each_door_has_the_two_states_that_occurred(corridor, door):
    assert sorted(corridor.meanings(door).values()) == list(STATES)
    assert [patch.support for patch in corridor.submap_of(door).patches] == [3, 3]


@pytest.mark.parametrize("number, door", [(0, "office"), (1, "kitchen")])
def test_the_state_is_known_within_2_m_of_travel(corridor, number, door):
    truth, beliefs = corridor.tuesday, corridor.beliefs(door)
    states = truth.object_states[:, number]
    travelled = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(truth.true_poses[:, :2], axis=0), axis=1)))
    is_near = near(corridor, door)
    checked = 0
    for start, end in stretches(is_near, states):
        if travelled[end - 1] - travelled[start] < TRAVEL_M:
            continue
        within = [k for k in range(start, end) if travelled[k] - travelled[start] <= TRAVEL_M]
        known = [beliefs[k][STATES[states[k]]] for k in within if k in beliefs]
        assert known, f"{door}: never in view, scans {start} to {end}"
        assert known[-1] > SURE, f"{door}: scans {start} to {end}"
        checked += 1
    assert checked >= 3


def test_a_door_that_closes_while_the_robot_looks_on_is_noticed(corridor):
    truth, beliefs = corridor.tuesday, corridor.beliefs("kitchen")
    states = truth.object_states[:, 1]
    changes = np.flatnonzero(np.diff(states)) + 1
    watched = [change for change in changes.tolist() if near(corridor, "kitchen")[change]]
    assert len(watched) == 1
    seconds = (truth.log.stamps_ns - truth.log.stamps_ns[watched[0]]) * 1e-9
    after = [k for k in beliefs if 0.0 <= seconds[k] <= 10.0]
    assert beliefs[after[-1]]["closed"] > SURE
    assert beliefs[max(k for k in beliefs if seconds[k] < 0.0)]["open"] > SURE


def test_plain_maps_are_shown_beside_the_patch_map(corridor, sample_logs, tmp_path, record_property):
    table = compare_with_plain_maps(corridor, sample_logs / "corridor_tuesday.mcap", tmp_path)
    assert len(table) == 3
    for name, errors in table.items():
        record_property(name, errors)
        print(f"{name:24}", *(f"{key} {value:.4f}" for key, value in errors.items()))
    assert table["patch map"]["rmse_m"] < 0.1


def near(corridor, door):
    """Whether the robot is near the area of a door, for each scan of Tuesday."""
    poses = compose(inverse(corridor.truth_from_map), corridor.tuesday.true_poses)
    return away_m(corridor.submap_of(door).frame, poses[:, :2]) <= NEAR_M


def stretches(is_near, states):
    """(first, end) of the times at which the robot is near and the state stays the same."""
    found, start = [], None
    for k in range(len(states)):
        if start is not None and (not is_near[k] or states[k] != states[start]):
            found.append((start, k))
            start = None
        if start is None and is_near[k]:
            start = k
    return found if start is None else [*found, (start, len(states))]
