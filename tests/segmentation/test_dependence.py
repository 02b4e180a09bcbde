"""Regions that change together."""

from types import SimpleNamespace

import numpy as np

from dynmap_cli.domain.grid import FREE, OCCUPIED
from dynmap_cli.segmentation.dependence import dependent_regions
from dynmap_cli.segmentation.regions import RegionParams, merge_regions
from dynmap_cli.segmentation.windows import WindowRecord


def test_places_that_one_box_takes_in_turn_depend_and_two_doors_do_not():
    cells = np.array(
        [[row, 20 * region + col] for region in range(3) for row in range(3) for col in range(3)]
    )
    index = np.full((10, 60), -1)
    index[cells[:, 0], cells[:, 1]] = np.arange(27)
    record = WindowRecord(27)
    at_first = np.array([1, 0, 0, 1, 1, 0, 1, 0, 0, 1, 0, 1], dtype=bool)
    door_open = np.array([1, 1, 0, 0, 1, 0, 0, 1, 0, 1, 1, 0], dtype=bool)
    for first, is_open in zip(at_first, door_open, strict=True):
        states = np.repeat([OCCUPIED if seen else FREE for seen in (first, not first, is_open)], 9).astype(
            np.int8
        )
        record.add(np.arange(27), states)
    found = SimpleNamespace(surface=SimpleNamespace(cells=cells, index=index), record=record)
    regions = [cells[:9], cells[9:18], cells[18:]]
    dependent = dependent_regions(found, regions, 6)
    assert dependent[0, 1]
    assert dependent[1, 0]
    assert not dependent[2, :2].any()
    params = RegionParams(growth=3, min_cells=6, margin=2, max_area=2000.0, reach=100.0)
    standing = np.zeros((10, 60), dtype=np.int8)
    assert merge_regions(regions, standing, params, dependent) == [[2], [0, 1]]
    assert merge_regions(regions, standing, params) == [[0, 1, 2]]
