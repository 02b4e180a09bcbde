"""Copies of recordings with what is too large for the memory: left out with a count, or copied as it lies."""

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType

from dynmap_cli.export import messages
from dynmap_cli.export.salvaging import write_salvaged
from dynmap_cli.ingest.containers import mcap_chunks, mcap_records
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from tests.ingest.corpus import FILES, WORLD
from tests.ingest.written import START_NS, write_mcap

LARGE = 100_000


@pytest.fixture(autouse=True)
def small_limit(monkeypatch):
    monkeypatch.setattr(messages, "LARGEST_COPIED", LARGE)
    monkeypatch.setattr(mcap_records, "LARGEST_COPIED", LARGE)


def add_large(writer):
    """A message and an attachment that are too large, and others that are not."""
    schema = writer.register_schema("std_msgs/msg/ByteMultiArray", "ros2msg", b"byte[] data")
    channel = writer.register_channel("/large", "cdr", schema)
    writer.add_message(channel, START_NS, bytes(LARGE + 1), START_NS)
    writer.add_message(channel, START_NS, bytes(LARGE), START_NS)


def add_large_attachment(writer):
    writer.add_attachment(1, 2, "large", "text/plain", bytes(2 * LARGE))
    writer.add_attachment(1, 2, "small", "text/plain", b"a note")


@pytest.mark.parametrize("cut_bytes", [0, 12])
def test_a_message_that_is_too_large_is_left_out_of_a_copy_and_said(cut_bytes, tmp_path):
    path = write_mcap(tmp_path / "a.mcap", WORLD, "ros2", prepare=add_large)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) - cut_bytes])
    done = write_salvaged([path], tmp_path / "out.mcap", IngestSettings())
    assert done.messages["/large"] == 1
    (said,) = [line for line in done.lines() if "not copied" in line]
    assert (
        "lost 1 single messages" in said.replace("bytes, 1 single", "1 single") or "1 single messages" in said
    )
    log, report = read_recordings([tmp_path / "out.mcap"], IngestSettings(strict=True))
    np.testing.assert_array_equal(log.ranges_m, WORLD.ranges_m)
    assert not report.warnings


def test_an_attachment_that_is_too_large_is_left_out_of_a_copy_and_said(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", WORLD, "ros2", prepare=add_large_attachment)
    done = write_salvaged([path], tmp_path / "out.mcap", IngestSettings())
    assert any("an attachment of more than" in line for line in done.lines())
    with (tmp_path / "out.mcap").open("rb") as stream:
        assert [one.name for one in make_reader(stream).iter_attachments()] == ["small"]


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD])
def test_a_file_of_which_too_much_overlaps_is_read_and_copied_as_it_lies(compression, tmp_path, monkeypatch):
    path = write_mcap(tmp_path / "a.mcap", WORLD, "ros2", compression=compression)
    monkeypatch.setattr(mcap_chunks, "_MOST_BYTES_TOGETHER", 1000)
    log, report = read_recordings([path], IngestSettings())
    np.testing.assert_array_equal(log.ranges_m, WORLD.ranges_m)
    assert not report.warnings
    done = write_salvaged([path], tmp_path / "out.mcap", IngestSettings())
    assert done.messages.total() == 181
    assert not done.losses


@pytest.mark.parametrize("variant", ["mcap unchunked", "mcap unindexed"])
def test_a_file_without_index_is_copied_whole(variant, tmp_path):
    path = FILES[variant](tmp_path)
    done = write_salvaged([path], tmp_path / "out.mcap", IngestSettings())
    assert done.messages.total() == 181
    log, _ = read_recordings([tmp_path / "out.mcap"], IngestSettings(strict=True))
    np.testing.assert_array_equal(log.ranges_m, WORLD.ranges_m)
