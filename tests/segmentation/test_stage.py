"""Areas that change, end to end on small simulated corridors."""

from dataclasses import replace

import numpy as np
import pytest

from dynmap_cli.counting.looks import time_windows
from dynmap_cli.errors import ConfigError
from dynmap_cli.segmentation.finding import find_submaps
from dynmap_cli.segmentation.settings import SegmentationSettings
from dynmap_cli.segmentation.stage import describe
from tests.segmentation.worlds import corridor, shifted_poses, two_doors

SETTINGS = SegmentationSettings()


def inside(submap, x, y):
    row, col = submap.frame.to_cells(np.array([x, y]))
    return 0 <= row < submap.frame.rows and 0 <= col < submap.frame.cols


@pytest.fixture(scope="module")
def doors():
    return corridor(doors=two_doors())


@pytest.mark.parametrize(("sigma_m", "sigma_deg"), [(0.0, 0.0), (0.02, 0.2)])
def test_two_doors_make_two_submaps(doors, sigma_m, sigma_deg):
    run, frame = doors
    submaps, _ = find_submaps(run.log, shifted_poses(run, sigma_m, sigma_deg), frame, SETTINGS)
    assert len(submaps) == 2
    assert inside(submaps[0], 3.5, 0.0)
    assert inside(submaps[1], 7.5, 2.0)
    assert all(submap.area_m2 < 1.5 for submap in submaps)
    assert describe(submaps)[0].startswith("2 sub-maps, 1.")


@pytest.mark.parametrize(("sigma_m", "sigma_deg"), [(0.0, 0.0), (0.02, 0.2)])
def test_a_static_log_gives_no_submap(sigma_m, sigma_deg):
    run, frame = corridor()
    submaps, _ = find_submaps(run.log, shifted_poses(run, sigma_m, sigma_deg), frame, SETTINGS)
    assert submaps == ()
    assert describe(submaps) == ["no sub-map: no area was seen in two states well enough"]


def test_people_who_walk_or_stand_for_a_minute_make_none():
    walker = {"does": "walk", "path": [[1, 0.5], [11, 0.6]]}
    stander = {"does": "stand", "at": [9.5, 1.6], "from_s": 5, "to_s": 55}
    run, frame = corridor(movers=[walker, stander])
    submaps, _ = find_submaps(run.log, run.true_poses, frame, SETTINGS)
    assert submaps == ()


def test_windows_end_with_the_recording_and_after_their_time():
    run, _ = corridor(repeat=2)
    windows = time_windows(run.log, 30.0)
    stamps = run.log.stamps_ns
    assert [w.start for w in windows[1:]] == [w.stop for w in windows[:-1]]
    assert windows[-1].stop == run.log.n_scans
    assert all(stamps[w][-1] - stamps[w][0] < 30e9 for w in windows)
    index = (np.arange(run.log.n_scans) >= 100).astype(np.int32)
    two = replace(
        run.log, recording_index=index, recordings=("a", "b"), drive_of_recording=np.zeros(2, np.int32)
    )
    assert 100 in [w.start for w in time_windows(two, 30.0)]
    assert time_windows(run.log.select(slice(0, 0)), 30.0) == []


def test_a_cap_below_one_cell_with_margin_is_refused():
    run, frame = corridor(repeat=1)
    with pytest.raises(ConfigError, match="max_area_m2: 1 is less than one cell"):
        find_submaps(run.log, run.true_poses, frame, SegmentationSettings(max_area_m2=1.0, margin_m=2.0))
