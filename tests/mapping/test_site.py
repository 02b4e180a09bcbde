"""Several drives in one map: found on one another without a guess, joined, and refused where they do not belong."""

from dataclasses import replace

import numpy as np
import pytest

from dynmap_cli.domain.poses import between, compose, inverse, wrap_angle
from dynmap_cli.domain.scans import join_drives
from dynmap_cli.errors import LogError
from dynmap_cli.mapping.pose_graph import PLACED
from dynmap_cli.mapping.settings import MapSettings
from dynmap_cli.mapping.site import Site
from dynmap_cli.simulation import parse_scenario, simulate

WALLS = [
    {"points": [[0, 0], [14, 0], [14, 9], [0, 9]], "closed": True},
    [[0, 4], [3, 4]],
    [[4, 4], [9, 4]],
    [[10, 4], [14, 4]],
    [[11, 1.2], [11, 2.2]],
    [[6, 5.5], [6, 9]],
]
FIRST = [[1.5, 2], [8, 1.5], [9.5, 2.5], [9.5, 6], [12.5, 7], [9.5, 6], [9.5, 3], [3.5, 3], [3.5, 6], [2, 7]]
SECOND = [[12.5, 7], [9.6, 6], [9.4, 3], [12.5, 2.5], [8, 1.5], [3.6, 3], [3.4, 6.5]]
ELSEWHERE = [
    {"points": [[0, 0], [7, 0], [9, 4], [9, 11], [0, 11]], "closed": True},
    [[2, 3], [4, 5]],
    [[5, 8], [9, 8]],
    [[2, 7], [2, 9]],
]
AWAY = [[1.5, 1.5], [6, 1], [7, 5], [3, 6.5], [1, 9.5], [4, 9.5], [4, 7], [1, 5], [1.5, 2]]


def driven(walls, path, start_s, seed):
    """A drive and its true poses; odometry starts at the origin."""
    run = simulate(
        parse_scenario(
            {
                "seed": seed,
                "world": {"walls": walls},
                "robot": {"path": path, "speed_mps": 0.6},
                "lasers": [{"noise_m": 0.015, "rate_hz": 5, "max_range_m": 12}],
                "odometry": {"rotation_scale": 0.98, "bias_degpm": 0.4},
            }
        )
    )
    log = replace(
        run.log,
        stamps_ns=run.log.stamps_ns + int(start_s * 1e9),
        odometry=between(run.log.odometry[0], run.log.odometry),
        recordings=(f"drive {seed}",),
    )
    return log, run.true_poses


@pytest.fixture(scope="module")
def first():
    return driven(WALLS, FIRST, 0.0, 1)


@pytest.fixture(scope="module")
def second():
    return driven(WALLS, SECOND, 86_400.0, 2)


def test_two_drives_from_different_starts_are_one_map(first, second):
    log = join_drives([first[0], second[0]])
    site = Site(log, MapSettings(max_rounds=1))
    poses = site.poses(None, "")
    true = np.concatenate([first[1], second[1]])
    error = between(poses, compose(inverse(true[0]), true))
    assert np.hypot(error[:, 0], error[:, 1]).max() < 0.05
    assert np.abs(wrap_angle(error[:, 2])).max() < 0.01
    assert [drive.log.n_scans for drive in site.drives] == [first[0].n_scans, second[0].n_scans]
    graph = site.graph
    placed = graph.edges.kind == PLACED
    assert placed.sum() == 1
    drives = log.drive_index[graph.keys]
    assert (drives[graph.edges.first[placed]], drives[graph.edges.second[placed]]) == (0, 1)
    across = [
        loop for loop in graph.loops if drives[graph.anchors[loop.fixed]] != drives[graph.anchors[loop.moved]]
    ]
    assert len(across) >= 3
    chain = graph.edges.kind == 0
    assert (drives[graph.edges.first[chain]] == drives[graph.edges.second[chain]]).all()


def test_beams_that_are_filtered_leave_the_drives_where_they_are(first, second):
    log = join_drives([first[0], second[0]])
    site = Site(log, MapSettings())
    before = site.poses(None, "")
    weights = np.where(np.isfinite(log.ranges_m), np.float32(1.0), np.float32(np.nan))
    weights[::3, ::7] = 0.01
    after = site.poses(weights, "")
    assert np.abs(after - before)[:, :2].max() < 0.03


def test_a_drive_in_another_building_is_refused_with_the_evidence(first):
    other = driven(ELSEWHERE, AWAY, 86_400.0, 3)[0]
    with pytest.raises(
        LogError, match=r"drive 3: does not fit on the map of drive 1: \d+ places .*agree.* Leave it out"
    ):
        Site(join_drives([first[0], other]), MapSettings(max_rounds=1)).poses(None, "")


THREE_ROOMS = [
    {"points": [[0, 0], [24, 0], [24, 7], [0, 7]], "closed": True},
    [[8, 0], [8, 1], [7, 2]],
    [[8, 7], [8, 3]],
    [[2, 2], [3, 2], [3, 4]],
    [[5, 5.5], [6, 5.5]],
    [[16, 0], [16, 4.5]],
    [[16, 7], [16, 6], [17, 5.5]],
    [[10, 3], [12, 5], [13, 3]],
    [[19, 2], [21, 2], [20, 3.5]],
    [[21.5, 5], [22.5, 5], [22.5, 6]],
]
WEST = [[1, 1], [5, 1], [5.5, 4.5], [4, 6], [1, 6], [1, 2.5]]
EAST = [[23, 1], [18, 1], [18, 4.5], [20, 6], [23, 4], [23, 2]]
THROUGH = [
    [1, 5],
    [4.2, 5],
    [6.5, 3.5],
    [6.5, 1],
    [4, 1],
    [1, 1.2],
    [1, 6],
    [6.5, 3],
    [9, 1.6],
    [14, 2],
    [15, 5.2],
    [18, 4.8],
    [19, 6],
    [21, 4.2],
    [23, 3],
]


def test_a_drive_that_fits_only_after_another_is_placed_waits_for_it():
    """The second drive shows nothing of the first; the third leads from one to the other."""
    drives = [
        driven(THREE_ROOMS, path, 86_400.0 * number, number)
        for number, path in enumerate((WEST, EAST, THROUGH))
    ]
    log = join_drives([log for log, _ in drives])
    poses = Site(log, MapSettings(max_rounds=1)).poses(None, "")
    true = np.concatenate([poses for _, poses in drives])
    error = between(poses, compose(inverse(true[0]), true))
    assert np.hypot(error[:, 0], error[:, 1]).max() < 0.1


def test_a_robot_that_stands_cannot_be_placed(first):
    still = replace(
        first[0],
        stamps_ns=first[0].stamps_ns + 86_400 * 10**9,
        ranges_m=np.repeat(first[0].ranges_m[:1], first[0].n_scans, axis=0),
        odometry=np.zeros_like(first[0].odometry),
        recordings=("still",),
    )
    with pytest.raises(LogError, match="still: the robot hardly moves"):
        Site(join_drives([first[0], still]), MapSettings(max_rounds=1)).poses(None, "")
