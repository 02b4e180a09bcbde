"""Places that look alike: what is said of them, and that none of them is driven from with states nobody learned."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from dynmap_cli.localization import tracking
from dynmap_cli.localization.particles.particle_filter import make_particles
from dynmap_cli.localization.sensing.map_pool import make_map_pool
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.localization.starting.global_start import possible_starts
from dynmap_cli.localization.starting.modes import Mode
from dynmap_cli.localization.starting.undecided import undecided_words
from dynmap_cli.localization.tracking import localize_log
from dynmap_cli.localization.watching.doubts import doubts
from tests.localization.worlds import corridor, patch_sets_of, simulated

SETTINGS = LocalizationSettings()


def mode_at(x, log_weight):
    pose = np.array([x, 1.0, 0.0])
    return Mode(pose, pose[None, :], np.zeros(1), log_weight, n_looks=3)


@pytest.mark.parametrize(("state", "is_alike"), [("closed", True), ("open", False)])
def test_an_open_door_tells_the_ends_of_a_corridor_apart_and_without_it_both_are_named(state, is_alike):
    run = simulated(corridor(state))
    pool = make_map_pool(run.true_map, patch_sets_of(run), SETTINGS)
    with ThreadPoolExecutor(1) as executor:
        words = undecided_words(possible_starts(run.log, 0, pool, SETTINGS, executor), ["a.bag"])
    assert bool(words) is is_alike
    if is_alike:
        assert words.startswith("a.bag: the map looks alike from several places")
        assert ", 0 deg" in words
        assert "180 deg" in words
    found = localize_log(run.log.select(slice(0, 3)), pool, SETTINGS, seed=0)
    assert any("looks alike" in sentence for sentence in found.alike)


def test_a_start_that_has_most_of_the_probability_is_not_undecided():
    assert undecided_words([mode_at(0.0, 0.0), mode_at(5.0, -2.0)], ["a"]) == ""
    assert undecided_words([mode_at(0.0, 0.0)], ["a"]) == ""


def test_the_likeliest_places_are_named_first_and_the_others_counted():
    words = undecided_words([mode_at(float(k), 0.1 * k) for k in range(6)], ["a"])
    assert "(5.00, 1.00) m, 0 deg (21 %) or (4.00, 1.00) m, 0 deg (19 %) or (3.00" in words
    assert "or 3 other places" in words


@pytest.mark.parametrize(("lost", "is_another"), [(0.1, False), (0.5, False), (0.5, True)])
def test_a_robot_that_is_lost_between_places_that_look_alike_is_told_why(lost, is_another):
    alike = ["a.bag: the map looks alike from several places"]
    sentences = doubts([], alike, lost_share=lost, is_elsewhere=is_another)
    assert len(sentences) == 1
    assert (sentences == alike) is not is_another


def test_a_few_particles_far_away_do_not_keep_the_others_from_learning_states(monkeypatch):
    """Without their belief the map shows all states at once, and pulls particles along the corridor."""
    run = simulated(corridor(path=((2.0, 1.0), (8.0, 1.0))))
    pool = make_map_pool(run.true_map, patch_sets_of(run), SETTINGS)
    poses = np.tile(run.true_poses[0], (2000, 1))
    poses += np.random.default_rng(0).normal(size=poses.shape) * (0.05, 0.05, 0.01)
    poses[:6] = 18.0, 1.0, np.pi
    monkeypatch.setattr(tracking, "draw_start", lambda *_: make_particles(poses))
    found = localize_log(run.log.select(slice(0, 30)), pool, SETTINGS, seed=0)
    left = [row.belief for row in found.states if row.submap == 0]
    assert len(left) > 15
    assert left[-1][0] > 0.95
