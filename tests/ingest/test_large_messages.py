"""Messages larger than any laser sends, and files of one name in a .zip: said, not taken."""

import zipfile

import numpy as np
import pytest

from dynmap_cli.errors import LogError
from dynmap_cli.ingest.messages.batches import MOST_MESSAGE_BYTES
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from tests.ingest.written import World, write_bag1, write_mcap


@pytest.mark.parametrize("write", [write_bag1, lambda path, world: write_mcap(path, world, "ros2")])
def test_a_message_that_is_larger_than_any_is_left_out_and_said(write, tmp_path):
    def enlarge(number, fields):
        if number == 5:
            fields["ranges"] = np.ones(MOST_MESSAGE_BYTES // 4, dtype=np.float32)

    path = write(tmp_path / ("a.bag" if write is write_bag1 else "a.mcap"), World(change=enlarge))
    log, report = read_recordings([path], IngestSettings())
    assert log.n_scans == World().n_scans - 1
    said = "message on /scan of more than 16 MiB"
    assert report.dropped[said] == 1
    assert said in report.damage


def test_files_of_one_name_are_not_written_over_one_another(tmp_path):
    inner = write_bag1(tmp_path / "a.bag", World())
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.write(inner, "a.bag")
        with pytest.warns(UserWarning, match="Duplicate"):
            archive.write(inner, "a.bag")
    with pytest.raises(LogError, match=r"holds 2 files of the name 'a\.bag'\. Unpack it"):
        read_recordings([path], IngestSettings())
