"""Which groups of contested cells count."""

from dataclasses import replace

import numpy as np
import pytest

from dynmap_cli.segmentation.finding import find_submaps
from dynmap_cli.segmentation.groups import _long_runs, changed_as_one
from dynmap_cli.segmentation.settings import SegmentationSettings
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
    places = middle + np.column_stack([away, np.zeros(away.size)])
    found = replace(found, windows=replace(found.windows, places_m=places))
    assert (len(changed_as_one(found, [cells], 6)) == 1) == is_change


@pytest.mark.parametrize(("from_s", "to_s"), [(22, 38), (80, 100)])
def test_who_stands_across_the_border_of_two_windows_is_no_change(from_s, to_s):
    movers = [{"does": "stand", "at": [7.2, 1.4], "count": 2, "from_s": from_s, "to_s": to_s}]
    run, frame = corridor(movers=movers)
    submaps, _ = find_submaps(run.log, run.true_poses, frame, SegmentationSettings())
    assert submaps == ()


def test_a_run_of_windows_counts_as_one_less_than_its_length():
    seen = np.array([[1, 1, 0, 1, 1, 1, 0, 1], [1, 0, 1, 0, 1, 0, 1, 0]], dtype=bool).T
    follows = np.ones(8, dtype=bool)
    assert _long_runs(seen, follows).tolist() == [2, 0]
    follows[1] = False
    assert _long_runs(seen, follows).tolist() == [1, 0]
