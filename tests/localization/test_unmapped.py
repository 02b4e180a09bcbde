"""Rooms that the map does not show: a hall is mapped, the wing behind it is not."""

import math
from dataclasses import replace

import numpy as np
import pytest

from dynmap_cli.domain.grid import FREE, OCCUPIED, UNKNOWN, GridFrame, OccupancyGrid
from dynmap_cli.domain.poses import between, compose
from dynmap_cli.domain.scans import single_laser_log
from dynmap_cli.localization.afterwards.smoothing import smooth
from dynmap_cli.localization.particles.motion import Motion, motion_sigmas
from dynmap_cli.localization.sensing.map_pool import make_map_pool
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.localization.tracking import localize_log
from dynmap_cli.localization.watching import unmapped
from dynmap_cli.localization.watching.health import ScanHealth
from dynmap_cli.localization.watching.laser_odometry import LaserOdometry
from dynmap_cli.localization.watching.unmapped import EDGE_M, SETTLED_AFTER, STAYS, Unmapped, near_edges
from dynmap_cli.simulation.run import simulate
from dynmap_cli.simulation.scenario import parse_scenario
from tests.localization.worlds import pose_errors

WING_X_M = 9.0
"""The map ends here."""
HALL = [[1.5, 1.5], [7, 1.5], [7, 6.5], [2, 6.5], [2, 2]]
WING = [[11, 4], [11, 1.5], [15, 1.5], [15, 6.5], [11, 6.5], [11, 4], [17, 4], [19, 6], [20, 2], [17, 4]]


def building(rounds=3):
    """A hall, and a wing with four rooms behind a wide passage; the robot goes round in both."""
    way = [*HALL, [7, 4], *(WING * rounds), [7, 4], *HALL]
    walls = [
        {"points": [[0, 0], [21, 0], [21, 8], [0, 8]], "closed": True},
        *(
            [[9, 0], [9, 3]],
            [[9, 5], [9, 8]],
            [[13, 0], [13, 0.8]],
            [[13, 2.5], [13, 5.5]],
            [[13, 7.2], [13, 8]],
        ),
        *([[18, 0], [18, 3]], [[18, 5], [18, 8]], [[3.5, 3.5], [5, 3.5], [5, 4.5]], [[16, 3], [16.5, 2.5]]),
    ]
    return parse_scenario(
        {
            "seed": 5,
            "world": {"walls": walls},
            "robot": {"path": way, "speed_mps": 0.6},
            "lasers": [{"fov_deg": 180, "beams": 181, "max_range_m": 30, "noise_m": 0.02, "rate_hz": 5}],
        }
    )


@pytest.fixture(scope="module")
def run():
    return simulate(building())


def hall_of(run) -> OccupancyGrid:
    """The map without the wing."""
    frame, cells = run.true_map.frame, run.true_map.cells.copy()
    cells[:, math.ceil((WING_X_M + 0.2 - frame.origin_x_m) / frame.resolution_m) :] = UNKNOWN
    return OccupancyGrid(frame, cells)


def localize(run, grid, log=None, threads=1):
    settings = LocalizationSettings()
    pool = make_map_pool(grid, (), settings)
    return localize_log(run.log if log is None else log, pool, settings, seed=0, threads=threads)


@pytest.fixture(scope="module")
def found(run):
    return localize(run, hall_of(run))


def test_a_robot_that_drives_for_minutes_in_rooms_never_mapped_stays_where_it_is(run, found):
    assert (run.true_poses[:, 0] > WING_X_M + 0.5).sum() / 5.0 > 180.0
    away_m, away_deg = pose_errors(found.trajectory.poses, run.true_poses)
    assert away_m.max() < 0.1
    assert away_deg.max() < 2.0
    assert "lost" not in {row.verdict for row in found.health}
    assert not found.searches


def test_looking_back_goes_by_the_same_steps(run, found):
    settings = LocalizationSettings()
    smoothed = smooth(run.log, make_map_pool(hall_of(run), (), settings), found, settings)
    away_m, _ = pose_errors(smoothed.trajectory.poses, run.true_poses)
    assert away_m.max() < 0.1


def test_a_robot_carried_to_another_room_is_searched_for(run):
    """Out of the wing into the hall, while the odometry stood: its own scans fit no longer."""
    true = run.true_poses
    leave = int(np.flatnonzero(true[:, 0] > WING_X_M + 3.0)[0])
    back = int(np.flatnonzero((true[:, 0] > WING_X_M) & (np.arange(len(true)) > leave))[-1]) + 50
    rows = np.r_[0:leave, back : len(true)]
    log = run.log.select(rows)
    odometry = log.odometry.copy()
    odometry[leave:] = compose(odometry[leave - 1], between(odometry[leave], odometry[leave:]))
    found = localize(run, hall_of(run), log=replace(log, odometry=odometry))
    assert found.searches
    away_m, _ = pose_errors(found.trajectory.poses, true[rows])
    assert away_m[-30:].max() < 0.2


