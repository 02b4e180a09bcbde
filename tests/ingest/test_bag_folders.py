"""Folders of recordings whose files and metadata do not fit: what is there is read, the rest is said with numbers."""

import os
import shutil
import sqlite3
from contextlib import closing

import numpy as np
import pytest
import yaml
import zstandard
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from dynmap_cli.errors import LogError
from dynmap_cli.export.salvaging import write_salvaged
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from tests.fuzz.law import obey
from tests.ingest.corpus import FOLDERS, WORLD
from tests.ingest.written import PERIOD_NS, START_NS, World, write_bag1, write_bag2

SETTINGS, STRICT = IngestSettings(), IngestSettings(strict=True)
STORAGES = {".db3": StoragePlugin.SQLITE3, ".mcap": StoragePlugin.MCAP}
ALL, PER_PART = 183, 61


def part(number):
    """A third of the world."""
    return World(
        n_scans=20,
        n_beams=40,
        step_rad=0.05,
        start_ns=START_NS + 20 * number * PERIOD_NS,
        start_m=1.0 * number,
        skipped=20 * number,
    )


def edited(folder, change):
    path = folder / "metadata.yaml"
    content = yaml.safe_load(path.read_text())
    change(content["rosbag2_bagfile_information"])
    path.write_text(yaml.safe_dump(content))
    return folder


def split(tmp_path, suffix, mode=CompressionMode.NONE, listed=3):
    """A bag of three files, of which the first are listed."""
    packed = ".zstd" if mode is CompressionMode.FILE else ""
    parts = [
        write_bag2(tmp_path / name, part(number), STORAGES[suffix], mode) for number, name in enumerate("abc")
    ]
    for number, one in enumerate(parts):
        next(one.glob(f"*{suffix}{packed}")).rename(parts[0] / f"a_{number}{suffix}{packed}")
    for one in parts[1:]:
        shutil.rmtree(one)

    def change(information):
        information["relative_file_paths"] = [f"a_{number}{suffix}{packed}" for number in range(listed)]
        information["message_count"] *= listed
        information.pop("files", None)
        for topic in information["topics_with_message_count"]:
            topic["message_count"] *= listed

    return edited(parts[0], change)


def read(path, settings=SETTINGS):
    return read_recordings([path], settings)


def assert_is_world(log, kept=slice(None)):
    np.testing.assert_array_equal(log.ranges_m, WORLD.ranges_m[kept])


@pytest.mark.parametrize("suffix", STORAGES)
def test_the_last_file_of_a_bag_that_its_metadata_do_not_list_is_read_and_said(suffix, tmp_path):
    folder = split(tmp_path, suffix, listed=2)
    log, report = read(folder)
    assert_is_world(log)
    (said,) = report.warnings
    assert (
        f"1 storage files (a_2{suffix}) of the same recording, not listed in its metadata.yaml, read all the same"
        in said
    )
    assert f"recovered {ALL} messages" in said
    with pytest.raises(LogError, match="not listed"):
        read(folder, STRICT)


@pytest.mark.parametrize("suffix", STORAGES)
def test_a_file_of_another_name_that_is_not_listed_is_said_and_not_read(suffix, tmp_path):
    folder = split(tmp_path, suffix)
    shutil.copy(folder / f"a_0{suffix}", folder / f"old{suffix}")
    log, report = read(folder)
    assert_is_world(log)
    assert report.warnings == (
        f"a: 1 storage files (old{suffix}) beside it, not listed in its metadata.yaml, not read",
    )
    assert not report.dropped
    assert not report.damage


@pytest.mark.parametrize("suffix", STORAGES)
@pytest.mark.parametrize("how", ["missing", "empty", "folder", "text", "head damaged"])
def test_of_a_bag_that_was_split_all_but_the_broken_file_is_read(suffix, how, tmp_path):
    folder = split(tmp_path, suffix)
    middle = folder / f"a_1{suffix}"
    data = middle.read_bytes()
    middle.unlink()
    if how == "folder":
        middle.mkdir()
    elif how != "missing":
        middle.write_bytes(
            {"empty": b"", "text": b"hello\n" * 99, "head damaged": data[:8] + bytes(9000)}[how]
        )
    log, report = read(folder)
    assert_is_world(log, np.r_[0:20, 40:60])
    said = report.warnings[0]
    assert f"a_1{suffix}" in said
    assert f"recovered {ALL - PER_PART} of {ALL} messages, up to t = 5.9 s, lost" in said


