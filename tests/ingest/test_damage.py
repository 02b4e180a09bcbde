"""Recordings that are cut off or have wrong bytes: what is whole is used, what is lost is said, nothing breaks."""

import random
import re
import warnings

import numpy as np
import pytest
import yaml
from rosbags.rosbag2 import StoragePlugin

from dynmap_cli.errors import LogError
from dynmap_cli.ingest.containers.mcap_records import SummaryState, summary_state
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from tests.ingest.corpus import FILES, WORLD, scan_ends
from tests.ingest.written import write_bag2

SETTINGS = IngestSettings()


WRITERS = {
    name: FILES[name]
    for name in (
        "ros1",
        "db3",
        "mcap ros2",
        "mcap blank",
        "mcap ros1",
        "foxglove json",
        "foxglove protobuf",
        "foxglove unchunked",
        "carmen",
    )
}
CHUNK = 6
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Each container once, as bytes."""
    return {
        container: (path.name, path.read_bytes())
        for container, write in WRITERS.items()
        for path in [write(tmp_path_factory.mktemp("whole"))]
    }


def read(path, name, data):
    """Scans and report; None where the recording is refused in one line. Warnings of libraries are errors."""
    path = path / name
    path.write_bytes(data)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return read_recordings([path], SETTINGS)
        except LogError as err:
            assert "\n" not in str(err)
            assert name in str(err)
            return None


def recovered(found):
    """Scans that were used, or left out with a count."""
    return 0 if found is None else found[0].n_scans + sum(found[1].dropped.values())


@pytest.mark.parametrize("container", [name for name in WRITERS if name.startswith("mcap")])
def test_a_recording_that_is_cut_off_is_used_up_to_there(written, container, tmp_path):
    name, data = written[container]
    counts = []
    for share in (0.2, 0.4, 0.6, 0.8, 0.97):
        found = read(tmp_path, name, data[: int(share * len(data))])
        if found is None:
            counts.append(0)
            continue
        log, report = found
        row = int(np.flatnonzero(WORLD.stamps_ns == log.stamps_ns[0])[0])
        np.testing.assert_array_equal(log.ranges_m, WORLD.ranges_m[row : row + log.n_scans])
        counts.append(log.n_scans)
        said = [line for line in report.warnings if "cut off or damaged" in line]
        assert len(said) == 1
        assert re.search(r"recovered \d+( of about \d+)? messages, up to t = \d+\.\d s, lost .*", said[0])
    assert counts == sorted(counts)
    assert counts[-1] > 50


@pytest.mark.parametrize("container", ["mcap ros2", "mcap blank", "mcap ros1"])
def test_a_block_that_fails_its_checksum_costs_only_itself(written, container, tmp_path):
    name, data = written[container]
    at = data.index(ZSTD_MAGIC, len(data) // 2) + 60
    log, report = read(tmp_path, name, data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
    assert 40 < log.n_scans < 60
    assert "fails its checksum" in report.warnings[0]
    assert "1 blocks of messages" in report.warnings[0]
    assert re.search(r"recovered 1[67]\d of 181 messages, up to t = 5.9 s", report.warnings[0])


def test_a_file_without_its_end_says_that_nothing_else_is_known_to_be_lost(written, tmp_path):
    name, data = written["mcap ros2"]
    log, report = read(tmp_path, name, data[:-8])
    assert log.n_scans == 60
    assert "lost no message that is known of" in report.warnings[0]


@pytest.mark.parametrize(
    ("container", "has_checksum"),
    [("ros1", True), ("mcap ros2", True), ("mcap ros2", False), ("mcap blank", False)],
)
def test_what_lies_behind_the_end_is_said_with_its_size(written, container, has_checksum, tmp_path):
    name, data = written[container]
    if not has_checksum:
        data = data[:-12] + bytes(4) + data[-8:]
    log, report = read(tmp_path, name, data + data)
    np.testing.assert_array_equal(log.ranges_m, WORLD.ranges_m)
    assert f"{len(data)} bytes behind its end are not read" in report.warnings[0]
    assert f"lost {len(data)} of {2 * len(data)} bytes" in report.warnings[0]
    assert len(report.warnings) == 1
    with pytest.raises(LogError, match=f"{len(data)} bytes behind its end"):
        read_recordings([tmp_path / name], IngestSettings(strict=True))


def test_a_hole_of_zeros_in_a_database_is_jumped_over(written, tmp_path):
    name, data = written["db3"]
    at = len(data) // 2 // 4096 * 4096
    log, report = read(tmp_path, name, data[:at] + bytes(4096) + data[at + 4096 :])
    assert 20 < log.n_scans < 60
    assert log.stamps_ns[-1] == WORLD.stamps_ns[-1]
    assert re.search(r"lost \d+ single messages", report.warnings[0])


def test_a_text_log_with_a_hole_of_zeros_loses_the_lines_in_it(written, tmp_path):
    name, data = written["carmen"]
    at = len(data) // 2
    log, report = read(tmp_path, name, data[:at] + bytes(2000) + data[at + 2000 :])
    lost = report.dropped["line with null bytes, as unclean shutdowns leave them"]
    assert lost == 1
    assert log.n_scans in range(48, 60)


@pytest.mark.parametrize("container", WRITERS)
@pytest.mark.parametrize("part", ["head", "tail"])
def test_wrong_bytes_never_break_anything(written, container, part, tmp_path):
    name, data = written[container]
    ends = scan_ends(container, data)
    rng = random.Random(f"{container} {part}")
    low, high = {
        "head": (0, 5000),
        "tail": (len(data) - 3000, len(data)),
    }[part]
    for _ in range(6):
        at = rng.randrange(low, high)
        changed = bytearray(data)
        changed[at] ^= rng.randrange(1, 256)
        found = read(tmp_path, name, changed)
        assert found is None or found[0].n_scans <= 60
        assert recovered(found) >= sum(end <= at for end in ends) - 1, at


@pytest.mark.parametrize("container", ["mcap blank", "foxglove protobuf"])
@pytest.mark.parametrize("byte", [0, 1, 4])
def test_behind_a_broken_record_the_next_chunk_is_found_by_the_index(written, container, byte, tmp_path):
    name, data = written[container]
    at = 8
    for _ in range(6):
        while data[at] != CHUNK:
            at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
        place, at = at, at + 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    wrong = b"\0" if byte == 0 else b"\x80"
    log, report = read(tmp_path, name, data[: place + byte] + wrong + data[place + byte + 1 :])
    assert log.n_scans > 50
    assert log.stamps_ns[-1] == WORLD.stamps_ns[-1]
    assert "cut off or damaged" in report.warnings[0]


def test_a_summary_with_a_wrong_byte_is_not_believed(written, tmp_path):
    name, data = written["mcap ros2"]
    (tmp_path / name).write_bytes(data)
    assert summary_state(tmp_path / name) is SummaryState.WHOLE
    at = data.rindex(b"sensor_msgs/msg/LaserScan")
    log, report = read(tmp_path, name, data[:at] + b"S" + data[at + 1 :])
    assert summary_state(tmp_path / name) is SummaryState.BROKEN
    np.testing.assert_array_equal(log.ranges_m, WORLD.ranges_m)
    assert "its summary fails its checksum" in report.warnings[0]
    (tmp_path / name).write_bytes(data[:-9])
    assert summary_state(tmp_path / name) is SummaryState.UNKNOWN


def test_a_definition_with_a_wrong_byte_is_not_believed(written, tmp_path):
    name, data = written["mcap ros2"]
    at = data.rindex(b"angle_increment")
    without_checksum = data[:-12] + bytes(4) + data[-8:]
    log, report = read(tmp_path, name, without_checksum[:at] + b"g" + without_checksum[at + 1 :])
    np.testing.assert_array_equal(log.ranges_m, WORLD.ranges_m)
    assert "has no field angle_increment" in report.warnings[0]


def test_a_folder_without_usable_metadata_is_read_file_by_file(tmp_path):
    folder = write_bag2(tmp_path / "drive", WORLD, StoragePlugin.MCAP)
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 9}\n")
    log, report = read_recordings([folder], SETTINGS)
    np.testing.assert_array_equal(log.ranges_m, WORLD.ranges_m)
    assert "'relative_file_paths' is missing" in report.warnings[0]


def test_metadata_of_a_recorder_that_crashed_name_no_topic_and_the_files_are_read(tmp_path):
    folder = write_bag2(tmp_path / "drive", WORLD)
    metadata = folder / "metadata.yaml"
    content = yaml.safe_load(metadata.read_text())
    content["rosbag2_bagfile_information"].update(message_count=0, topics_with_message_count=[])
    metadata.write_text(yaml.safe_dump(content))
    log, report = read_recordings([folder], SETTINGS)
    np.testing.assert_array_equal(log.ranges_m, WORLD.ranges_m)
    assert "its metadata.yaml names no topic" in report.warnings[0]


def test_metadata_that_speak_of_other_counts_are_said(tmp_path):
    folder = write_bag2(tmp_path / "drive", WORLD)
    metadata = folder / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("message_count: 60", "message_count: 61"))
    log, report = read_recordings([folder], SETTINGS)
    assert log.n_scans == 60
    assert re.search(r"says that it holds \d+ messages .* and holds \d+", report.warnings[0])
