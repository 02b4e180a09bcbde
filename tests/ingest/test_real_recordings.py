"""Real recordings: what is found in each, and that projected scans draw a crisp picture only as they are mounted."""

from dataclasses import replace

import numpy as np
import pytest

from dynmap_cli.domain.poses import compose
from dynmap_cli.errors import LogError
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings

pytestmark = pytest.mark.real

FOUND = {
    # path: (scans, beams, used lasers, pose of the first, odometry, path m, policy of the first)
    "benchmark/fr079.clf.bz2": (4934, 360, ["FLASER"], (-0.04, 0, 0), "FLASER", 391.6, "ignore"),
    "benchmark/mit-csail.clf.bz2": (1988, 361, ["FLASER"], (0, 0, 0), "FLASER", 373.6, "ignore"),
    "benchmark/intel.clf.bz2": (13631, 180, ["FLASER"], (0, 0, 0), "FLASER", 508.4, "ignore"),
    "corrected/fhw-corrected.log.gz": (488, 180, ["FLASER"], (0, 0, 0), "FLASER", 405.5, "ignore"),
    "corrected/seattle-corrected.log.gz": (241, 361, ["FLASER"], (0, 0, 0), "FLASER", 190.2, "ignore"),
    "corrected/freiburg-campus-corrected.log.gz": (2008, 360, ["FLASER"], (0, 0, 0), "FLASER", 1754.4, "free"),
    "wean/robotdata1.log.gz": (713, 180, ["L"], (0.25, 0, 0), "L", 41.2, "ignore"),
    "wean/robotdata2.log.gz": (2251, 180, ["L"], (0.25, 0, 0), "L", 87.2, "ignore"),
    "wean/robotdata4.log.gz": (600, 180, ["L"], (0.25, 0, 0), "L", 21.5, "ignore"),
    "bags/general_tracking_moving_1.bag.zip": (
        873, 768, ["/scan"], (0.850, 0.235, 0.7348), "tf odom -> base_link", 109.7, "ignore",
    ),
    "bags/jarvis_complex_path_fast.bag": (
        590, 1440, ["/driver_laser_navigation/laser_scan"], (0.194, 0, 0), "tf odom -> base_footprint", 17.9, "ignore",
    ),
    "bags/guardian_controller_2.bag": (
        2054, 681, ["/hokuyo_back_scan", "/scan"], (-0.432, 0, np.pi), "tf odom -> base_footprint", 21.3, "ignore",
    ),
    "bags/guardian_tilting_laser.bag": (
        418, 681, ["/guardian/laser_horizontal_back"], (-0.432, 0, np.pi), "tf odom -> base_footprint", 2.3, "ignore",
    ),
    "bags/two_robots.bag": (388, 360, ["/scan"], (-0.1385, 0, 0), "none", 0.0, "free"),
    "bags/intersection.bag": (85, 360, ["/scan"], (0, 0, 0), "none", 0.0, "free"),
    "bags/turtlebot4_mac": (356, 720, ["/scan"], (0.004, 0, np.pi / 2), "tf odom -> base_link", 8.3, "ignore"),
    "bags/neato_left_side.bag": (174, 361, ["/scan"], (-0.102, 0, np.pi), "tf odom -> base_link", 4.8, "ignore"),
    "bags/neato_middle.bag": (184, 361, ["/scan"], (-0.102, 0, np.pi), "tf odom -> base_link", 4.9, "ignore"),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("path", FOUND)
def test_what_is_found_in_a_real_recording(path, real_data):
    scans, beams, lasers, pose, odometry, path_m, policy = FOUND[path]
    log, report = read_recordings([real_data / path], IngestSettings())
    used = [laser for laser in report.lasers if laser.used]
    assert log.ranges_m.shape == (scans, beams)
    assert [laser.name for laser in used] == lasers
    np.testing.assert_allclose(used[0].pose[:2], pose[:2], atol=1e-3)
    assert abs(np.angle(np.exp(1j * (used[0].pose[2] - pose[2])))) < 1e-3
    assert report.odometry == odometry
    assert report.odometry_path_m == pytest.approx(path_m, abs=0.1)
    assert used[0].no_return == policy


def blur(log, turn_rad=0.0, mirror=1.0):
    """Entropy of the end points over cells of 10 cm: low where scans agree."""
    sensors = log.sensor_poses.copy()
    sensors[:, 2] += turn_rad
    sensors = compose(log.odometry, sensors[log.geometry_index])
    angle = sensors[:, 2, None] + mirror * log.bearings_rad[log.geometry_index]
    x = sensors[:, 0, None] + log.ranges_m * np.cos(angle)
    y = sensors[:, 1, None] + log.ranges_m * np.sin(angle)
    known = np.isfinite(x)
    cells = np.floor(np.column_stack([x[known], y[known]]) / 0.1).astype(np.int64)
    _, counts = np.unique(cells @ [100_003, 1], return_counts=True)
    shares = counts / counts.sum()
    return float(-(shares * np.log(shares)).sum())


@pytest.mark.parametrize(
    "path",
    [
        "wean/robotdata1.log.gz",
        "corrected/fhw-corrected.log.gz",
        "bags/turtlebot4_mac",
        "bags/neato_left_side.bag",
        "bags/jarvis_complex_path_fast.bag",
    ],
)
def test_scans_agree_only_as_they_are_mounted(path, real_data):
    log, _ = read_recordings([real_data / path], IngestSettings())
    log = replace(log.select(slice(0, 300)))
    found = blur(log)
    assert found < min(blur(log, turn_rad) for turn_rad in (np.pi / 2, -np.pi / 2, np.pi, -0.09, 0.09))
    assert found < min(blur(log, turn_rad, -1.0) for turn_rad in (0.0, np.pi / 2, np.pi, -np.pi / 2))


@pytest.mark.parametrize(
    ("path", "found"),
    [
        ("broken/rosrecord_v1.2.bag", "'#ROSRECORD V1.2' is a bag format older"),
        ("wean/wean.dat.gz", "a map as CMU's wean.dat, not a log"),
        ("bags/turtlebot4_mac/mac_1st_floor_final.pgm", "an image"),
    ],
)
def test_what_cannot_be_used_is_refused(path, found, real_data):
    with pytest.raises(LogError, match=found):
        read_recordings([real_data / path], IngestSettings())
