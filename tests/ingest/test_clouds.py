"""A slice of a point cloud is a scan."""

import math

import numpy as np
import pytest

from dynmap_cli.errors import LogError
from dynmap_cli.ingest.choices.transforms import matrices
from dynmap_cli.ingest.clouds import LEAST_M, N_BEAMS, STEP_RAD, points_of, slice_of
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from tests.ingest.written import (
    PERIOD_NS,
    ROS2,
    START_NS,
    World,
    build,
    stamp,
    write_bag1,
    write_bag2,
    write_mcap,
)

CLOUD = "sensor_msgs/msg/PointCloud2"
HEIGHT_M = 0.8
LEVEL = (0.2, -0.1, HEIGHT_M, 0.0, 0.0, 0.0, 1.0)
ON_ITS_SIDE = (0.2, -0.1, HEIGHT_M, math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))


def cloud(points, stamp_ns, frame="laser", kind="<f4", padding=0):
    """A message with fields z, x, y of one type, after four other bytes, in two rows with padding."""
    size = np.dtype(kind).itemsize
    offsets = [4, 4 + size, 4 + 2 * size]
    layout = {"names": ["z", "x", "y"], "formats": [kind] * 3, "offsets": offsets, "itemsize": 4 + 3 * size}
    table = np.zeros(points.shape[0], dtype=layout)
    for axis, name in enumerate("xyz"):
        table[name] = points[:, axis]
    width = points.shape[0] // 2
    rows = np.frombuffer(table.tobytes(), dtype=np.uint8).reshape(2, width * table.itemsize)
    data = np.pad(rows, ((0, 0), (0, padding))).ravel()
    fields = [
        {"name": name, "offset": table.dtype.fields[name][1], "datatype": 8 if size == 8 else 7, "count": 1}
        for name in ("z", "x", "y")
    ]
    return {
        "header": {"stamp": stamp(stamp_ns), "frame_id": frame},
        "height": 2,
        "width": width,
        "fields": fields,
        "is_bigendian": kind[0] == ">",
        "point_step": table.itemsize,
        "row_step": width * table.itemsize + padding,
        "data": data,
        "is_dense": True,
    }


def ring(number):
    """Distances of a wall around the sensor, (N_BEAMS,); every tenth direction has none."""
    distance_m = 3.0 + 0.5 * np.sin(np.arange(N_BEAMS) * 0.05) + 0.01 * number
    distance_m[::10] = np.nan
    return distance_m


def points_around(number, mounting):
    """The wall at three heights, one of them within the slice, and a floor and a lamp nearer than it, in the sensor."""
    bearing = -math.pi + (np.arange(N_BEAMS) + 0.5) * STEP_RAD
    distance_m = ring(number)
    kept = np.isfinite(distance_m)
    rows = []
    for height_m, share in ((0.05, 0.5), (0.7, 1.0), (1.0, 1.1), (1.9, 0.4)):
        along = share * distance_m[kept]
        at = [
            along * np.cos(bearing[kept]),
            along * np.sin(bearing[kept]),
            np.full(along.size, height_m - mounting[2]),
        ]
        rows.append(np.column_stack(at))
    points = np.concatenate(rows)
    rotation = matrices(np.zeros((1, 3)), np.array([mounting[3:]]))[0, :3, :3]
    return points @ rotation


def world(mounting=LEVEL, n_scans=6, **options):
    clouds = [
        ("/points", CLOUD, START_NS + PERIOD_NS * number + 1000,
         cloud(points_around(number, mounting), START_NS + PERIOD_NS * number, **options))
        for number in range(n_scans)
    ]  # fmt: skip
    return World(n_scans=n_scans, mounting=mounting, with_scans=False, extra=clouds)


WRITERS = {
    "ros1": lambda folder, world: write_bag1(folder / "a.bag", world),
    "ros2": lambda folder, world: write_bag2(folder / "a", world),
    "mcap": lambda folder, world: write_mcap(folder / "a.mcap", world, ""),
}


@pytest.mark.parametrize("container", WRITERS)
@pytest.mark.parametrize("mounting", [LEVEL, ON_ITS_SIDE], ids=["level", "on its side"])
def test_the_wall_between_two_heights_is_the_scan(container, mounting, tmp_path):
    path = WRITERS[container](tmp_path, world(mounting))
    log, report = read_recordings([path], IngestSettings(strict=True))
    assert log.ranges_m.shape == (6, N_BEAMS)
    np.testing.assert_allclose(log.ranges_m, [ring(number) for number in range(6)], atol=1e-5)
    np.testing.assert_allclose(log.sensor_poses, [[0.2, -0.1, 0.0]], atol=1e-9)
    assert not report.warnings
    assert report.odometry == "tf odom -> base_link"


