"""The cells of a spot say one thing together."""

import numpy as np

from dynmap_cli.clustering.local_maps import LocalMaps, varying_vectors
from dynmap_cli.clustering.spots import join_spots
from dynmap_cli.domain.grid import FREE, OCCUPIED, UNKNOWN


def test_a_spot_is_taken_empty_or_unknown_as_a_whole():
    states = np.full((4, 12, 30), FREE, dtype=np.int8)
    recurring = np.zeros((12, 30), dtype=bool)
    recurring[3:9, 2:8] = recurring[3:9, 20:26] = True
    states[0, 4, 3:6] = OCCUPIED
    states[1, 7, 21] = OCCUPIED
    states[2, 3:9, 2:5] = UNKNOWN
    maps = LocalMaps(states, np.zeros(states.shape, dtype=np.float32), np.zeros(4, dtype=bool))
    joined = join_spots(maps, recurring).states
    left, right = joined[:, 3:9, 2:8], joined[:, 3:9, 20:26]
    assert [np.unique(one).tolist() for one in left] == [[OCCUPIED], [FREE], [UNKNOWN], [FREE]]
    assert [np.unique(one).tolist() for one in right] == [[FREE], [UNKNOWN], [FREE], [FREE]]
    np.testing.assert_array_equal(joined[:, ~recurring], states[:, ~recurring])
    vectors = varying_vectors(join_spots(maps, recurring), np.ones((12, 30), dtype=bool), recurring, 6)
    assert vectors.n_components == 1
    assert join_spots(maps, None) is maps
