"""Laws of noise that is spread evenly over the particles."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dynmap_cli.kernels.particles import places_on_curve, spread_normals
from dynmap_cli.localization.particles.spread_noise import (
    hilbert_curve,
    lattice_steps,
    normal_quantiles,
    spread_noise,
)
from tests.reference.localization import plain_places_on_curve, plain_spread_normals


def test_the_curve_comes_through_every_cell_once_and_goes_from_neighbour_to_neighbour():
    curve = hilbert_curve()
    cells = np.array(np.unravel_index(np.argsort(curve.ravel()), curve.shape)).T
    assert sorted(curve.ravel().tolist()) == list(range(curve.size))
    assert (np.abs(np.diff(cells, axis=0)).sum(axis=1) == 1).all()


@given(st.integers(0, 999), st.integers(1, 60))
def test_places_and_noise_are_their_plain_twins(seed, n):
    random = np.random.default_rng(seed)
    poses = random.normal(size=(n, 3)) * (0.3, 0.1, 0.05) + (7.0, -3.0, math.pi)
    places = np.empty(n, np.uint16)
    places_on_curve(poses, hilbert_curve(), places)
    assert places.tolist() == plain_places_on_curve(poses, hilbert_curve())
    order, offsets, noise = random.permutation(n), random.random(4), np.empty((4, n))
    spread_normals(order, lattice_steps(), offsets, normal_quantiles(), noise)
    np.testing.assert_allclose(noise, plain_spread_normals(order, lattice_steps(), offsets), atol=1e-3)


def test_it_is_standard_normal_and_independent_of_the_pose_of_a_particle():
    random = np.random.default_rng(1)
    poses = random.normal(size=(20, 3))
    draws = np.stack([spread_noise(poses, random) for _ in range(4000)])
    np.testing.assert_allclose(draws.mean(axis=0), 0.0, atol=0.08)
    np.testing.assert_allclose(draws.std(axis=0), 1.0, atol=0.06)
    crossed = np.einsum("dik,djk->ij", draws, draws) / (4000 * 20)
    np.testing.assert_allclose(crossed, np.eye(4), atol=0.12)


def test_means_over_all_particles_and_over_those_of_one_place_are_nearer_to_zero_than_of_independent_draws():
    random = np.random.default_rng(2)
    poses = random.normal(size=(500, 3))
    draws = np.stack([spread_noise(poses, random) for _ in range(200)])
    assert np.sqrt(np.square(draws.mean(axis=2)).mean()) < 0.5 / math.sqrt(500)
    ahead = poses[:, 0] > 0.5
    of_some = draws[:, :, ahead].mean(axis=2)
    assert np.sqrt(np.square(of_some).mean()) < 0.85 / math.sqrt(ahead.sum())
