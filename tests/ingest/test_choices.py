"""Which laser, which odometry, which poses: what is chosen from ROS recordings, and what is said about it."""

import math

import numpy as np
import pytest

from dynmap_cli.errors import LogError
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from tests.ingest.written import ODOMETRY, SCAN, START_NS, TF, World, odometry, scan, transform, write_bag1

SETTINGS = IngestSettings()


def read(tmp_path, world, name="a.bag", **settings):
    return read_recordings([write_bag1(tmp_path / name, world)], IngestSettings(**settings))


def second_laser(
    world, *, topic="/rear", frame="rear", mounting=(-0.4, 0.0, 0.2, 0.0, 0.0, 1.0, 0.0), **changes
):
    """Messages of a further laser; *changes* go into each scan."""
    messages = []
    if mounting is not None:
        messages.append(
            ("/tf_static", TF, START_NS - 1, {"transforms": [transform("base_link", frame, 0, mounting)]})
        )
    for stamp_ns in world.stamps_ns.tolist():
        fields = scan(world, stamp_ns + 50_000_000, world.ranges_m[0] * 0.5)
        fields["header"]["frame_id"] = frame
        fields.update(changes)
        messages.append((topic, SCAN, stamp_ns + 50_002_000, fields))
    return messages


def used(report):
    return [laser.name for laser in report.lasers if laser.used]


def why_not(report, name):
    return next(laser.why for laser in report.lasers if laser.name == name and not laser.used)


def test_two_fixed_lasers_of_one_kind_are_merged_in_time_order(tmp_path):
    world = World()
    world.extra = second_laser(world)
    log, report = read(tmp_path, world)
    assert used(report) == ["/rear", "/scan"]
    assert log.n_scans == 23
    assert report.dropped == {"scan before the first or after the last odometry": 1}
    assert (np.diff(log.stamps_ns) == 50_000_000).all()
    np.testing.assert_array_equal(log.geometry_index[:4] != log.geometry_index[1:5], True)
    np.testing.assert_allclose(sorted(log.sensor_poses[:, 0]), [-0.4, 0.2])


def test_a_laser_of_another_kind_is_left_out(tmp_path):
    world = World()
    world.extra = second_laser(world, range_max=3.0)
    _, report = read(tmp_path, world)
    assert used(report) == ["/scan"]
    assert "another kind" in why_not(report, "/rear")


def test_a_processed_copy_of_a_laser_is_left_out(tmp_path):
    world = World()
    late = [
        (topic, kind, logged_ns + 400_000_000, fields)
        for topic, kind, logged_ns, fields in second_laser(
            world, topic="/a_filtered", frame="laser", mounting=None
        )
    ]
    world.extra = late
    _, report = read(tmp_path, world)
    assert used(report) == ["/scan"]
    assert (
        why_not(report, "/a_filtered") == "a processed copy of /scan (same mounting, recorded 0.40 s later)"
    )


def test_a_laser_that_tilts_is_left_out(tmp_path):
    world = World(n_beams=5)
    wide = World(n_beams=30)
    world.extra = second_laser(wide, mounting=None)
    for number, stamp_ns in enumerate(range(START_NS, START_NS + 1_200_000_000, 50_000_000)):
        pitch = 0.4 * math.sin(number)
        values = (0.0, 0.0, 0.0, 0.0, math.sin(pitch / 2), 0.0, math.cos(pitch / 2))
        world.extra.append(
            ("/tf", TF, stamp_ns, {"transforms": [transform("base_link", "rear", stamp_ns, values)]})
        )
    _, report = read(tmp_path, world)
    assert used(report) == ["/scan"]
    assert why_not(report, "/rear") == "it swings or tilts on the robot"


def test_the_scan_topic_can_be_set(tmp_path):
    world = World()
    world.extra = second_laser(world)
    assert used(read(tmp_path, world, scan_topic="/rear")[1]) == ["/rear"]


