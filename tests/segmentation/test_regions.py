"""Growing, cutting and merging: laws about the cap, the sight and the order."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.segmentation.regions import (
    RegionParams,
    box_around,
    grow_components,
    make_submaps,
    merge_regions,
)

PARAMS = RegionParams(growth=3, min_cells=3, margin=2, max_area=400.0, reach=60.0)


def contested_cells(seed, share=0.02, shape=(70, 80)):
    return np.random.default_rng(seed).random(shape) < share


def blobs(*corners, shape=(60, 60), size=3):
    grid = np.zeros(shape, dtype=bool)
    for row, col in corners:
        grid[row : row + size, col : col + size] = True
    return grid


@settings(max_examples=20)
@given(st.integers(0, 10_000), st.floats(0.001, 0.15), st.floats(30.0, 2000.0))
def test_no_submap_ever_exceeds_the_cap_and_none_shares_a_contested_cell(seed, share, max_area):
    params = replace(PARAMS, max_area=max_area)
    contested = contested_cells(seed, share)
    components = grow_components(contested, params)
    groups = merge_regions(components, np.zeros(contested.shape, dtype=np.int8), params)
    assert sorted(k for group in groups for k in group) == list(range(len(components)))
    cells = [np.concatenate([components[k] for k in group]) for group in groups]
    frame = GridFrame(0.05, -1.0, 2.0, *contested.shape)
    submaps = make_submaps(cells, frame, params.margin)
    assert all(submap.area_m2 <= max_area * 0.05**2 + 1e-9 for submap in submaps)
    count, owners = np.zeros(contested.shape, dtype=int), np.zeros(contested.shape, dtype=int)
    for submap in submaps:
        where = np.s_[
            submap.row : submap.row + submap.frame.rows, submap.col : submap.col + submap.frame.cols
        ]
        count[where] += submap.contested
        owners[where] += submap.owned
        assert submap.owned[submap.contested].all()
        assert submap.frame.origin_x_m == frame.window(submap.row, submap.col, 1, 1).origin_x_m
    assert count.max(initial=0) <= 1
    assert owners.max(initial=0) <= 1
    assert not (count.astype(bool) & ~contested).any()


def test_cells_grow_together_up_to_twice_the_growth():
    assert len(grow_components(blobs((10, 10), (10, 19)), PARAMS)) == 1
    assert len(grow_components(blobs((10, 10), (10, 21)), PARAMS)) == 2
    assert grow_components(blobs((10, 10), size=1), PARAMS) == []


def test_a_component_over_the_cap_is_cut_at_its_widest_gap():
    contested = np.zeros((20, 80), dtype=bool)
    contested[10, 5:70] = True
    contested[10, 30:34] = False
    parts = grow_components(contested, replace(PARAMS, growth=1, max_area=200.0))
    assert sorted((part[:, 1].min(), part[:, 1].max()) for part in parts)[0][1] <= 29
    whole = grow_components(contested, replace(PARAMS, growth=3, max_area=10_000.0))
    assert len(whole) == 1
    assert all(box_around(part, 2).area <= 200 for part in parts)


def test_regions_merge_when_they_see_each_other_and_not_through_a_wall():
    components = grow_components(blobs((10, 10), (10, 22)), PARAMS)
    nothing = np.zeros((60, 60), dtype=np.int8)
    assert merge_regions(components, nothing, PARAMS) == [[0, 1]]
    wall = nothing.copy()
    wall[:, 17] = 1
    assert merge_regions(components, wall, PARAMS) == [[0], [1]]
    assert merge_regions(components, nothing, replace(PARAMS, max_area=60.0)) == [[0], [1]]


def test_the_cheapest_pair_merges_first():
    components = grow_components(blobs((10, 10), (10, 21), (10, 35)), PARAMS)
    groups = merge_regions(components, np.zeros((60, 60), dtype=np.int8), replace(PARAMS, max_area=170.0))
    assert groups == [[2], [0, 1]]


def test_every_pair_of_a_group_is_mutually_visible():
    components = grow_components(blobs((10, 10), (10, 21), (21, 10)), PARAMS)
    wall = np.zeros((60, 60), dtype=np.int8)
    wall[13:21, 13:21] = np.eye(8, dtype=np.int8)[::-1] | np.eye(8, dtype=np.int8)
    wall[13:21, 13:21] = 1
    groups = merge_regions(components, wall, replace(PARAMS, max_area=2000.0))
    assert [1, 2] not in groups
    assert sorted(map(len, groups)) == [1, 2]


def test_no_contradiction_no_submap():
    assert grow_components(np.zeros((10, 10), dtype=bool), PARAMS) == []
    assert merge_regions([], np.zeros((10, 10), dtype=np.int8), PARAMS) == []
    assert make_submaps([], GridFrame(0.05, 0.0, 0.0, 10, 10), 4) == ()
