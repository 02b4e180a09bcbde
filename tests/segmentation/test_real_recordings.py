"""Real recordings with given poses: a museum with visitors, and a nearly static building as the control."""

import pytest

from dynmap_cli.counting.frames import frame_of_scans
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from dynmap_cli.segmentation.finding import find_submaps
from dynmap_cli.segmentation.settings import SegmentationSettings

pytestmark = pytest.mark.real


@pytest.mark.parametrize("name", ["fhw", "seattle"])
def test_visitors_and_noise_make_no_submap_where_each_place_is_seen_twice_at_most(name, real_data):
    path = real_data / "corrected" / f"{name}-corrected.log.gz"
    log, _ = read_recordings([path], IngestSettings())
    poses = log.odometry.copy()
    frame = frame_of_scans(log, poses, 30.0, 0.05)
    submaps, found = find_submaps(log, poses, frame, SegmentationSettings())
    assert submaps == ()
    assert found.windows.count > 35
    assert (found.standing == 1).sum() > 2000