def test_an_unknown_scan_topic_names_those_there_are(tmp_path):
    with pytest.raises(
        LogError, match=r"no laser scans on '/front'; laser topics here: /scan\. Pass one of these"
    ):
        read(tmp_path, World(), scan_topic="/front")


def test_a_laser_pose_that_was_set_is_that_of_one_laser(tmp_path):
    world = World()
    world.extra = second_laser(world)
    log, report = read(tmp_path, world, laser_pose=(0.5, 0.0, 1.0))
    assert len(used(report)) == 1
    np.testing.assert_array_equal(log.sensor_poses, [[0.5, 0.0, 1.0]])


def test_without_a_known_mounting_the_laser_is_at_the_centre_with_a_warning(tmp_path):
    log, report = read(tmp_path, World(with_tf=False))
    np.testing.assert_array_equal(log.sensor_poses, [[0.0, 0.0, 0.0]])
    assert "--laser-pose" in report.warnings[0]
    assert report.odometry == "/odom"
    np.testing.assert_allclose(log.odometry, World().poses, atol=1e-12)


def test_an_upside_down_laser_has_its_bearings_turned(tmp_path):
    world = World(mounting=(0.2, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0))
    log, report = read(tmp_path, world)
    np.testing.assert_allclose(log.bearings_rad[0], 1.0 - 0.25 * np.arange(9), atol=1e-9)
    np.testing.assert_allclose(log.sensor_poses, [[0.2, 0.0, 0.0]], atol=1e-9)
    assert report.lasers[0].upside_down


def test_negative_increments_are_kept(tmp_path):
    log, _ = read(tmp_path, World(first_rad=1.0, step_rad=-0.25))
    np.testing.assert_allclose(log.bearings_rad[0], 1.0 - 0.25 * np.arange(9), atol=1e-9)


def test_an_increment_of_zero_spreads_beams_between_the_limits(tmp_path):
    world = World(change=lambda _number, fields: fields.update(angle_increment=0.0))
    log, _ = read(tmp_path, world)
    np.testing.assert_allclose(log.bearings_rad[0], -1.0 + 0.25 * np.arange(9), atol=1e-6)


def test_a_beam_more_than_the_limits_say_is_kept(tmp_path):
    log, _ = read(tmp_path, World(change=lambda _number, fields: fields.update(angle_max=0.75)))
    np.testing.assert_allclose(log.bearings_rad[0, [0, -1]], [-1.0, 1.0], atol=1e-9)


def test_counts_of_beams_that_change_give_several_geometries(tmp_path):
    def shorten(number, fields):
        if number % 3 == 0:
            fields["ranges"] = fields["ranges"][:6]

    log, report = read(tmp_path, World(change=shorten))
    assert log.bearings_rad.shape == (2, 9)
    short = log.geometry_index == log.geometry_index[0]
    np.testing.assert_array_equal(np.flatnonzero(short), [0, 3, 6, 9])
    assert np.isnan(log.ranges_m[short, 6:]).all()
    assert np.isnan(log.bearings_rad[log.geometry_index[0], 6:]).all()
    np.testing.assert_array_equal(log.ranges_m[~short], World().ranges_m[~short])
    assert report.lasers[0].beams == (6, 9)


def test_increments_that_are_measured_anew_each_time_share_a_geometry(tmp_path):
    def jitter(number, fields):
        fields["angle_increment"] = 0.25 + 1e-9 * number
        fields["time_increment"] = 0.001 + 1e-6 * number

    log, _ = read(tmp_path, World(change=jitter))
    assert log.sensor_poses.shape == (1, 3)
    np.testing.assert_allclose(log.beam_interval_s, [0.0010055])


@pytest.mark.parametrize("interval_s", [-0.001, 5.0, math.nan])
def test_absurd_times_between_beams_count_as_unknown(interval_s, tmp_path):
    world = World(change=lambda _number, fields: fields.update(time_increment=interval_s))
    np.testing.assert_array_equal(read(tmp_path, world)[0].beam_interval_s, [0.0])


