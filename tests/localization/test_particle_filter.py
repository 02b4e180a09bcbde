"""Laws of weighing, resampling and the estimate."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dynmap_cli.domain.poses import wrap_angle
from dynmap_cli.kernels.particles import count_bins, draw_low_variance, kld_count, sort_into_bins
from dynmap_cli.localization.particles.particle_filter import (
    BIN_M,
    BIN_RAD,
    CLUSTER_M,
    CLUSTER_RAD,
    ONE_MODE_SHARE,
    Particles,
    estimate_pose,
    make_particles,
    resample,
    reweigh,
)
from dynmap_cli.localization.settings import LocalizationSettings
from tests.reference.localization import (
    plain_bins,
    plain_cluster,
    plain_kld_count,
    plain_low_variance,
    plain_resample,
    plain_reweigh,
)

weights = st.lists(st.floats(0.01, 1.0), min_size=1, max_size=30)


@given(weights, st.integers(1, 60), st.floats(0.0, 0.99))
def test_the_comb_is_its_plain_twin(values, count, offset):
    drawn = np.empty(count, dtype=np.int64)
    draw_low_variance(np.array(values), count, offset, drawn)
    assert drawn.tolist() == plain_low_variance(values, count, offset)


@given(weights, st.integers(0, 999))
def test_weighing_is_its_plain_twin(values, seed):
    particles = make_particles(np.zeros((len(values), 3)))
    particles = replace(particles, weights=np.array(values) / np.sum(values))
    logs = np.random.default_rng(seed).normal(-5.0, 5.0, len(values))
    expected = plain_reweigh(particles.weights, logs)
    np.testing.assert_allclose(reweigh(particles, logs).weights, expected, rtol=1e-9, atol=1e-300)


@given(st.integers(0, 999), st.integers(1, 200), st.sampled_from([0.1, 1.0, 30.0]))
def test_bins_and_cluster_are_their_plain_twins(seed, n, wide):
    random = np.random.default_rng(seed)
    poses = random.normal(size=(n, 3)) * (wide, wide, 0.3) + (0, 0, 3.1)
    poses[:, 2] = wrap_angle(poses[:, 2])
    submaps, states = random.integers(-1, 3, (2, n)).astype(np.int32)
    bins = np.empty(n, dtype=np.int32)
    sort_into_bins(poses, submaps, states, BIN_M, BIN_RAD, bins)
    assert bins.tolist() == plain_bins(poses, submaps, states, BIN_M, BIN_RAD)
    drawn = random.integers(0, n, 3 * n)
    assert count_bins(bins, drawn) == len(set(bins[drawn].tolist()))
    particles = Particles(poses, random.dirichlet(np.ones(n)), submaps, states)
    places = plain_bins(poses, submaps * 0, states * 0, BIN_M, BIN_RAD)
    x, y, yaw, share, *spreads = plain_cluster(poses, particles.weights, places, CLUSTER_M, CLUSTER_RAD)
    found = estimate_pose(particles)
    np.testing.assert_allclose([*found.pose[:2], found.share], [x, y, share], atol=1e-9)
    assert abs(wrap_angle(np.asarray(found.pose[2] - yaw))) < 1e-9
    np.testing.assert_allclose([found.spread_m, found.cluster_spread_m], spreads, atol=1e-9)


@given(weights, st.floats(0.0, 0.99))
def test_every_particle_is_drawn_as_often_as_its_weight_says_rounded_up_or_down(values, offset):
    share = np.array(values) / np.sum(values)
    count = 200
    indices = np.empty(count, dtype=np.int64)
    draw_low_variance(share, count, offset, indices)
    drawn = np.bincount(indices, minlength=share.size)
    assert (np.abs(drawn - share * count) < 1 + 1e-6).all()


@given(st.integers(0, 999), st.integers(1, 300), st.sampled_from([0.1, 2.0]))
def test_resampling_is_its_plain_twin(seed, n, wide):
    random = np.random.default_rng(seed)
    poses = random.normal(size=(n, 3)) * wide
    submaps, states = random.integers(-1, 3, (2, n)).astype(np.int32)
    particles = Particles(poses, random.dirichlet(np.ones(n)), submaps, states)
    settings = LocalizationSettings(min_particles=20, max_particles=400)
    drawn = resample(particles, settings, np.random.default_rng(seed))
    bins = plain_bins(poses, submaps, states, BIN_M, BIN_RAD)
    offsets = np.random.default_rng(seed).random(2)
    twin = plain_resample(particles.weights, bins, offsets, (settings.pf_err, settings.pf_z), 20, 400)
    assert drawn.poses.tolist() == poses[twin].tolist()
    assert drawn.submaps.tolist() == submaps[twin].tolist()
    assert drawn.states.tolist() == states[twin].tolist()
    np.testing.assert_allclose(drawn.weights, 1 / len(twin))


@given(st.integers(1, 3000))
def test_more_bins_never_ask_for_fewer_particles(bins):
    assert kld_count(bins + 1, 0.05, 0.99) >= kld_count(bins, 0.05, 0.99)
    assert kld_count(bins, 0.05, 0.99) == plain_kld_count(bins, 0.05, 0.99)


def test_a_wide_cloud_keeps_more_particles_than_a_narrow_one():
    settings, random = LocalizationSettings(min_particles=50, max_particles=2000), np.random.default_rng(0)
    wide = resample(make_particles(random.normal(size=(2000, 3)) * 20), settings, random)
    narrow = resample(make_particles(random.normal(size=(2000, 3)) * 0.01), settings, random)
    assert wide.count > 1000
    assert narrow.count < 200


def test_impossible_particles_get_no_weight_and_the_rest_sums_to_one():
    particles = reweigh(make_particles(np.zeros((3, 3))), np.array([-1e4, -1.0, -1.0]))
    np.testing.assert_allclose(particles.weights, [0.0, 0.5, 0.5])


def test_the_estimate_is_the_mean_of_the_heavier_cluster_also_across_the_seam_of_yaw():
    random = np.random.default_rng(3)
    heavy = np.array([5.0, 5.0, np.pi]) + 0.05 * random.normal(size=(700, 3))
    light = np.array([-5.0, 5.0, 0.0]) + 0.05 * random.normal(size=(300, 3))
    estimate = estimate_pose(make_particles(np.concatenate([heavy, light])))
    np.testing.assert_allclose(estimate.pose[:2], [5, 5], atol=0.02)
    assert abs(abs(estimate.pose[2]) - np.pi) < 0.02
    assert abs(estimate.share - 0.7) < 0.01
    assert estimate.share < ONE_MODE_SHARE


def test_states_count_as_different_bins():
    poses, none = np.zeros((100, 3)), np.full(100, -1, dtype=np.int32)
    settings = LocalizationSettings(min_particles=10, max_particles=500)
    plain = resample(Particles(poses, np.full(100, 0.01), none, none), settings, np.random.default_rng(0))
    states = (np.arange(100) % 50).astype(np.int32)
    mixed = Particles(poses, np.full(100, 0.01), none + 1, states)
    assert resample(mixed, settings, np.random.default_rng(0)).count > plain.count
