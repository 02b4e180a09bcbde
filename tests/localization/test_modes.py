"""The places among many candidates: each judged by the best pose in it."""

import itertools
import math

import numpy as np

from dynmap_cli.domain.poses import compose
from dynmap_cli.localization.health import count_places_through
from dynmap_cli.localization.map_pool import make_map_pool
from dynmap_cli.localization.modes import LOG_LIKELIHOOD_PER_PLACE, Look, judge_modes, look_scores
from dynmap_cli.localization.sensor import sweep_of
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.localization.states import place_sweep
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


def plain_value(pose, looks, pool):
    """Of the place around a pose: refined in two steps, one pose after another, less what the walls cost."""
    pitch = (SETTINGS.start_pitch_m, SETTINGS.start_pitch_m, math.radians(SETTINGS.start_pitch_deg))
    for fineness in (4.0, 16.0):
        best, around = -math.inf, pose
        for steps in itertools.product(range(-2, 3), repeat=3):
            tried = around + np.array([k * size / fineness for k, size in zip(steps, pitch, strict=True)])
            score = sum(float(look_scores(look, tried[None], pool, SETTINGS)[0]) for look in looks)
            if score > best:
                best, pose = score, tried
    walls = sum(
        count_places_through(place_sweep(look.sweep, compose(pose, look.step)), pool) for look in looks
    )
    return best + LOG_LIKELIHOOD_PER_PLACE * walls


def test_a_place_is_worth_what_the_best_pose_in_it_is():
    pool, looks = seen()
    poses = np.array([beside(0.1, -0.1, 0.03), beside(0.12, -0.12, 0.03), [1.0, 1.2, 1.0]])
    scores = sum(look_scores(look, poses, pool, SETTINGS) for look in looks)
    kept, found = judge_modes(poses, scores, looks, pool, SETTINGS)
    best = scores[:2].max()
    expected = [value - best + plain_value(poses[np.argmax(scores)], looks, pool) for value in scores[:2]]
    by_candidate = dict(zip(kept.tolist(), found.tolist(), strict=True))
    np.testing.assert_allclose([by_candidate[0], by_candidate[1]], expected)


def test_where_the_lattice_misses_the_robot_its_place_still_wins():
    pool, looks = seen()
    poses = np.array([beside(0.12, 0.12, math.radians(2.0)), beside(-1.2, 0.0, 0.0)])
    scores = np.array([-20.0, -10.0])
    kept, found = judge_modes(poses, scores, looks, pool, SETTINGS)
    assert kept[np.argmax(found)] == 0