@pytest.mark.parametrize("suffix", STORAGES)
@pytest.mark.parametrize("how", ["empty", "folder", "text", "cut"])
def test_of_a_folder_without_metadata_all_but_the_broken_file_is_read_and_that_is_said(suffix, how, tmp_path):
    folder = split(tmp_path, suffix)
    (folder / "metadata.yaml").unlink()
    middle = folder / f"a_1{suffix}"
    data = middle.read_bytes()
    middle.unlink()
    if how == "folder":
        middle.mkdir()
    else:
        middle.write_bytes({"empty": b"", "text": b"hello\n" * 99, "cut": data[:20]}[how])
    log, report = read(folder)
    assert_is_world(log, np.r_[0:20, 40:60])
    assert any(f"a_1{suffix}: " in line for line in report.warnings)
    with pytest.raises(LogError, match=f"a_1{suffix}"):
        read(folder, STRICT)


def test_a_folder_of_which_nothing_can_be_read_is_refused(tmp_path):
    for name in ("a.bag", "b.bag"):
        (tmp_path / name).write_bytes(b"#ROSBAG V2.0\ncut off")
    with pytest.raises(LogError, match=r"a\.bag: this ROS 1 bag is cut off or damaged"):
        read(tmp_path)


@pytest.mark.parametrize("suffix", STORAGES)
def test_a_file_that_is_listed_twice_is_read_once(suffix, tmp_path):
    folder = edited(
        split(tmp_path, suffix), lambda one: one.update(relative_file_paths=[*one["relative_file_paths"]] * 2)
    )
    log, report = read(folder)
    assert_is_world(log)
    assert not report.dropped


def zeros(n_mb):
    """As many MB of zeros in few bytes."""
    packer = zstandard.ZstdCompressor().compressobj()
    return b"".join([*(packer.compress(bytes(1 << 20)) for _ in range(n_mb)), packer.flush()])


@pytest.mark.parametrize("suffix", [".db3.zstd", ".db3.zst", ".db3"])
def test_packed_files_are_told_by_content_and_unpacked_with_a_bound(suffix, tmp_path):
    folder = FOLDERS["folder db3, packed file"](tmp_path)
    (packed,) = folder.glob("*.zstd")
    renamed = packed.with_name(f"a{suffix}")
    packed.rename(renamed)
    edited(folder, lambda one: one.update(relative_file_paths=[renamed.name]))
    log, report = read(folder)
    assert_is_world(log)
    assert not report.warnings
    with pytest.raises(LogError, match=r"ingest\.max_unpacked_gib"):
        read(folder, IngestSettings(max_unpacked_gib=1 / (1 << 15)))
    renamed.write_bytes(zeros(3000))
    refusal = obey(lambda _: read(folder), tmp_path)
    assert f"{renamed.name} does not unpack to a storage file" in str(refusal)


def test_of_packed_files_that_are_not_all_there_the_others_are_read(tmp_path):
    folder = split(tmp_path, ".db3", CompressionMode.FILE)
    (folder / "a_2.db3.zstd").unlink()
    log, report = read(folder)
    assert_is_world(log, slice(40))
    assert "lists 1 storage files (a_2.db3.zstd), not there as a file" in report.warnings[0]


def test_a_file_that_was_not_packed_before_the_crash_is_read(tmp_path):
    folder = split(tmp_path, ".db3", CompressionMode.FILE, listed=2)
    packed = folder / "a_2.db3.zstd"
    plain = zstandard.ZstdDecompressor().decompressobj().decompress(packed.read_bytes())
    packed.with_suffix("").write_bytes(plain)
    packed.write_bytes(packed.read_bytes()[:500])
    log, report = read(folder)
    assert_is_world(log)
    assert "1 storage files (a_2.db3) of the same recording" in report.warnings[0]
    assert "1 storage files (a_2.db3.zstd) beside it" in report.warnings[1]


