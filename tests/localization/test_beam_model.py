"""Reflectances of map and patches for the beam model."""

import numpy as np
import pytest

from dynmap_cli.domain.grid import FREE, OCCUPIED, UNKNOWN, CountingMap, GridFrame, OccupancyGrid
from dynmap_cli.domain.patches import Patch, PatchSet
from dynmap_cli.errors import ArtifactError
from dynmap_cli.localization.sensing.beam_model import PLAIN_REFLECTANCE, UNKNOWN_REFLECTANCE, with_beam_model
from dynmap_cli.localization.sensing.map_pool import make_map_pool
from dynmap_cli.localization.settings import LocalizationSettings

FRAME = GridFrame(0.1, -1.0, 2.0, 8, 10)


def grid_of(cells):
    return OccupancyGrid(FRAME, np.array(cells, dtype=np.int8))


def reflectance_of(pool, shape):
    """m of the whole map, without the margin."""
    whole = 1.0 - np.exp(pool.log_pass[: pool.frame.rows * pool.frame.cols].reshape(pool.frame.shape))
    return whole[10:-10, 10:-10][: shape[0], : shape[1]]


def test_a_run_says_how_often_each_cell_reflects_and_a_plain_map_only_what_is_occupied():
    random = np.random.default_rng(0)
    cells = random.choice([FREE, OCCUPIED, UNKNOWN], FRAME.shape)
    hits, passed = random.integers(0, 9, (2, *FRAME.shape)).astype(float)
    counted = CountingMap.of_grids(FRAME, hits, hits * 0, passed, np.zeros((*FRAME.shape, 2)))
    plain = make_map_pool(grid_of(cells), [], LocalizationSettings())
    with_counts = with_beam_model(plain, grid_of(cells), counted, [])
    m = counted.reflectance
    expected = np.minimum(np.where(np.isfinite(m), m, UNKNOWN_REFLECTANCE), 0.99)
    np.testing.assert_allclose(reflectance_of(with_counts, FRAME.shape), expected, atol=1e-6)
    without = reflectance_of(with_beam_model(plain, grid_of(cells), None, []), FRAME.shape)
    for value in (FREE, OCCUPIED):
        np.testing.assert_allclose(without[cells == value], PLAIN_REFLECTANCE[value], atol=1e-6)
    np.testing.assert_allclose(without[cells == UNKNOWN], UNKNOWN_REFLECTANCE, atol=1e-6)


def test_a_belief_mixes_the_reflectances_of_the_states():
    cells = np.full(FRAME.shape, FREE)
    values = np.full((2, 2, 3), 0.1, dtype=np.float32)
    values[1, 1, 1], values[0, 0, 0], values[:, 1, 2] = 0.9, np.nan, np.nan
    patches = tuple(Patch(k, 3, values[k]) for k in range(2))
    sets = [PatchSet(0, FRAME.window(3, 4, 2, 3), np.ones((2, 3), bool), patches, 0.9)]
    pool = with_beam_model(
        make_map_pool(grid_of(cells), sets, LocalizationSettings()), grid_of(cells), None, sets
    )
    pool.paint(0, np.array([0.25, 0.75]))
    m = reflectance_of(pool, FRAME.shape)
    np.testing.assert_allclose(m[4, 5], 0.25 * 0.1 + 0.75 * 0.9, atol=1e-6)
    np.testing.assert_allclose(m[3, 4], 0.1, atol=1e-6)
    np.testing.assert_allclose(m[4, 6], PLAIN_REFLECTANCE[FREE], atol=1e-6)


def test_reflectances_of_another_map_are_refused():
    grid = grid_of(np.full(FRAME.shape, FREE))
    other = GridFrame(0.1, -1.0, 2.0, 4, 4)
    counted = CountingMap.of_grids(other, *np.zeros((3, 4, 4)), np.zeros((4, 4, 2)))
    with pytest.raises(ArtifactError, match="dynmap map"):
        with_beam_model(make_map_pool(grid, [], LocalizationSettings()), grid, counted, [])
