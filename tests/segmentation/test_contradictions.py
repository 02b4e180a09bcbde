"""Which groups of contested cells count."""

from dataclasses import replace

import numpy as np
import pytest

from dynmap_cli.segmentation.settings import SegmentationSettings
from dynmap_cli.segmentation.stage import find_submaps
from tests.segmentation.worlds import corridor, two_doors


@pytest.mark.parametrize(("farther", "is_change"), [(1.0, True), (1.4, True), (1.6, False)])
def test_what_is_free_only_from_much_farther_away_is_no_change(farther, is_change):
    run, frame = corridor(doors=two_doors()[:1])
    _, found = find_submaps(run.log, run.true_poses, frame, SegmentationSettings())
    cells = np.argwhere(found.contested)
    group_of = np.full(found.surface.cells.shape[0], -1)
    group_of[found.surface.index[cells[:, 0], cells[:, 1]]] = 0
    occupied, free = found.record.cells_shown(group_of, 1)[..., 0]
    assert not ((free >= 3) & (occupied >= 6)).any()
    middle = (cells.mean(axis=0)[::-1] + 0.5) * frame.resolution_m + [frame.origin_x_m, frame.origin_y_m]
    away = np.where(free > 0, 2.0 * farther, 2.0)
    found = replace(found, places_m=middle + np.column_stack([away, np.zeros(away.size)]))
    assert (len(found.changed_as_one([cells], 6)) == 1) == is_change
