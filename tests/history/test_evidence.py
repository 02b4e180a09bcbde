"""The evidence that is counted again on a sub-map is that which segmentation counted on the whole map."""

import numpy as np
import pytest

from dynmap_cli.history.evidence import evidence_of
from dynmap_cli.segmentation.finding import evidence_params, find_submaps
from dynmap_cli.segmentation.settings import SegmentationSettings
from tests.segmentation.worlds import corridor, shifted_poses, two_doors


@pytest.mark.parametrize(
    "settings",
    [SegmentationSettings(), SegmentationSettings(support_cells=2, margin_m=0.0, window_s=20.0)],
)
def test_each_contested_cell_was_seen_in_the_same_windows(settings):
    run, frame = corridor(doors=two_doors())
    poses = shifted_poses(run, 0.01, 0.1)
    submaps, found = find_submaps(run.log, poses, frame, settings)
    assert len(submaps) == 2
    for submap in submaps:
        evidence = evidence_of(run.log, poses, submap, settings.window_s, evidence_params(settings))
        rows, cols = submap.frame.shape
        window = (slice(submap.row, submap.row + rows), slice(submap.col, submap.col + cols))
        np.testing.assert_array_equal(evidence.occupied, found.occupied[window][submap.contested])
        np.testing.assert_array_equal(evidence.free, found.free[window][submap.contested])
        assert min(evidence.occupied.min(), evidence.free.min()) >= found.windows_needed
        assert sum(one.occupied for one in evidence.windows) == evidence.occupied.sum()
        assert sum(one.free for one in evidence.windows) == evidence.free.sum()
        assert all(one.start_ns <= one.end_ns for one in evidence.windows)
        assert all(one.hits > 0 for one in evidence.windows if one.occupied)
        assert all(one.passed_cells > 0 for one in evidence.windows if one.free)
