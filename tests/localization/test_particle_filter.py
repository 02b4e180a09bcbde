"""Laws of weighing, resampling and the estimate."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dynmap_cli.localization.particle_filter import (
    Particles,
    estimate_pose,
    kld_count,
    low_variance_draw,
    make_particles,
    resample,
    reweigh,
)
from dynmap_cli.localization.settings import LocalizationSettings
from tests.reference.localization import plain_low_variance

weights = st.lists(st.floats(0.01, 1.0), min_size=1, max_size=30)


@given(weights, st.integers(1, 60), st.floats(0.0, 0.99))
def test_the_comb_is_its_plain_twin(values, count, offset):
    drawn = low_variance_draw(np.array(values), count, offset)
    assert drawn.tolist() == plain_low_variance(values, count, offset)


@given(weights, st.floats(0.0, 0.99))
def test_every_particle_is_drawn_as_often_as_its_weight_says_rounded_up_or_down(values, offset):
    share = np.array(values) / np.sum(values)
    count = 200
    drawn = np.bincount(low_variance_draw(share, count, offset), minlength=share.size)
    assert (np.abs(drawn - share * count) < 1 + 1e-6).all()


@given(st.integers(1, 3000))
def test_more_bins_never_ask_for_fewer_particles(bins):
    settings = LocalizationSettings()
    assert kld_count(bins + 1, settings) >= min(kld_count(bins, settings), 10**9) or bins == 1


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
    assert not estimate.is_one_mode


def test_states_count_as_different_bins():
    poses, none = np.zeros((100, 3)), np.full(100, -1, dtype=np.int32)
    settings = LocalizationSettings(min_particles=10, max_particles=500)
    plain = resample(Particles(poses, np.full(100, 0.01), none, none), settings, np.random.default_rng(0))
    states = (np.arange(100) % 50).astype(np.int32)
    mixed = Particles(poses, np.full(100, 0.01), none + 1, states)
    assert resample(mixed, settings, np.random.default_rng(0)).count > plain.count