def test_a_message_that_unpacks_to_gigabytes_costs_only_itself(tmp_path):
    folder = FOLDERS["folder db3, packed messages"](tmp_path)
    (file,) = folder.glob("*.db3")
    with closing(sqlite3.connect(file)) as connection, connection:
        connection.execute("UPDATE messages SET data = ? WHERE id = 50", (zeros(2000),))
    found = []
    assert obey(lambda _: found.append(read(folder)), tmp_path) is None
    ((log, report),) = found
    assert log.n_scans >= 59
    assert sum(report.dropped.values()) == 1


@pytest.mark.parametrize("suffix", STORAGES)
def test_names_that_mean_something_in_an_address_are_only_names(suffix, tmp_path):
    folder = split(tmp_path, suffix).rename(tmp_path / "50%41 #1?mode=memory")
    log, report = read(folder)
    assert_is_world(log)
    assert not report.warnings
    (folder / "metadata.yaml").unlink()
    log, report = read(folder)
    assert_is_world(log)
    assert not report.warnings


def test_metadata_that_take_long_to_read_are_not_read(tmp_path):
    folder = split(tmp_path, ".mcap")
    with (folder / "metadata.yaml").open("a") as stream:
        stream.write("x: [" + "a," * 2_000_000 + "a]\n")
    found = []
    assert obey(lambda _: found.append(read(folder)), tmp_path) is None
    assert_is_world(found[0][0])
    assert "metadata.yaml cannot be read: more than" in found[0][1].warnings[0]


def test_what_else_lies_in_a_folder_is_passed_over(tmp_path):
    write_bag1(tmp_path / "a.bag", World())
    (tmp_path / "notes.txt").write_text("about the drive")
    (tmp_path / "maps").mkdir()
    (tmp_path / "again").symlink_to(tmp_path)
    log, report = read(tmp_path)
    np.testing.assert_array_equal(log.ranges_m, World().ranges_m)
    assert not report.warnings


@pytest.mark.skipif(os.geteuid() == 0, reason="root reads everything")
@pytest.mark.parametrize("mode", [0o444, 0o111])
def test_a_folder_that_may_not_be_entered_or_listed_is_refused(mode, tmp_path):
    folder = tmp_path / "closed"
    folder.mkdir()
    write_bag1(folder / "a.bag", World())
    folder.chmod(mode)
    with pytest.raises(LogError, match="Permission denied"):
        read(folder)
    folder.chmod(0o755)


@pytest.mark.parametrize("count", ["nan", -1, None, 1.5, [3]])
@pytest.mark.parametrize("suffix", STORAGES)
def test_a_number_of_messages_that_is_none_is_said_and_not_counted_with(suffix, count, tmp_path):
    """Found by `make fuzz`."""
    folder = write_bag2(tmp_path / "a", WORLD, STORAGES[suffix])
    edited(
        folder, lambda information: information["topics_with_message_count"][0].update(message_count=count)
    )
    log, report = read(folder)
    assert_is_world(log)
    assert f"its metadata.yaml says that it holds '{count}' messages of" in report.damage[0]
    assert write_salvaged([folder], tmp_path / "copy.mcap", SETTINGS).losses


@pytest.mark.parametrize("suffix", STORAGES)
def test_copies_of_a_file_and_far_numbers_are_no_further_parts(suffix, tmp_path):
    folder = write_bag2(tmp_path / "a", WORLD, STORAGES[suffix])
    (file,) = folder.glob(f"*{suffix}")
    shutil.copy(file, folder / f"a_1{suffix}")
    other = write_bag2(tmp_path / "b", part(2), STORAGES[suffix])
    shutil.copy(next(other.glob(f"*{suffix}")), folder / f"a_999{suffix}")
    log, report = read(folder)
    assert_is_world(log)
    assert not report.damage
    assert any("not listed in its metadata.yaml, not read" in told for told in report.warnings)
