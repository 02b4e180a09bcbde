"""The same drive reads the same from every container."""

from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin

from dynmap_cli.errors import LogError
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from tests.ingest.written import START_NS, World, lone_file, packed, write_bag1, write_bag2, write_mcap

SETTINGS = IngestSettings()


def assert_is_world(path: Path, world: World) -> None:
    log, report = read_recordings([path], SETTINGS)
    np.testing.assert_array_equal(log.stamps_ns, world.stamps_ns)
    np.testing.assert_array_equal(log.ranges_m, world.ranges_m)
    np.testing.assert_allclose(log.odometry, world.poses, atol=1e-12)
    np.testing.assert_allclose(log.sensor_poses, [[0.2, -0.1, 0.0]], atol=1e-12)
    np.testing.assert_allclose(
        log.bearings_rad[0], world.first_rad + world.step_rad * np.arange(world.n_beams)
    )
    np.testing.assert_allclose(log.range_limits_m, [[0.1, 8.0]])
    np.testing.assert_allclose(log.beam_interval_s, [0.001])
    assert log.recordings == (path.name,)
    assert report.odometry == "tf odom -> base_link"
    assert report.scans == world.n_scans
    assert not report.warnings
    assert not report.dropped


WRITERS = {
    "ros1": lambda folder: write_bag1(folder / "a.bag", World()),
    "ros2 folder": lambda folder: write_bag2(folder / "a", World()),
    "ros2 mcap folder": lambda folder: write_bag2(folder / "a", World(), StoragePlugin.MCAP),
    "db3": lambda folder: lone_file(write_bag2(folder / "a", World()), ".db3"),
    "mcap": lambda folder: lone_file(write_bag2(folder / "a", World(), StoragePlugin.MCAP), ".mcap"),
    "mcap ros2": lambda folder: write_mcap(folder / "a.mcap", World(), "ros2"),
    "mcap blank": lambda folder: write_mcap(folder / "a.mcap", World(), ""),
    "mcap ros1": lambda folder: write_mcap(folder / "a.mcap", World(), "ros1", "ros1"),
}


@pytest.mark.parametrize("container", WRITERS)
def test_every_container_reads_back_what_was_written(container, tmp_path):
    assert_is_world(WRITERS[container](tmp_path), World())


@pytest.mark.parametrize("how", ["gz", "bz2", "xz", "zst", "zip"])
def test_packed_recordings_are_told_by_content_not_by_name(how, tmp_path):
    assert_is_world(packed(write_bag1(tmp_path / "a.bag", World()), how), World())


def test_a_folder_of_recordings_is_read_as_parts_of_one_drive(tmp_path):
    folder = tmp_path / "parts"
    folder.mkdir()
    write_bag1(folder / "b.bag", World())
    write_bag1(folder / "a.bag", World(start_ns=World().start_ns + 12 * 10**8, start_m=0.6))
    (folder / "notes.txt").write_text("not a recording")
    log, report = read_recordings([folder], SETTINGS)
    assert log.recordings == ("b.bag", "a.bag")
    assert [found.name for found in report.recordings] == ["b.bag", "a.bag"]
    np.testing.assert_array_equal(log.recording_index, np.repeat([0, 1], 12))
    assert (np.diff(log.stamps_ns) == 10**8).all()


def refusal(path: Path, settings: IngestSettings = SETTINGS) -> str:
    with pytest.raises(LogError) as caught:
        read_recordings([path], settings)
    text = str(caught.value)
    assert "\n" not in text
    assert path.name in text
    return text


