"""A state in every particle: the law that the cloud is Bayes over places and states together."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from dynmap_cli.domain.poses import compose
from dynmap_cli.localization.beliefs.transitions import nearest_submaps, predict_belief
from dynmap_cli.localization.particles.particle_filter import make_particles, resample
from dynmap_cli.localization.particles.particle_states import CarriedStates, carry_states
from dynmap_cli.localization.sensing.map_pool import make_map_pool
from dynmap_cli.localization.sensing.sensor import pose_ends, scan_log_likelihoods, sweep_of, temper
from dynmap_cli.localization.sensing.weighing import weighing_of
from dynmap_cli.localization.settings import LocalizationSettings
from tests.localization.test_states import log_of, ranges_in, world
from tests.reference.localization import exact_joint_posterior

STARTS = np.array([[0.95, 2.55, 0.0], [0.95, 2.25, 0.0], [1.05, 2.75, 0.1]])
"""Three places from which the robot may have started; the first is right."""
STEP, SECONDS, WITHIN_M = np.array([0.3, 0.0, 0.0]), 20.0, 2.4
SHUT = [True, True, True, False, False]
ENTERING = np.array([0.3, 0.7])


def scans(settings):
    """Scans of a robot that drives towards a door, which opens on the way."""
    log, pose, found = log_of(SHUT), STARTS[0], []
    ranges = np.stack([ranges_in(shut, compose(pose, t * STEP), 0.03, t) for t, shut in enumerate(SHUT)])
    log = replace(log, ranges_m=ranges)
    for scan in range(log.n_scans):
        found.append(sweep_of(log, scan, settings.laser_max_range))
    return found


def enumerated(pool, settings):
    """Exact p(start, last state | scans); outside the sub-map there is one state, 0."""
    area, windows, no_window = pool.submaps[0], pool.submaps[0].windows(), np.zeros((1, 5), dtype=np.int32)
    same = float(predict_belief(np.eye(2)[0], area, SECONDS)[0])
    transitions, tables = [], []
    was_in = [-1] * len(STARTS)
    for t, sweep in enumerate(scans(settings)):
        ends = pose_ends(sweep, settings.max_beams)
        poses = compose(STARTS, t * STEP)
        now_in = nearest_submaps(poses[:, :2], pool.submaps, WITHIN_M).tolist()
        rows, by_pose = [], []
        for k, pose in enumerate(poses):
            stays, is_in = was_in[k] == now_in[k] == 0, now_in[k] == 0
            entering = [ENTERING] * 2 if is_in else [[1.0, 0.0]] * 2
            by_pose.append([[same, 1 - same], [1 - same, same]] if stays else entering)
            chosen = [windows[j : j + 1] if is_in else no_window for j in range(2)]
            rows.append(
                [
                    temper(len(ends), settings)
                    * scan_log_likelihoods(pool.pool, pool.frame, pose[None], ends, one)[0]
                    for one in chosen
                ]
            )
        transitions.append(by_pose)
        tables.append(rows)
        was_in = now_in
    assert set(was_in) == {0}
    return np.array(exact_joint_posterior([1 / 3] * 3, transitions, tables))


@pytest.mark.parametrize("resamples", [False, True])
def test_the_posterior_over_places_and_states_is_that_of_bayes_by_enumeration(resamples):
    n = 20_000
    settings = LocalizationSettings(independent_beams=3.0, min_particles=3 * n, max_particles=3 * n)
    grid, patch_set = world()
    pool, random = make_map_pool(grid, [patch_set], settings), np.random.default_rng(0)
    particles = make_particles(np.repeat(STARTS, n, axis=0))
    with ThreadPoolExecutor(1) as executor:
        for t, sweep in enumerate(scans(settings)):
            if t > 0:
                particles = replace(particles, poses=compose(particles.poses, STEP))
            carried = carry_states(
                particles,
                weighing_of(sweep, pool, settings),
                seconds=SECONDS,
                within_m=WITHIN_M,
                entering=lambda _: ENTERING,
                executor=executor,
            )
            particles = carried.drawn(random)
            if resamples:
                particles = resample(particles, settings, random)
    last = compose(STARTS, (len(SHUT) - 1) * STEP)
    start = np.argmin(np.abs(particles.poses[:, None, 1] - last[None, :, 1]), axis=1)
    found = np.bincount(2 * start + particles.states, particles.weights, 6).reshape(3, 2)
    exact = enumerated(pool, settings)
    np.testing.assert_allclose(found, exact, atol=0.015)
    assert np.sort(exact.ravel())[-2] > 0.05
    in_submap = carried.belief(0, 2)
    np.testing.assert_allclose(in_submap, exact.sum(axis=0), atol=0.015)


def carried_of(states, priors, log_likelihoods):
    count = len(states)
    particles = replace(
        make_particles(np.zeros((count, 3))),
        submaps=np.zeros(count, dtype=np.int32),
        states=np.array(states, dtype=np.int32),
    )
    return CarriedStates(particles, np.array(priors), np.array(log_likelihoods))


def test_a_state_that_no_particle_is_in_is_found_when_the_scan_shows_it():
    n = 500
    carried = carried_of([0] * n, [[0.9999, 0.0001]] * n, [[-20.0, 0.0]] * n)
    drawn = carried.drawn(np.random.default_rng(0))
    assert (drawn.states == 1).all()
    np.testing.assert_allclose(drawn.weights, 1 / n)
    assert carried.belief(0, 2)[1] > 0.99


def test_evidence_about_a_submap_changes_its_particles_only():
    carried = carried_of([0] * 4, [[0.5, 0.5]] * 4, np.zeros((4, 2)))
    submaps = np.array([0, 0, 0, 1], dtype=np.int32)
    carried = replace(carried, particles=replace(carried.particles, submaps=submaps))
    more = carried.with_evidence(0, np.log([0.2, 0.6]))
    np.testing.assert_allclose(more.belief(0, 2), [0.25, 0.75])
    np.testing.assert_allclose(more.weighed().weights, np.array([0.4, 0.4, 0.4, 1.0]) / 2.2)
    assert more.belief(1, 2) is None
