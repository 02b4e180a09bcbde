"""The places among many candidates: each judged by the best pose in it."""

import itertools
import math
from dataclasses import replace

import numpy as np

from dynmap_cli.localization.sensing.map_pool import make_map_pool
from dynmap_cli.localization.sensing.sensor import sweep_of
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.localization.starting.modes import (
    LEAST_BELOW,
    SCANS_OF_A_DRIVE,
    Candidates,
    Look,
    Mode,
    all_scores,
    find_modes,
    is_near,
    look_scores,
    weigh_on,
)
from tests.localization.test_states import POSE, log_of, world

SETTINGS = LocalizationSettings()


def beside(*step):
    return POSE + np.array(step)


def seen():
    grid, patch_set = world()
    log = log_of([True])
    return make_map_pool(grid, [patch_set], SETTINGS), [
        Look(sweep_of(log, 0, 30.0), np.array(step)) for step in ([0.0, 0.0, 0.0], [0.02, 0.0, 0.01])
    ]


def plain_best(pose, looks, pool):
    """Best pose of the place around a pose, and its score: refined in two steps, one pose after another."""
    pitch = (SETTINGS.start_pitch_m, SETTINGS.start_pitch_m, math.radians(SETTINGS.start_pitch_deg))
    for fineness in (4.0, 16.0):
        best, around = -math.inf, pose
        for steps in itertools.product(range(-2, 3), repeat=3):
            tried = around + np.array([k * size / fineness for k, size in zip(steps, pitch, strict=True)])
            score = sum(
                float(look_scores(look, tried[None], pool, pool.start_field, SETTINGS)[0]) for look in looks
            )
            if score > best:
                best, pose = score, tried
    return pose, best


def test_a_place_is_worth_what_the_best_pose_in_it_is():
    pool, looks = seen()
    poses = np.array([beside(0.1, -0.1, 0.03), beside(0.12, -0.12, 0.03), [1.0, 1.2, 1.0]])
    found = find_modes(
        Candidates(poses, np.array([-9.0, -10.0, -11.0])), looks, pool, pool.start_field, SETTINGS
    )
    assert [len(mode.poses) for mode in sorted(found, key=lambda mode: -len(mode.poses))] == [2, 1]
    for mode, first in zip(sorted(found, key=lambda mode: -len(mode.poses)), (0, 2), strict=True):
        pose, score = plain_best(poses[first], looks, pool)
        np.testing.assert_allclose(mode.pose, pose)
        assert math.isclose(mode.score, score)
        np.testing.assert_allclose(mode.poses[0], pose)


def test_where_the_lattice_misses_the_robot_its_place_still_wins():
    pool, looks = seen()
    poses = np.array([beside(0.12, 0.12, math.radians(2.0)), beside(-1.2, 0.0, 0.0)])
    found = find_modes(Candidates(poses, np.array([-20.0, -10.0])), looks, pool, pool.start_field, SETTINGS)
    assert bool(is_near(found[0].pose[None], POSE)[0])
    assert found[0].score > found[1].score


def test_only_candidates_that_are_out_of_the_question_are_left_out_on_the_way():
    pool, looks = seen()
    random = np.random.default_rng(0)
    poses = POSE + random.uniform(-1.5, 1.5, (5000, 3))
    scores = all_scores(looks[:1], poses, pool, pool.start_field, SETTINGS)
    found = weigh_on(Candidates(poses, scores), 4 * looks, pool, pool.start_field, SETTINGS)
    every = scores + all_scores(4 * looks, poses, pool, pool.start_field, SETTINGS)
    least = every.max() - LEAST_BELOW
    assert 0 < (every > least).sum() <= found.scores.size < scores.size
    is_in_question = found.scores > least
    np.testing.assert_array_equal(found.poses[is_in_question], poses[every > least])
    np.testing.assert_array_equal(found.scores[is_in_question], every[every > least])


def test_scans_of_one_drive_are_worth_a_few():
    mode = Mode(POSE, POSE[None], np.zeros(1), score=-24.0, n_looks=12, log_prior=-1.0)
    assert math.isclose(mode.log_weight, -24.0 * SCANS_OF_A_DRIVE / 12 - 1.0)
    assert replace(mode, n_looks=1).log_weight == -25.0
