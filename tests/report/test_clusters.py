"""The picture of the clustering: a row per round, the same bytes each time."""

import numpy as np

from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.patches import Patch, PatchSet
from dynmap_cli.report.clusters import draw_clusters
from dynmap_cli.report.ink import CHANGING

FRAME = GridFrame(0.05, 0.0, 0.0, 6, 8)


def example():
    still = np.zeros(FRAME.shape, dtype=np.float32)
    still[0], still[5, 5] = 0.9, np.nan
    varying = np.zeros(FRAME.shape, dtype=bool)
    varying[3, 2:6] = True
    patch_set = PatchSet(3, FRAME, varying, (Patch(0, 3, still),), 0.9, (-20.0, -8.0, -9.5))
    rounds = []
    for values in ([0.5], [1.0, 0.0], [1.0, np.nan]):
        means = np.full((len(values), *FRAME.shape), np.nan, dtype=np.float32)
        means[:, varying] = np.array(values)[:, None]
        rounds.append(means)
    return patch_set, rounds


def test_each_round_is_a_row_and_the_largest_bic_is_marked():
    picture = np.asarray(draw_clusters(*example()))
    again = np.asarray(draw_clusters(*example()))
    assert np.array_equal(picture, again)
    full = (picture == CHANGING).all(axis=2)
    tiles = full[:, 500:]
    heights = [tiles[top : top + 60].sum() for top in (8, 76, 144)]
    # Round 1 shows half the colour, rounds 2 and 3 one full cluster of four cells; round 2 has frames, too.
    assert heights[0] == 0
    assert heights[1] > heights[2] == 4 * 10 * 10
