"""Scans with the poses of a map, and with the times of their beams as the map found them."""

from dataclasses import replace

import numpy as np
import pytest

from dynmap_cli.domain.poses import Trajectory
from dynmap_cli.domain.scans import single_laser_log
from dynmap_cli.errors import ArtifactError
from dynmap_cli.files.registered import (
    BEAM_INTERVALS,
    MOUNTINGS,
    read_registered,
    write_mountings,
    write_registered,
)
from dynmap_cli.files.scan_log import write_scan_log

STAMPS = np.arange(4) * 10**9
POSES = np.arange(12, dtype=float).reshape(4, 3) / 10.0


@pytest.fixture
def folders(tmp_path):
    """A recording whose sweeps run the other way than it says."""
    for name in ("scans", "map"):
        (tmp_path / name).mkdir()
    log = single_laser_log(
        STAMPS, np.ones((4, 3), np.float32), np.array([-1.0, 0.0, 1.0]), POSES, beam_interval_s=0.001
    )
    write_scan_log(tmp_path / "scans", log)
    write_registered(tmp_path / "map", Trajectory(STAMPS, POSES), -log.beam_interval_s)
    return tmp_path


def test_what_the_map_found_is_given_back(folders):
    log, trajectory = read_registered(folders / "scans", folders / "map")
    assert log.beam_interval_s.tolist() == [-0.001]
    np.testing.assert_allclose(trajectory.poses, POSES, atol=1e-6)


def test_a_map_of_other_scans_is_refused(folders):
    log, _ = read_registered(folders / "scans", folders / "map")
    later = replace(log, stamps_ns=STAMPS + 1, ranges_m=np.array(log.ranges_m))
    write_scan_log(folders / "scans", later)
    with pytest.raises(ArtifactError, match="not the trajectory of these scans"):
        read_registered(folders / "scans", folders / "map")


@pytest.mark.parametrize("intervals", [np.array([np.nan]), np.zeros(2), np.zeros(1, np.float32)])
def test_damaged_intervals_are_refused(intervals, folders):
    np.save(folders / "map" / BEAM_INTERVALS, intervals)
    with pytest.raises(ArtifactError, match="not a readable table of beam intervals"):
        read_registered(folders / "scans", folders / "map")


def test_mountings_of_the_map_stand_for_those_of_the_recording(folders):
    log, _ = read_registered(folders / "scans", folders / "map")
    assert log.sensor_poses.tolist() == [[0.0, 0.0, 0.0]]
    write_mountings(folders / "map", np.array([[0.1, 0.2, 0.3]]))
    log, _ = read_registered(folders / "scans", folders / "map")
    assert log.sensor_poses.tolist() == [[0.1, 0.2, 0.3]]


def test_damaged_mountings_are_refused(folders):
    np.save(folders / "map" / MOUNTINGS, np.full((1, 3), np.nan))
    with pytest.raises(ArtifactError, match="not a readable table of sensor poses"):
        read_registered(folders / "scans", folders / "map")
