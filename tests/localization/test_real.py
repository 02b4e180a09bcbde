"""Real recordings in maps that others made."""

import numpy as np
import pytest

from dynmap_cli.files.pgm import read_map
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from dynmap_cli.localization.odometry import with_sound_odometry
from dynmap_cli.localization.sensing.map_pool import make_map_pool
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.localization.tracking import localize_log


@pytest.mark.real
def test_a_turtlebot_finds_itself_in_the_map_of_its_floor(real_data):
    log, _ = read_recordings([real_data / "bags" / "turtlebot4_mac"], IngestSettings())
    grid, warnings = read_map(real_data / "bags" / "turtlebot4_mac" / "mac_1st_floor_final.yaml")
    assert "free_thresh 0.25" in warnings[0]
    settings = LocalizationSettings()
    log, _ = with_sound_odometry(log, settings)
    found = localize_log(log, make_map_pool(grid, [], settings), settings, seed=0)
    assert "lost" not in {row.verdict for row in found.health}
    assert np.mean([row.health.explained for row in found.health]) > 0.85
    assert abs(found.trajectory.length_m() - 8.3) < 0.5
    again = localize_log(log, make_map_pool(grid, [], settings), settings, seed=1)
    apart_m = np.linalg.norm((found.trajectory.poses - again.trajectory.poses)[:, :2], axis=1)
    assert np.median(apart_m) < 0.05
