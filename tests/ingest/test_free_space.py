"""Beams without return that cross walls failed; those that leave through an opening found free space."""

import numpy as np
import pytest

from dynmap_cli.ingest.choices.free_space import Sweeps, _crosses_solid, find_contradiction
from dynmap_cli.ingest.choices.ranges import judge_no_return

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
    assert "failed to measure" in verdict.why


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


def plain_crosses(lengths_m, angles_rad, origins_m, farthest_m):
    """Beam after beam, point after point, over cells of 20 cm."""
    hits, passes, crossed = {}, {}, {}
    shift = origins_m.min(axis=0) - farthest_m - 0.2
    for scan, beam in np.ndindex(lengths_m.shape):
        length_m, angle = lengths_m[scan, beam], angles_rad[scan, beam]
        toward = np.array([np.cos(angle), np.sin(angle)])

        def cell(along_m, origin=origins_m[scan] - shift, toward=toward):
            return tuple(np.floor((origin + along_m * toward) / 0.2).astype(int).tolist())

        before_end = [cell(step) for step in np.arange(0.2, farthest_m, 0.2) if step < length_m - 0.5]
        crossed[scan, beam] = before_end
        if length_m < farthest_m:
            hits[cell(length_m)] = hits.get(cell(length_m), 0) + 1
        if np.isfinite(length_m):
            for one in before_end:
                passes[one] = passes.get(one, 0) + 1
    solid = {one for one, count in hits.items() if count >= max(3, 0.5 * (count + passes.get(one, 0)))}
    result = np.zeros(lengths_m.shape, dtype=bool)
    for place, cells in crossed.items():
        result[place] = any(one in solid for one in cells)
    return result


def test_beams_cross_what_they_cross_point_by_point():
    ranges, poses = drive_through_a_room(open_side=True, n_scans=30)
    ranges[np.random.default_rng(1).random(ranges.shape) < 0.1] = np.inf
    ranges[~(ranges > 0.0)] = np.inf
    args = ranges, poses[:, 2, None] + BEARINGS, poses[:, :2], REACH_M
    found = _crosses_solid(*args)
    assert found.any()
    np.testing.assert_array_equal(found, plain_crosses(*args))