@pytest.mark.parametrize("kind", ["<f4", ">f4", "<f8"])
@pytest.mark.parametrize("padding", [0, 5])
def test_points_of_any_layout(kind, padding):
    points = np.random.default_rng(2).normal(size=(8, 3))
    points[3, 1] = np.nan
    fields = cloud(points, START_NS, kind=kind, padding=padding)
    found = points_of(build(ROS2, CLOUD, fields))
    np.testing.assert_allclose(found, np.delete(points, 3, axis=0), rtol=1e-6)


@pytest.mark.parametrize(
    "change",
    [
        {"point_step": 0},
        {"point_step": 2**32 - 1},
        {"width": 2**31},
        {"height": 9},
        {"fields": []},
        {"row_step": 1},
    ],
)
def test_a_cloud_that_is_shorter_than_it_says_is_refused(change):
    fields = cloud(np.ones((8, 3)), START_NS) | change
    with pytest.raises((ValueError, KeyError)):
        points_of(build(ROS2, CLOUD, fields))


def slow_slice(points, seen_from, low_m, high_m):
    """The same, point by point."""
    ranges_m = np.full(N_BEAMS, np.nan)
    for x, y, z in points:
        distance_m = math.hypot(x - seen_from[0], y - seen_from[1])
        if not low_m <= z <= high_m or distance_m < LEAST_M:
            continue
        turn = (math.atan2(y - seen_from[1], x - seen_from[0]) - seen_from[2] + math.pi) % (2.0 * math.pi)
        beam = min(int(turn / STEP_RAD), N_BEAMS - 1)
        ranges_m[beam] = min(distance_m, ranges_m[beam]) if ranges_m[beam] == ranges_m[beam] else distance_m
    return ranges_m


def test_the_slice_is_that_of_its_slow_twin():
    rng = np.random.default_rng(5)
    for _ in range(5):
        points, seen_from = rng.normal(scale=2.0, size=(300, 3)), rng.normal(size=3)
        fast = slice_of(points, seen_from, -0.3, 0.9)
        np.testing.assert_allclose(fast, slow_slice(points, seen_from, -0.3, 0.9), rtol=1e-6)


def test_heights_at_which_there_is_nothing_are_said(tmp_path):
    path = write_bag1(tmp_path / "a.bag", world())
    with pytest.raises(
        LogError, match=r"no point lies between 5 and 6 m .* they lie between 0.05 and 1.90 m"
    ):
        read_recordings([path], IngestSettings(cloud_heights_m=(5.0, 6.0)))


def test_a_laser_comes_before_clouds_unless_they_are_asked_for(tmp_path):
    both = world()
    both.with_scans = True
    path = write_bag1(tmp_path / "a.bag", both)
    assert [laser.name for laser in read_recordings([path], IngestSettings())[1].lasers] == ["/scan"]
    log, report = read_recordings([path], IngestSettings(scan_topic="/points"))
    assert [laser.name for laser in report.lasers if laser.used] == ["/points"]
    assert log.ranges_m.shape == (6, N_BEAMS)


def test_without_transforms_heights_are_counted_from_the_sensor_and_that_is_said(tmp_path):
    lone = world()
    lone.with_tf = False
    path = write_bag1(tmp_path / "a.bag", lone)
    settings = IngestSettings(cloud_heights_m=(-0.2, 0.1), laser_pose=(0.5, 0.0, 0.0))
    log, report = read_recordings([path], settings)
    np.testing.assert_allclose(log.ranges_m[0], ring(0), atol=1e-5)
    assert "how high the sensor of these clouds sits" in report.warnings[0]


def test_clouds_in_the_frame_of_the_odometry_are_seen_from_the_robot(tmp_path):
    still = world(LEVEL)
    for number, (topic, kind, logged_ns, _) in enumerate(list(still.extra)):
        x, y, yaw = still.poses[number]
        points = points_around(number, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
        turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
        points[:, :2] = points[:, :2] @ turn.T + [x, y]
        fields = cloud(points, still.stamps_ns[number].item(), frame="odom")
        still.extra[number] = (topic, kind, logged_ns, fields)
    log, report = read_recordings([write_bag1(tmp_path / "a.bag", still)], IngestSettings())
    np.testing.assert_allclose(log.sensor_poses, [[0.0, 0.0, 0.0]], atol=1e-9)
    np.testing.assert_allclose(log.ranges_m, [ring(number) for number in range(6)], atol=1e-5)
    assert "not in the frame of their sensor" in report.warnings[0]


def test_heights_that_are_no_slice_are_refused():
    with pytest.raises(ValueError, match="must be less than"):
        IngestSettings(cloud_heights_m=(1.0, 0.5))
