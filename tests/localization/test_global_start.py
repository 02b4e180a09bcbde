"""Places that are possible, the drives from them, and what is drawn."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynmap_cli.domain.grid import UNKNOWN, OccupancyGrid
from dynmap_cli.domain.poses import between
from dynmap_cli.localization.sensing.map_pool import make_map_pool
from dynmap_cli.localization.sensing.sensor import sweep_of
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.localization.starting.drives import drive_from
from dynmap_cli.localization.starting.global_start import (
    LEAST_IN_A_PLACE,
    draw_start,
    global_start,
    search_again,
)
from dynmap_cli.localization.starting.modes import Candidates, Look, Mode, all_scores, find_modes
from tests.localization.worlds import office, patch_sets_of, pose_errors, simulated

SETTINGS = LocalizationSettings()
ELSEWHERE = np.array([9.0, 6.0, 2.0])


@pytest.fixture(scope="module")
def run():
    return simulated(office())


@pytest.fixture(scope="module")
def pool(run):
    return make_map_pool(run.true_map, patch_sets_of(run), SETTINGS)


def looks_of(run, count=12, every=4):
    odometry = run.log.odometry
    return [
        Look(sweep_of(run.log, k, 30.0), between(odometry[0], odometry[k]))
        for k in range(0, count * every, every)
    ]


def mode_at(pose, score=0.0, n_looks=12):
    return Mode(np.asarray(pose), np.asarray(pose)[None, :], np.zeros(1), score, n_looks)


def test_how_well_a_place_fits_does_not_depend_on_how_the_lattice_lies(run, pool):
    looks, raw, refined = looks_of(run), [], []
    steps = np.stack(np.meshgrid(*[np.arange(-4, 5)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    for shift in (0.0, 0.06, 0.12):
        poses = run.true_poses[0] + steps * [0.25, 0.25, np.radians(4.0)] + [shift, shift, 0.2 * shift]
        scores = all_scores(looks, poses, pool, pool.start_field, SETTINGS)
        best = find_modes(Candidates(poses, scores), looks, pool, pool.start_field, SETTINGS)[0]
        assert pose_errors(best.pose[None, :], run.true_poses[:1])[0][0] < 0.2
        assert np.min(pose_errors(best.poses, best.pose[None, :])[0]) < 1e-9
        raw.append(scores.max())
        refined.append(best.score)
    assert np.ptp(refined) < 0.3 * np.ptp(raw)


def test_the_drive_from_the_true_place_is_the_one_that_is_left(run, pool):
    modes = [mode_at(ELSEWHERE), mode_at(run.true_poses[0]), mode_at(run.true_poses[0] + [0.05, 0.02, 0.01])]
    left = drive_from(modes, looks_of(run, 20), 20, pool, SETTINGS)
    assert len(left) == 1
    assert pose_errors(left[0].pose[None, :], run.true_poses[:1])[0][0] < 0.06


def test_a_drive_goes_on_while_several_places_are_possible_and_no_longer(run, pool):
    seen = []

    def looks():
        for look in looks_of(run, 20):
            seen.append(look)
            yield look

    drive_from([mode_at(run.true_poses[0])], looks(), 20, pool, SETTINGS)
    assert len(seen) == SETTINGS.start_scans + 1


def test_a_long_drive_counts_no_more_than_a_short_one():
    assert mode_at(ELSEWHERE, -120.0, 12).log_weight == pytest.approx(-30.0)
    assert mode_at(ELSEWHERE, -1200.0, 120).log_weight == pytest.approx(-30.0)
    assert mode_at(ELSEWHERE, -10.0, 1).log_weight == pytest.approx(-10.0)


@given(st.lists(st.floats(-25.0, 0.0), min_size=1, max_size=30), st.integers(10, 3000))
def test_each_place_has_its_weight_and_enough_particles(scores, most):
    settings = SETTINGS.model_copy(update={"max_particles": most, "min_particles": 10})
    modes = [mode_at([10.0 * k, 0.0, 0.0], score) for k, score in enumerate(sorted(scores, reverse=True))]
    particles = draw_start(modes, settings, np.random.default_rng(0))
    assert particles.count == most
    assert particles.weights.sum() == pytest.approx(1.0)
    place = np.round(particles.poses[:, 0] / 10.0).astype(int)
    kept = modes[: min(len(modes), most)]
    shares = np.exp([mode.log_weight - kept[0].log_weight for mode in kept])
    found = np.bincount(place, particles.weights, minlength=len(kept))
    np.testing.assert_allclose(found, shares / shares.sum(), atol=1e-9)
    assert np.bincount(place).min() >= min(LEAST_IN_A_PLACE, most // len(kept)) // 2


def search(run, pool, here):
    with ThreadPoolExecutor(1) as executor:
        return search_again(
            run.log, 0, here, pool, SETTINGS, np.random.default_rng(0), executor, is_given=False
        )


def test_a_start_is_where_the_robot_is(run, pool):
    with ThreadPoolExecutor(1) as executor:
        particles = global_start(run.log, 0, pool, SETTINGS, np.random.default_rng(0), executor)
    assert np.median(pose_errors(particles.poses, run.true_poses[:1])[0]) < 0.3


def test_a_search_leaves_a_robot_that_is_right_where_it_is(run, pool):
    assert search(run, pool, run.true_poses[0]) is None


@pytest.mark.parametrize("away", [[0.8, 0.3, 0.2], [9.0, 0.5, 2.0]], ids=["drifted", "carried"])
def test_a_search_finds_a_robot_that_drifted_or_was_carried(run, pool, away):
    particles = search(run, pool, run.true_poses[0] + away)
    assert np.median(pose_errors(particles.poses, run.true_poses[:1])[0]) < 0.3


def test_a_robot_in_a_room_that_the_map_does_not_show_is_not_carried_elsewhere(run):
    cells = np.array(run.true_map.cells)
    points = run.true_map.frame.to_points(np.argwhere(np.ones(cells.shape, dtype=bool)))
    beyond = (points[:, 0] < 5.0).reshape(cells.shape)
    cells[beyond] = UNKNOWN
    pool = make_map_pool(OccupancyGrid(run.true_map.frame, cells), [], SETTINGS)
    found = search(run, pool, run.true_poses[0])
    away_m = np.zeros(1) if found is None else pose_errors(found.poses, run.true_poses[:1])[0]
    assert np.median(away_m) < 1.5