def test_scans_without_beams_or_measurements_are_dropped_and_counted(tmp_path):
    def spoil(number, fields):
        if number == 4:
            fields["ranges"] = np.zeros(0, dtype=np.float32)
        if number == 5:
            fields["ranges"] = np.full(9, np.nan, dtype=np.float32)

    log, report = read(tmp_path, World(change=spoil))
    np.testing.assert_array_equal(log.stamps_ns, np.delete(World().stamps_ns, [4, 5]))
    assert report.dropped == {"scan on /scan without beams": 1, "scan without any measurement": 1}


def test_a_recording_without_any_measurement_is_refused(tmp_path):
    world = World(change=lambda _number, fields: fields.update(ranges=np.zeros(9, dtype=np.float32)))
    with pytest.raises(LogError, match="no beam of any scan is a return"):
        read(tmp_path, world)


def test_scans_that_were_never_stamped_take_the_times_of_recording(tmp_path):
    def unstamp(_number, fields):
        fields["header"]["stamp"] = {"sec": 0, "nanosec": 0}

    log, report = read(tmp_path, World(change=unstamp))
    np.testing.assert_array_equal(log.stamps_ns, World().stamps_ns[:-1] + 1000)
    assert "no scan has a time stamp" in report.warnings[0]


def test_single_scans_without_stamp_are_dropped(tmp_path):
    def unstamp(number, fields):
        if number == 2:
            fields["header"]["stamp"] = {"sec": 0, "nanosec": 0}

    log, report = read(tmp_path, World(change=unstamp))
    assert log.n_scans == 11
    assert report.dropped == {"scan on /scan without a time stamp": 1}


def test_frames_with_a_leading_slash_are_the_same_frames(tmp_path):
    world = World(change=lambda _number, fields: fields["header"].update(frame_id="/laser"))
    assert not read(tmp_path, world)[1].warnings


def test_an_odometry_topic_is_used_where_tf_stands_still(tmp_path):
    world = World(with_tf=False)
    still = transform("odom", "base_link", START_NS, (0, 0, 0, 0, 0, 0, 1))
    mounted = transform("base_link", "laser", START_NS, world.mounting)
    world.extra = [("/tf", TF, START_NS, {"transforms": [still, mounted]})]
    log, report = read(tmp_path, world)
    assert report.odometry == "/odom"
    assert report.odometry_rejected == ("tf odom -> base_link (it stands still)",)
    np.testing.assert_allclose(log.odometry, world.poses, atol=1e-12)


@pytest.mark.parametrize(
    ("topic", "frame"), [("/localization", "map"), ("/pose_ground_truth", "odom"), ("/odom/mocap", "world")]
)
def test_localization_and_ground_truth_are_no_odometry(topic, frame, tmp_path):
    world = World(with_tf=False, with_odometry=False)
    world.extra = [
        (topic, ODOMETRY, stamp_ns, odometry(frame, "base_link", stamp_ns, (x, y, 0, 0, 0, 0, 1)))
        for stamp_ns, (x, y, _) in zip(world.stamps_ns.tolist(), world.poses, strict=True)
    ]
    log, report = read(tmp_path, world)
    assert report.odometry == "none"
    assert topic in report.odometry_rejected[0]
    assert not log.has_odometry.any()


def test_map_to_base_in_tf_is_no_odometry(tmp_path):
    world = World(with_tf=False, with_odometry=False)
    world.extra = [
        (
            "/tf",
            TF,
            stamp_ns,
            {"transforms": [transform("map", "base_link", stamp_ns, (x, y, 0, 0, 0, 0, 1))]},
        )
        for stamp_ns, (x, y, _) in zip(world.stamps_ns.tolist(), world.poses, strict=True)
    ]
    world.extra.append(
        ("/tf_static", TF, 0, {"transforms": [transform("base_link", "laser", 0, world.mounting)]})
    )
    log, report = read(tmp_path, world)
    assert report.odometry == "none"
    assert report.base_frame == "base_link"
    np.testing.assert_allclose(log.sensor_poses, [[0.2, -0.1, 0.0]])