def test_a_path_that_is_not_there_is_refused(tmp_path):
    assert "no such file" in refusal(tmp_path / "none.bag")


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "empty"),
        (b"\x00\x01\x02binary", "not a known recording"),
        (b"hello world\n", "Known are: CARMEN"),
        (b"#ROSRECORD V1.2\nrest", "'#ROSRECORD V1.2'"),
        (b"\x1f\x8b\x08\x00cut", "gzip file is damaged"),
        (b"BZh91AY&SYcut", "bzip2 file is damaged"),
        (b"\xfd7zXZ\x00cut", "xz file is damaged"),
        (b"PK\x03\x04cut", "zip file is damaged"),
        (b"\x89MCAP0\r\ncut off", "cut off or damaged"),
        (b"SQLite format 3\x00 cut off", "cut off or damaged"),
        (b"#ROSBAG V2.0\ncut off", "cut off or damaged"),
    ],
)
def test_what_is_no_recording_is_refused_in_one_line(content, expected, tmp_path):
    path = tmp_path / "log.bag"
    path.write_bytes(content)
    assert expected in refusal(path)


def test_a_folder_without_recordings_is_refused(tmp_path):
    (tmp_path / "notes.txt").write_text("nothing")
    assert "without recordings" in refusal(tmp_path)


@pytest.mark.parametrize("definition", ["float64 x\n???\n", "float64 x\r\n", "", "elsewhere/Thing thing\n"])
def test_definitions_of_types_that_are_not_used_need_not_be_right(definition, tmp_path):
    def add_odd(writer):
        add = writer.add_connection

        def add_all(topic, kind, **options):
            if topic == "/scan":
                odd = add("/odd", "lab_msgs/msg/Odd", msgdef=definition, md5sum="0" * 32)
                writer.write(odd, START_NS, bytes(8))
            return add(topic, kind, **options)

        writer.add_connection = add_all

    assert_is_world(write_bag1(tmp_path / "a.bag", World(), add_odd), World())


def test_a_folder_around_a_bag_folder_is_read_and_one_around_two_names_them(tmp_path):
    outer = tmp_path / "outer"
    outer.mkdir()
    (outer / "README.md").write_text("about the bag")
    write_bag2(outer / "first", World())
    log, _ = read_recordings([outer], SETTINGS)
    assert log.recordings == ("first",)
    np.testing.assert_array_equal(log.ranges_m, World().ranges_m)
    write_bag2(outer / "second", World())
    with pytest.raises(LogError, match=r"It holds 2 bag folders \(first, second\): pass those you mean"):
        read_recordings([outer], SETTINGS)


def test_a_recording_without_a_laser_names_its_topics(tmp_path):
    text = refusal(write_bag1(tmp_path / "a.bag", World(with_scans=False)))
    assert "/odom (nav_msgs/msg/Odometry)" in text
    assert "LaserScan" in text


def test_a_zip_that_reaches_outside_is_refused(tmp_path):
    import zipfile

    path = tmp_path / "evil.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("../../escaped.txt", "x")
    assert "unsafe path" in refusal(path)
    assert not (tmp_path.parent / "escaped.txt").exists()


def test_a_zip_with_two_recordings_is_refused(tmp_path):
    import zipfile

    bag = write_bag1(tmp_path / "a.bag", World())
    path = tmp_path / "two.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.write(bag, "a.bag")
        archive.write(bag, "b.bag")
    assert "exactly one recording, found 2 (a.bag, b.bag)" in refusal(path)


def test_a_zip_may_hold_a_ros2_folder(tmp_path):
    import zipfile

    folder = write_bag2(tmp_path / "drive", World())
    path = tmp_path / "drive.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for inner in folder.iterdir():
            archive.write(inner, f"drive/{inner.name}")
    assert_is_world(path, World())


@pytest.mark.parametrize("how", ["gz", "bz2", "xz", "zst", "zip"])
def test_unpacking_stops_at_the_limit(how, tmp_path):
    plain = tmp_path / "big.log"
    plain.write_bytes(b"FLASER 1 1.00 0 0 0 0 0 0 1.0 host 1.0\n" * 60_000)
    text = refusal(packed(plain, how), IngestSettings(max_unpacked_gib=1 / 1024))
    assert "ingest.max_unpacked_gib" in text
