"""Key scans are fitted on their own local map, on those before and after them, and on those of other visits."""

import numpy as np
import pytest

from dynmap_cli.domain.poses import compose
from dynmap_cli.mapping.back_end import _DENSE_PARTNERS, _DENSE_REACH_M, _dense_pairs
from dynmap_cli.mapping.local_maps import _members
from dynmap_cli.mapping.places import SAME_VISIT

STEP_M = 0.15


def driven(n_keys, keys_per_lap):
    """Key scans on a circle that is driven round several times, and the local maps of them."""
    poses = np.zeros((n_keys, 3))
    for k in range(1, n_keys):
        poses[k] = compose(poses[k - 1], np.array([STEP_M, 0.0, 2 * np.pi / keys_per_lap]))
    anchors, members = zip(*_members(np.zeros(n_keys, dtype=np.int32)), strict=True)
    return poses, np.array(anchors), members


@pytest.mark.parametrize("keys_per_lap", [200, 400, 10_000])
def test_a_key_scan_is_part_of_only_one_of_its_maps_and_that_is_its_own(keys_per_lap):
    poses, anchors, members = driven(1000, keys_per_lap)
    pairs = _dense_pairs(poses, anchors)
    for anchor, nodes, part in zip(anchors, pairs, members, strict=True):
        assert (np.isin(nodes, part) == (np.abs(nodes - anchor) <= 5)).all()
        assert np.unique(nodes).size == nodes.size


@pytest.mark.parametrize("keys_per_lap", [400, 10_000])
def test_each_key_scan_is_fitted_on_a_map_before_and_one_after_it(keys_per_lap):
    poses, anchors, _ = driven(1000, keys_per_lap)
    pairs = _dense_pairs(poses, anchors)
    for node in range(30, 970):
        near = [anchor for anchor, nodes in zip(anchors, pairs, strict=True) if node in nodes]
        near = [anchor - node for anchor in near if 10 < abs(anchor - node) <= 25]
        assert min(near) < 0 < max(near)


def test_other_visits_are_a_few_within_reach_and_not_neighbours():
    poses, anchors, _ = driven(2000, 400)
    pairs = _dense_pairs(poses, anchors)
    for node in range(1000, 1900, 7):
        numbers = [number for number, nodes in enumerate(pairs) if node in nodes]
        distances = np.linalg.norm(poses[anchors[numbers], :2] - poses[node, :2], axis=1)
        own = int(np.argmin(np.abs(anchors - node)))
        others = [number for number in numbers if abs(number - own) > SAME_VISIT]
        assert distances.max() < _DENSE_REACH_M
        assert 1 <= len(others) < _DENSE_PARTNERS
        assert all(abs(a - b) > SAME_VISIT for a in others for b in others if a != b)


def test_maps_out_of_reach_are_left_out():
    """A robot that was carried far between two key scans."""
    poses, anchors, _ = driven(100, 10_000)
    poses[50:, 0] += 100.0
    pairs = _dense_pairs(poses, anchors)
    for anchor, nodes in zip(anchors, pairs, strict=True):
        others = nodes[np.abs(nodes - anchor) > 5]
        assert ((others < 50) == (anchor < 50)).all()
