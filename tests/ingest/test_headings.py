"""Headings in degrees."""

import numpy as np
import pytest

from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from dynmap_cli.ingest.text.headings import are_headings_degrees
from tests.ingest.rooms import Room
from tests.ingest.written import carmen_line


@pytest.mark.parametrize("is_degrees", [False, True])
def test_headings_of_a_log_in_degrees_become_radians(is_degrees, tmp_path):
    world = Room(n_scans=200, n_beams=181, first_rad=-np.pi / 2, step_rad=np.radians(1.0))
    lines = []
    for number, (pose, ranges_m) in enumerate(zip(world.poses, world.ranges_m, strict=True)):
        x, y, yaw = pose
        at_x, at_y = world.mounting[:2]
        laser = (
            x + at_x * np.cos(yaw) - at_y * np.sin(yaw),
            y + at_x * np.sin(yaw) + at_y * np.cos(yaw),
            yaw,
        )
        both = [np.array(laser), pose.copy()]
        if is_degrees:
            for one in both:
                one[2] = np.degrees(one[2])
        lines.append(carmen_line(ranges_m, *both, f"{1000.0 + 0.1 * number:.6f}"))
    path = tmp_path / "a.log"
    path.write_text("".join(lines))
    log, report = read_recordings([path], IngestSettings())
    assert any("if they are degrees" in line for line in report.warnings) == is_degrees
    np.testing.assert_allclose(log.odometry, world.poses, atol=1e-5)
    np.testing.assert_allclose(log.sensor_poses, [[*world.mounting[:2], 0.0]], atol=1e-4)


def test_headings_that_are_counted_on_beyond_a_circle_stay_radians():
    turned = np.linspace(0.0, 40.0, 2000)
    steps = 0.05 * np.column_stack([np.cos(turned), np.sin(turned)])
    assert not are_headings_degrees(np.column_stack([np.cumsum(steps, axis=0), turned]))
    degrees = np.column_stack([np.cumsum(steps, axis=0), np.degrees(turned) % 360.0])
    assert are_headings_degrees(degrees)
    assert not are_headings_degrees(degrees[:20])