def test_where_the_map_shows_everything_nothing_changes(run, monkeypatch):
    log = run.log.select(slice(0, 300))
    usual = localize(run, run.true_map, log=log)
    monkeypatch.setattr(unmapped, "LEAST_JUDGED", -1.0)
    never = localize(run, run.true_map, log=log)
    assert usual.laser_motions == {}
    assert usual.trajectory.poses.tobytes() == never.trajectory.poses.tobytes()
    assert usual.health == never.health


def test_the_same_bytes_for_any_number_of_threads_and_the_map_stays_as_it_was(run):
    settings, log = LocalizationSettings(), run.log.select(slice(0, 350))
    pool = make_map_pool(hall_of(run), (), settings)
    before = pool.pool.tobytes()
    first, second = (localize_log(log, pool, settings, seed=0, threads=threads) for threads in (1, 4))
    assert first.laser_motions
    assert first.trajectory.poses.tobytes() == second.trajectory.poses.tobytes()
    assert pool.pool.tobytes() == before


def test_along_a_bare_corridor_a_step_is_as_unsure_as_the_odometry(run):
    """Two parallel walls: across the way the scans know it, along the way they do not."""
    bearings = np.linspace(-math.pi / 2, math.pi / 2, 181)
    with np.errstate(divide="ignore"):
        ranges = np.minimum(1.0 / np.abs(np.sin(bearings)), 50.0)
    ranges[ranges > 8.0] = np.inf
    stamps_ns = (np.arange(20) * 2e8).astype(np.int64)
    poses = np.column_stack([0.1 * np.arange(20), np.zeros((20, 2))])
    noise_m = np.random.default_rng(0).normal(0.0, 0.01, (20, 181))
    log = single_laser_log(stamps_ns, (ranges + noise_m).astype(np.float32), bearings, poses)
    settings = LocalizationSettings()
    laser, motion = LaserOdometry(log, settings), Motion(np.array([0.1, 0.0, 0.0]), measured=True)
    for scan in range(20):
        found = laser.match(scan, motion)
    _, along, across, _ = motion_sigmas(motion, settings)
    assert found.sigmas[0] > 0.9 * along
    assert found.sigmas[1] < 0.7 * across
    assert abs(found.step[0] - 0.1) < 0.01


def test_a_scan_that_fits_only_away_from_the_odometry_is_no_step(run):
    settings = LocalizationSettings()
    laser, still = LaserOdometry(run.log, settings), Motion(np.zeros(3), measured=True)
    assert laser.match(0, still) is not None
    way_m = np.hypot(*(run.true_poses[:, :2] - run.true_poses[0, :2]).T)
    assert laser.match(int(np.argmax(way_m > 0.8)), still) is None


def test_edges_are_their_plain_twin():
    cells = np.full((60, 70), UNKNOWN, dtype=np.int8)
    cells[10:50, 10:40] = FREE
    cells[10:50, 9] = cells[9, 9:41] = cells[50, 9:41] = OCCUPIED
    cells[10:25, 40] = OCCUPIED
    pool = make_map_pool(OccupancyGrid(GridFrame(0.05, 0.0, 0.0, 60, 70), cells), (), LocalizationSettings())
    np.testing.assert_array_equal(near_edges(pool), plain_near_edges(pool))
    assert near_edges(pool).any()


def plain_near_edges(pool):
    """Cell by cell; the one border of this map is longer than any gap."""
    known, reach = pool.free | pool.explained, math.ceil(EDGE_M / pool.frame.resolution_m)
    near = np.zeros_like(known)
    for row, col in np.argwhere(~known):
        beside = [(row + 1, col), (row - 1, col), (row, col + 1), (row, col - 1)]
        if any(0 <= r < known.shape[0] and 0 <= c < known.shape[1] and pool.free[r, c] for r, c in beside):
            near[max(row - reach, 0) : row + reach + 1, max(col - reach, 0) : col + reach + 1] = True
    return near


def health(judged=1.0, through=0.0):
    off = 1.0 - judged
    return ScanHealth(judged - through, 0.0, off + through, through, 0.0, 0.0, off_map=off)


def test_only_who_was_settled_and_came_scan_by_scan_is_excused(run):
    settings = LocalizationSettings()
    drive = Unmapped(run.log, make_map_pool(hall_of(run), (), settings), settings)
    outside, pose = health(judged=0.4, through=0.02), np.zeros(3)
    motion = Motion(np.zeros(3), measured=True)
    for _ in range(SETTLED_AFTER):
        assert drive.improved(0, motion) is motion
        assert drive.excused(outside) == outside
        drive.watch(health(), pose, is_in_doubt=False)
    drive.watch(outside, pose, is_in_doubt=False)
    assert drive.improved(0, motion).sigmas is not None
    assert drive.excused(outside).judged == 1.0
    assert drive.excused(outside).through == outside.through
    drive.watch(outside, pose, is_in_doubt=True)
    assert drive.excused(outside) == outside
    for _ in range(STAYS):
        drive.watch(health(), pose, is_in_doubt=False)
    assert drive.improved(0, motion) is motion
