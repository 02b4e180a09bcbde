"""Whole recordings in small worlds."""

from dataclasses import replace

import numpy as np
import pytest

from dynmap_cli.domain.grid import UNKNOWN, OccupancyGrid
from dynmap_cli.domain.poses import between, compose
from dynmap_cli.errors import ArtifactError, LogError
from dynmap_cli.localization.sensing.beam_model import with_beam_model
from dynmap_cli.localization.sensing.map_pool import make_map_pool
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.localization.tracking import localize_log
from dynmap_cli.localization.watching.health import LOST
from tests.localization.worlds import office, patch_sets_of, pose_errors, simulated


@pytest.fixture(scope="module")
def run():
    return simulated(office())


def localize(run, seed=0, threads=1, log=None, sets=None, **settings):
    chosen = LocalizationSettings(**settings)
    sets = patch_sets_of(run) if sets is None else sets
    pool = make_map_pool(run.true_map, sets, chosen)
    if chosen.sensor == "beam":
        pool = with_beam_model(pool, run.true_map, None, sets)
    return localize_log(run.log if log is None else log, pool, chosen, seed=seed, threads=threads)


def assert_close(found, run, metres=0.12, degrees=1.5):
    poses = found.trajectory.poses
    away_m, away_deg = pose_errors(poses, run.true_poses[: len(poses)])
    assert np.quantile(away_m, 0.95) < metres
    assert np.quantile(away_deg, 0.95) < degrees


@pytest.mark.parametrize("sensor", ["likelihood_field", "beam"])
@pytest.mark.parametrize("states", ["belief", "sampled"])
def test_pose_and_state_are_found_without_a_start(run, states, sensor):
    found = localize(run, states=states, sensor=sensor)
    assert_close(found, run)
    assert {row.verdict for row in found.health} == {"tracking"}
    assert_right_states_within(found, run, metres=1.0)


def assert_right_states_within(found, run, metres):
    """After so much way with the sub-map in view, and since the last change, the right state is sure."""
    scans = np.searchsorted(run.log.stamps_ns, [row.stamp_ns for row in found.states])
    way = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(run.true_poses[:, :2], axis=0), axis=1))])
    since, truth, n_sure = 0.0, None, 0
    previous = 0
    for row, scan in zip(found.states, scans, strict=True):
        now = int(run.object_states[scan, row.submap])
        if now != truth or scan - previous > 5:
            truth, since = now, 0.0
        else:
            since += way[scan] - way[previous]
        previous = scan
        if since > metres:
            assert row.belief[truth] > 0.95
            n_sure += 1
    assert n_sure >= 5


def test_the_same_seed_gives_the_same_bytes_for_any_number_of_threads(run):
    log = run.log.select(slice(0, 80))
    first, second = localize(run, 3, threads=1, log=log), localize(run, 3, threads=4, log=log)
    assert first.trajectory.poses.tobytes() == second.trajectory.poses.tobytes()
    assert [row.belief.tobytes() for row in first.states] == [row.belief.tobytes() for row in second.states]
    assert first.health == second.health
    other = localize(run, 4, log=log)
    assert other.trajectory.poses.tobytes() != first.trajectory.poses.tobytes()


def test_a_given_start_is_used(run):
    found = localize(run, log=run.log.select(slice(0, 80)), start=tuple(run.true_poses[0]))
    assert_close(found, run)


def test_a_given_start_that_is_confirmed_is_no_search(run):
    assert localize(run, log=run.log.select(slice(0, 5)), start=tuple(run.true_poses[0])).searches == []


def test_a_wrong_start_is_lost_and_found_in_the_first_update(run):
    found = localize(run, log=run.log.select(slice(0, 80)), start=(9.0, 7.0, 2.0))
    assert found.searches == [found.health[0].stamp_ns]
    assert [row.verdict == "lost" for row in found.health[:2]] == [True, False]
    assert found.health[0].lost > LOST > found.health[1].lost
    away_m, _ = pose_errors(found.trajectory.poses[5:], run.true_poses[5:80])
    assert away_m.max() < 0.3


def test_without_odometry_the_robot_goes_on_as_before(run):
    blind = replace(run.log, odometry=np.full((run.log.n_scans, 3), np.nan))
    assert_close(localize(run, log=blind.select(slice(0, 150))), run)


def test_scans_without_returns_are_bridged(run):
    ranges = run.log.ranges_m.copy()
    ranges[:8] = np.nan
    ranges[100:115] = np.inf
    ranges[::7] = np.nan
    found = localize(run, log=replace(run.log, ranges_m=ranges).select(slice(0, 160)))
    assert np.isfinite(found.trajectory.poses).all()
    assert_close(found, run)


def test_a_kidnapped_robot_is_lost_and_found_again(run):
    cut = np.r_[0:75, 210:250]
    log = run.log.select(cut)
    odometry = log.odometry.copy()
    odometry[75:] = compose(odometry[74], between(odometry[75], odometry[75:]))
    found = localize(run, log=replace(log, odometry=odometry))
    assert "lost" in {row.verdict for row in found.health if row.stamp_ns > log.stamps_ns[75]}
    assert found.searches
    away_m, _ = pose_errors(found.trajectory.poses[-15:], run.true_poses[cut][-15:])
    assert away_m.max() < 0.3


def test_each_drive_starts_anew(run):
    cut = np.r_[0:75, 210:285]
    log = run.log.select(cut)
    index = np.repeat([0, 1], 75).astype(np.int32)
    log = replace(
        log,
        recording_index=index,
        recordings=("a", "b"),
        drive_of_recording=np.array([0, 1], dtype=np.int32),
    )
    found = localize(run, log=log)
    away_m, _ = pose_errors(found.trajectory.poses, run.true_poses[cut])
    assert np.quantile(away_m, 0.95) < 0.12


def test_without_patches_it_is_plain_localization(run):
    found = localize(run, log=run.log.select(slice(0, 80)), sets=[])
    assert_close(found, run)
    assert found.states == []


def test_a_log_without_returns_is_refused_in_one_line(run):
    log = replace(run.log, ranges_m=np.full_like(run.log.ranges_m, np.nan))
    with pytest.raises(LogError, match="enough returns"):
        localize(run, log=log)


def test_a_map_without_free_cells_is_refused_in_one_line(run):
    blank = OccupancyGrid(run.true_map.frame, np.full_like(run.true_map.cells, UNKNOWN))
    settings = LocalizationSettings()
    with pytest.raises(ArtifactError, match="no free cell"):
        localize_log(run.log, make_map_pool(blank, [], settings), settings, seed=0)
