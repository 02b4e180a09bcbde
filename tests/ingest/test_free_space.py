"""Beams without return that cross walls failed; those that leave through an opening found free space."""

import numpy as np
import pytest

from dynmap_cli.ingest.free_space import Sweeps, find_contradiction
from dynmap_cli.ingest.ranges import judge_no_return

REACH_M = 8.0
BEARINGS = np.linspace(-np.pi, np.pi, 120, endpoint=False)


def drive_through_a_room(half_m=4.0, n_scans=80, *, open_side=False):
    """Exact ranges in a square room; with an open side the beams that leave there return nothing."""
    poses = np.column_stack([np.linspace(-2, 2, n_scans), 0.3 * np.ones(n_scans), np.linspace(0, 2, n_scans)])
    angle = poses[:, 2, None] + BEARINGS
    with np.errstate(divide="ignore"):
        to_x = (np.where(np.cos(angle) > 0, half_m, -half_m) - poses[:, 0, None]) / np.cos(angle)
        to_y = (np.where(np.sin(angle) > 0, half_m, -half_m) - poses[:, 1, None]) / np.sin(angle)
    ranges = np.minimum(to_x, to_y)
    if open_side:
        ranges[(to_x < to_y) & (np.cos(angle) > 0)] = np.inf
    ranges[ranges >= REACH_M] = np.inf
    return ranges.astype(np.float32), poses


def sweeps_of(ranges, poses):
    return Sweeps(ranges, BEARINGS[None], np.zeros(len(poses), dtype=np.int32), poses)


def found_in(ranges, poses):
    return find_contradiction(sweeps_of(ranges, poses), 0.0, REACH_M)


def test_failed_beams_cross_walls():
    ranges, poses = drive_through_a_room()
    ranges[np.random.default_rng(0).random(ranges.shape) < 0.1] = np.inf
    found = found_in(ranges, poses)
    assert found.of_no_returns > 0.9
    assert found.of_returns < 0.05
    verdict = judge_no_return(sweeps_of(ranges, poses), 0.1, REACH_M, "auto")
    assert verdict.policy == "ignore"
    assert "failed rather than found free space" in verdict.why


def test_beams_through_an_opening_cross_nothing():
    ranges, poses = drive_through_a_room(open_side=True)
    assert np.isinf(ranges).mean() > 0.1
    found = found_in(ranges, poses)
    assert found.of_no_returns < 0.05
    assert judge_no_return(sweeps_of(ranges, poses), 0.1, REACH_M, "auto").policy == "free"


@pytest.mark.parametrize("wish", ["free", "ignore"])
def test_a_wish_overrules_the_evidence(wish):
    ranges, poses = drive_through_a_room()
    ranges[:, ::7] = np.inf
    assert judge_no_return(sweeps_of(ranges, poses), 0.1, REACH_M, wish).policy == wish


def test_without_poses_or_no_returns_nothing_is_found():
    ranges, poses = drive_through_a_room(open_side=True)
    assert found_in(ranges, np.full_like(poses, np.nan)) is None
    assert found_in(*drive_through_a_room()) is None


def test_scans_without_pose_are_passed_over():
    ranges, poses = drive_through_a_room(open_side=True)
    poses[::3] = np.nan
    assert found_in(ranges, poses).of_no_returns < 0.05


def test_a_turned_and_shifted_world_gives_the_same_shares():
    ranges, poses = drive_through_a_room()
    ranges[:, ::9] = np.inf
    turn = 0.7
    moved = np.column_stack(
        [
            100 + np.cos(turn) * poses[:, 0] - np.sin(turn) * poses[:, 1],
            -50 + np.sin(turn) * poses[:, 0] + np.cos(turn) * poses[:, 1],
            poses[:, 2] + turn,
        ]
    )
    here, there = found_in(ranges, poses), found_in(ranges, moved)
    assert here.of_no_returns == pytest.approx(there.of_no_returns, abs=0.1)
    assert here.of_returns == pytest.approx(there.of_returns, abs=0.05)
