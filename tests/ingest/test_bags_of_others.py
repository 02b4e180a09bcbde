"""Bags that other programs write: types named in another way, metadata of later versions, files renamed."""

import numpy as np
import pytest
import yaml
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from tests.ingest.written import World, packed, write_bag1, write_bag2, write_mcap

INFORMATION = "rosbag2_bagfile_information"


def read_clean(path, world):
    """Read a recording in which nothing is wrong."""
    log, report = read_recordings([path], IngestSettings(strict=True))
    assert not report.damage
    assert not report.warnings
    assert report.odometry == "tf odom -> base_link"
    np.testing.assert_array_equal(log.stamps_ns, world.stamps_ns)
    np.testing.assert_allclose(log.odometry, world.poses, atol=1e-9)


@pytest.mark.parametrize("profile", ["ros1", "ros2", ""])
@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
@pytest.mark.parametrize("has_short_names", [False, True])
def test_types_of_an_mcap_file_may_be_named_as_in_ros_1_or_2(profile, encoding, has_short_names, tmp_path):
    world = World()
    path = write_mcap(tmp_path / "a.mcap", world, profile, encoding, has_short_names=has_short_names)
    read_clean(path, world)


def write_changed(path, world, plugin, **changed):
    """A bag folder with other metadata."""
    write_bag2(path, world, plugin)
    metadata = path / "metadata.yaml"
    information = yaml.safe_load(metadata.read_text())[INFORMATION]
    information.update(changed)
    metadata.write_text(yaml.safe_dump({INFORMATION: information}))
    return path


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize("version", [4, 10, 12, "9", None])
def test_metadata_of_a_later_version_are_read_where_what_is_needed_is_there(version, plugin, tmp_path):
    world = World()
    read_clean(write_changed(tmp_path / "bag", world, plugin, version=version, odd={"a": 1}), world)


def test_metadata_of_a_later_version_without_what_is_needed_are_damage(tmp_path):
    path = write_changed(tmp_path / "bag", World(), StoragePlugin.MCAP, version=10)
    metadata = path / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("message_count", "messages"))
    assert read_recordings([path], IngestSettings())[1].damage


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_the_file_of_a_bag_folder_may_have_been_renamed(plugin, tmp_path):
    world = World()
    path = write_bag2(tmp_path / "bag", world, plugin)
    (file,) = (one for one in path.iterdir() if one.suffix in {".mcap", ".db3"})
    file.rename(path / f"renamed{file.suffix}")
    read_clean(path, world)


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize("mode", [CompressionMode.NONE, CompressionMode.FILE])
def test_a_bag_folder_may_be_named_like_a_ros_1_bag(plugin, mode, tmp_path):
    """As `ros2 bag record -o drive.bag` does it."""
    read_clean(write_bag2(tmp_path / "drive.bag", World(), plugin, mode), World())


@pytest.mark.parametrize("encoding", ["ros1msg", "jsonschema", "protobuf", ""])
@pytest.mark.parametrize("profile", ["ros2", ""])
def test_definitions_of_another_kind_or_none_are_no_damage_where_the_type_is_a_known_one(
    encoding, profile, tmp_path
):
    def prepare(writer):
        register = writer.register_schema
        writer.register_schema = lambda name, _encoding, _data: register(name, encoding, b"")

    path = write_mcap(tmp_path / "a.mcap", World(), profile, prepare=prepare)
    read_clean(path, World())


def test_zstd_behind_a_frame_that_is_to_be_skipped_is_unpacked(tmp_path):
    """As pzstd writes it."""
    path = packed(write_bag1(tmp_path / "a.bag", World()), "zst")
    path.write_bytes(b"\x50\x2a\x4d\x18\x04\x00\x00\x00\x01\x02\x03\x04" + path.read_bytes())
    read_clean(path, World())
