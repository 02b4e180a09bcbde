"""Looking back: poses as a chain, states forward and backward."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from dynmap_cli.domain.poses import between, compose
from dynmap_cli.localization.afterwards.pose_chain import Link, likeliest_chain
from dynmap_cli.localization.afterwards.smoothed_states import smooth_states
from dynmap_cli.localization.afterwards.smoothing import smooth
from dynmap_cli.localization.beliefs.states import update_belief
from dynmap_cli.localization.beliefs.transitions import predict_belief
from dynmap_cli.localization.found import StateRow
from dynmap_cli.localization.sensing.map_pool import make_map_pool
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.localization.tracking import localize_log
from tests.localization.worlds import office, patch_sets_of, pose_errors, simulated


@pytest.fixture(scope="module")
def run():
    return simulated(office())


def looked_back(run, log=None, seed=0, **settings):
    """What the filter found, and the same looked back on."""
    chosen = LocalizationSettings(**settings)
    log = run.log if log is None else log
    pool = make_map_pool(run.true_map, patch_sets_of(run), chosen)
    found = localize_log(log, pool, chosen, seed=seed)
    return found, smooth(log, pool, found, chosen)


def test_the_chain_is_what_a_dense_solver_finds():
    random = np.random.default_rng(1)
    true = np.cumsum(random.normal(scale=[0.5, 0.3, 0.4], size=(8, 3)), axis=0)
    seen = true + random.normal(scale=0.05, size=true.shape)
    links = []
    for step in between(true[:-1], true[1:]):
        root = random.normal(size=(3, 3))
        links.append(Link(step + random.normal(scale=0.02, size=3), 50 * (root @ root.T + np.eye(3))))
    weights = np.array([30.0, 40.0, 90.0])

    def fit(node, pose):
        away = pose - seen[node]
        upper = np.diag(weights)[np.triu_indices(3)]
        return np.concatenate([[0.5 * weights @ away**2], weights * away, upper])

    def residuals(flat):
        poses = flat.reshape(-1, 3)
        motions = [
            np.linalg.cholesky(link.information).T @ between(compose(start, link.step), end)
            for link, (start, end) in zip(links, itertools.pairwise(poses), strict=True)
        ]
        return np.concatenate([(np.sqrt(weights) * (poses - seen)).ravel(), *motions])

    dense = least_squares(residuals, seen.ravel(), xtol=1e-12, ftol=1e-12, gtol=1e-12).x.reshape(-1, 3)
    np.testing.assert_allclose(likeliest_chain(seen, links, fit), dense, atol=1e-4)


def test_states_are_those_of_all_sequences_weighed_one_by_one(run):
    settings = LocalizationSettings()
    pool = make_map_pool(run.true_map, patch_sets_of(run), settings)
    random = np.random.default_rng(2)
    evidence, stamps = random.normal(size=(5, 2)), np.array([0, 3, 40, 41, 200]) * 10**9
    area, waits = pool.submaps[0], (np.diff(stamps) * 1e-9).tolist()
    sames = [float(predict_belief(np.eye(2)[0], area, seconds)[0]) for seconds in waits]
    rows, belief = [], np.full(2, 0.5)
    for number, stamp in enumerate(stamps.tolist()):
        if number:
            belief = predict_belief(belief, area, waits[number - 1])
        belief = update_belief(belief, evidence[number])
        rows.append(StateRow(stamp, 0, belief, np.zeros(0, dtype=bool)))
    expected = np.zeros((5, 2))
    for states in itertools.product((0, 1), repeat=5):
        weight = np.exp(evidence[np.arange(5), states].sum())
        for same, (a, b) in zip(sames, itertools.pairwise(states), strict=True):
            weight *= same if a == b else 1 - same
        expected[np.arange(5), states] += weight
    expected /= expected.sum(axis=1, keepdims=True)
    found = smooth_states(rows, pool)
    np.testing.assert_allclose([row.belief for row in found], expected, atol=1e-9)
    assert [row.stamp_ns for row in found] == stamps.tolist()


@pytest.mark.parametrize("states", ["belief", "sampled"])
def test_looking_back_makes_poses_no_worse(run, states):
    errors = []
    for seed in range(3):
        found, smoothed = looked_back(run, states=states, seed=seed)
        pair = [pose_errors(one.trajectory.poses, run.true_poses) for one in (found, smoothed)]
        errors.append([[away.mean() for away in one] for one in pair])
    before, after = np.mean(errors, axis=0)
    assert after[0] <= before[0] + 0.001
    assert after[1] <= before[1] + 0.01
    np.testing.assert_array_equal(smoothed.trajectory.stamps_ns, found.trajectory.stamps_ns)
    assert [(r.stamp_ns, r.submap) for r in smoothed.states] == [(r.stamp_ns, r.submap) for r in found.states]


def test_a_robot_that_was_found_late_is_known_from_the_start(run):
    found, smoothed = looked_back(run, start=(12.0, 7.0, 1.0))
    assert found.searches
    before, after = (pose_errors(one.trajectory.poses, run.true_poses)[0] for one in (found, smoothed))
    assert before.max() > 5.0
    assert after.max() < 0.15


def test_a_carried_robot_is_where_it_was_until_then(run):
    log, poses = run.log, run.true_poses
    cut = 120
    carried = log.select(np.r_[0:cut, 200:301])
    where = poses[np.r_[0:cut, 200:301]]
    motion = between(poses[200], poses[200:301])
    odometry = np.concatenate([poses[:cut], compose(poses[cut - 1], motion)])
    found, smoothed = looked_back(run, log=replace(carried, odometry=odometry))
    before, after = (pose_errors(one.trajectory.poses, where)[0] for one in (found, smoothed))
    assert found.searches
    assert (before > 0.5).any()
    assert (after > 0.5).sum() <= 3


def test_without_odometry_looking_back_does_no_harm(run):
    blind = replace(run.log, odometry=np.full((run.log.n_scans, 3), np.nan)).select(slice(0, 150))
    found, smoothed = looked_back(run, log=blind)
    before, after = (pose_errors(one.trajectory.poses, run.true_poses[:150]) for one in (found, smoothed))
    assert after[0].mean() <= before[0].mean() + 0.001
    assert np.isfinite(smoothed.trajectory.poses).all()