def test_odometry_of_another_clock_is_not_used(tmp_path):
    world = World(with_tf=False, with_odometry=False)
    world.extra = [
        (
            "/odom",
            ODOMETRY,
            START_NS,
            odometry("odom", "base_link", 10**9 + number, (number, 0, 0, 0, 0, 0, 1)),
        )
        for number in range(5)
    ]
    assert read(tmp_path, world)[1].odometry_rejected == ("/odom (its times are not those of the scans)",)


def test_odometry_can_be_set(tmp_path):
    assert read(tmp_path, World(), "b.bag", odom="/odom")[1].odometry == "/odom"
    log, report = read(tmp_path, World(), odom="none")
    assert report.odometry == "none"
    assert np.isnan(log.odometry).all()


def test_odometry_that_is_not_there_names_what_is(tmp_path):
    with pytest.raises(LogError, match="no odometry on '/wheels'; odometry here: /odom"):
        read(tmp_path, World(), odom="/wheels")
    with pytest.raises(LogError, match="tf does not join an odometry frame"):
        read(tmp_path, World(with_tf=False), "b.bag", odom="tf")


def test_odometry_of_another_frame_on_the_robot_is_moved_to_the_base(tmp_path):
    world = World(with_odometry=False)
    away = transform("base_link", "imu", 0, (0.0, 1.0, 0.0, 0, 0, 0, 1))
    world.extra = [("/tf_static", TF, 0, {"transforms": [away]})]
    world.extra += [
        ("/imu_odom", ODOMETRY, stamp_ns, odometry("odom", "imu", stamp_ns, (x, 1.0, 0, 0, 0, 0, 1)))
        for stamp_ns, (x, _, _) in zip(world.stamps_ns.tolist(), world.poses, strict=True)
    ]
    log, _ = read(tmp_path, world, odom="/imu_odom")
    np.testing.assert_allclose(log.odometry[:, 1:], 0.0, atol=1e-12)


def test_half_of_the_scans_without_odometry_are_kept_with_a_warning(tmp_path):
    world = World(with_tf=False)
    messages = list(world.messages())
    kept = [m for number, m in enumerate(messages) if m[0] != "/odom" or number < 10]
    world = World(with_tf=False, with_odometry=False, with_scans=False, extra=kept)
    log, report = read(tmp_path, world)
    assert log.n_scans == 12
    assert report.scans_without_odometry == np.isnan(log.odometry[:, 0]).sum() > 5
    assert f"{report.scans_without_odometry} scans have no odometry" in report.warnings


def test_frames_can_be_set_and_must_be_there(tmp_path):
    log, report = read(tmp_path, World(), base_frame="laser")
    assert report.odometry == "tf odom -> laser"
    np.testing.assert_allclose(log.sensor_poses, [[0.0, 0.0, 0.0]], atol=1e-12)
    with pytest.raises(LogError, match=r"no frame .chassis. in tf .*base_link, laser, odom"):
        read(tmp_path, World(), "b.bag", base_frame="chassis")


def test_the_first_echo_of_a_laser_with_several_is_read(tmp_path):
    world = World(with_scans=False)
    expected = world.ranges_m.copy()
    expected[:, 1] = np.inf
    for stamp_ns, ranges in zip(world.stamps_ns.tolist(), expected, strict=True):
        fields = scan(world, stamp_ns, ranges)
        echoes = [np.array([value, 7.9], dtype=np.float32) for value in ranges]
        echoes[1] = np.zeros(0, dtype=np.float32)
        fields["ranges"] = [{"echoes": values} for values in echoes]
        fields["intensities"] = []
        world.extra.append(("/scan", "sensor_msgs/msg/MultiEchoLaserScan", stamp_ns, fields))
    log, _ = read(tmp_path, world)
    np.testing.assert_array_equal(log.ranges_m, expected)
