"""Twin of the likelihood field."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dynmap_cli.kernels.likelihood import field_log_likelihoods
from tests.reference.localization import plain_field_log_likelihood


@given(st.integers(0, 10_000), st.integers(1, 23), st.booleans())
def test_field_log_likelihoods_is_its_plain_twin(seed, n_beams, with_patch):
    random = np.random.default_rng(seed)
    rows, cols = 30, 40
    whole = random.normal(size=(rows, cols)).astype(np.float32)
    patch = random.normal(size=(6, 9)).astype(np.float32)
    pool = np.concatenate([whole.ravel(), patch.ravel()])
    cells = np.column_stack([random.uniform(-5, 45, 7), random.uniform(-5, 35, 7), random.uniform(-7, 7, 7)])
    poses = cells * (0.1, 0.1, 1.0) + (3.0, -2.0, 0.0)
    ends = random.uniform(-20, 20, (2, n_beams)).astype(np.float32)
    windows = np.zeros((7, 5), dtype=np.int32)
    if with_patch:
        windows[::2] = [8, 12, 6, 9, rows * cols]
    out = np.empty(7)
    cell, index = np.array([3.0, -2.0, 0.1]), np.empty(n_beams, np.int32)
    field_log_likelihoods(pool, rows, cols, cell, poses, ends, windows, index, out)
    for k in range(7):
        own = patch if windows[k, 2] else None
        expected = plain_field_log_likelihood((whole, own), windows[k], cells[k], ends.T.astype(float))
        borders = _nearest_border(cells[k], ends.T.astype(float))
        if borders > 1e-4:
            assert math.isclose(out[k], expected, abs_tol=1e-5)


def _nearest_border(pose, ends):
    c, s = math.cos(pose[2]), math.sin(pose[2])
    xy = np.stack([pose[0] + c * ends[:, 0] - s * ends[:, 1], pose[1] + s * ends[:, 0] + c * ends[:, 1]])
    return np.abs(xy - np.round(xy)).min()
