"""The beam model beside Eq. 1.1 as printed."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dynmap_cli.kernels.beam_likelihood import beam_log_likelihoods
from tests.reference.localization import plain_beam_log_likelihood

CELL = np.array([2.0, -1.0, 0.1])
MODEL = (0.6, 0.02, 0.9)
OUTSIDE = 0.1


def weigh(log_pass, shape, poses, sensor, beams, windows):
    directions = np.array([[math.cos(b[0]) for b in beams], [math.sin(b[0]) for b in beams]])
    lengths, hits = np.array([b[1] for b in beams]), np.array([not b[2] for b in beams])
    model, out = np.array([*MODEL, math.log(1 - OUTSIDE)]), np.empty(len(poses))
    metres = np.array(poses) * (0.1, 0.1, 1.0) + (2.0, -1.0, 0.0)
    beam_log_likelihoods(
        log_pass, *shape, CELL, metres, np.array(sensor) * 0.1, directions, lengths, hits, windows, model, out
    )
    return out


@given(st.integers(0, 10_000), st.booleans())
@settings(max_examples=60)
def test_it_is_eq_1_1_as_printed(seed, with_patch):
    random = np.random.default_rng(seed)
    shape = (17, 23)
    m = random.choice([0.0, 0.01, 0.02, 0.3, 0.9], shape, p=[0.3, 0.3, 0.2, 0.1, 0.1])
    patch = random.uniform(0, 0.9, (5, 6))
    pool = np.log1p(-np.concatenate([m.ravel(), patch.ravel()])).astype(np.float32)
    windows = np.zeros((1, 5), dtype=np.int32)
    if with_patch:
        windows[0] = [4, 7, 5, 6, m.size]
        m = m.copy()
        m[4:9, 7:13] = patch
    poses = [tuple(random.uniform((1, 1, -7), (22, 16, 7))) for _ in range(3)]
    sensor = random.uniform(-0.5, 0.5, 2)
    beams = [
        (random.uniform(-4, 4), random.choice([0.2, 3.0, 9.0, 30.0]) * random.uniform(0.5, 1), k % 5 == 4)
        for k in range(40)
    ]
    out = weigh(pool, shape, poses, sensor, beams, windows)
    cells = {(row, col): float(m[row, col]) for row in range(shape[0]) for col in range(shape[1])}
    for k, pose in enumerate(poses):
        twin = plain_beam_log_likelihood(cells, pose, sensor, beams, *MODEL, OUTSIDE)
        assert abs(out[k] - twin) < 2e-4


def test_straight_and_diagonal_beams_are_no_special_case():
    shape, m = (12, 12), np.full((12, 12), 0.2)
    m[:, 9] = m[9, :] = 0.8
    pool = np.log1p(-m.ravel()).astype(np.float32)
    beams = [(k * math.pi / 4, 5.2, False) for k in range(8)]
    cells = {(row, col): float(m[row, col]) for row in range(12) for col in range(12)}
    for pose in ((6.5, 6.4, 0.0), (6.25, 6.25, math.pi / 2)):
        twin = plain_beam_log_likelihood(cells, pose, (0, 0), beams, *MODEL, OUTSIDE)
        out = weigh(pool, shape, [pose], (0, 0), beams, np.zeros((1, 5), np.int32))
        assert abs(out[0] - twin) < 0.02


def test_no_beam_counts_for_less_than_the_floor_also_outside_the_map():
    pool = np.log1p(-np.full(100, 0.99)).astype(np.float32)
    beams = [(0.1, 8.0, False), (2.0, 8.0, True)]
    poses = [(5.0, 5.0, 0.0), (-50.0, 5.0, 0.0), (5.0, 1e6, 0.0)]
    out = weigh(pool, (10, 10), poses, (0, 0), beams, np.zeros((1, 5), np.int32))
    np.testing.assert_allclose(out, 2 * math.log(MODEL[1]), atol=1e-6)


def test_a_beam_through_a_wall_is_unlikely_where_the_likelihood_field_sees_nothing():
    m = np.full((20, 20), 0.01)
    m[:, 15] = 0.9
    shut, opened = m.copy(), m
    shut[:, 8] = 0.9
    beams = [(a, 12.5, False) for a in np.linspace(-0.1, 0.1, 9)]
    logs = [
        weigh(
            np.log1p(-w.ravel()).astype(np.float32),
            w.shape,
            [(3.0, 10.0, 0.0)],
            (0, 0),
            beams,
            np.zeros((1, 5), np.int32),
        )[0]
        for w in (shut, opened)
    ]
    assert logs[1] > logs[0] + 9.0
