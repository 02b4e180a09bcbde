"""Recordings of strangers: nothing unpacks without bound, writes elsewhere, is seen by others, or is run."""

import ast
import os
import re
import stat
import zipfile
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType
from rosbags.rosbag2 import CompressionMode

import dynmap_cli
from dynmap_cli.config import Config
from dynmap_cli.errors import ArtifactError, LogError
from dynmap_cli.ingest import reading
from dynmap_cli.ingest.containers import unpacking
from dynmap_cli.ingest.containers.opening import check_path, find_sources
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from dynmap_cli.runs.pipeline import run_one
from tests.ingest.corpus import FILES, FOLDERS
from tests.ingest.written import World, write_bag2, write_mcap

SETTINGS = IngestSettings()


@pytest.mark.parametrize("variant", ["ros1 bz2", "ros1 lz4", "mcap ros2", "mcap ros2 lz4", "mcap blank"])
def test_blocks_of_messages_unpack_to_so_much_and_no_more(variant, tmp_path, monkeypatch):
    path = FILES[variant](tmp_path)
    assert read_recordings([path], SETTINGS)[0].n_scans == 60
    monkeypatch.setattr(unpacking, "MOST_UNPACKED", 500)
    _, report = read_recordings([path], SETTINGS)
    assert re.search(r"lost .*\d+ blocks of messages", report.warnings[0])


@pytest.mark.parametrize("how", ["bz2", "lz4", "zstd"])
def test_what_is_unpacked_in_one_go_is_bounded(how, monkeypatch):
    import bz2

    import lz4.frame
    import zstandard

    pack = {"bz2": bz2.compress, "lz4": lz4.frame.compress, "zstd": zstandard.ZstdCompressor().compress}[how]
    content = bytes(range(256)) * 40
    assert unpacking.unpack_whole(pack(content), how) == content
    with pytest.raises((ValueError, zstandard.ZstdError)):
        unpacking.unpack_whole(pack(content)[:-9], how)
    monkeypatch.setattr(unpacking, "MOST_UNPACKED", 1 << 20)
    with pytest.raises(ValueError, match="more than 1 MiB"):
        unpacking.unpack_whole(pack(bytes(5 << 20)), how)


@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.NONE])
def test_packed_files_of_a_folder_count_against_the_limit(mode, tmp_path):
    folder = write_bag2(tmp_path / "drive", World(), mode=mode)
    settings = IngestSettings(max_unpacked_gib=4096 / 2**30)
    if mode is CompressionMode.NONE:
        assert read_recordings([folder], settings)[0].n_scans == 12
    else:
        with pytest.raises(LogError, match="max_unpacked_gib"):
            read_recordings([folder], settings)


def test_a_packed_file_of_a_folder_that_is_cut_off_is_read_as_far_as_it_goes(tmp_path):
    folder = write_bag2(
        tmp_path / "drive", World(n_scans=600, n_beams=200, step_rad=0.02), mode=CompressionMode.FILE
    )
    (file,) = folder.glob("*.zstd")
    file.write_bytes(file.read_bytes()[: file.stat().st_size * 3 // 4])
    log, report = read_recordings([folder], SETTINGS)
    assert 100 < log.n_scans < 600
    assert "drive.db3.zstd is damaged or cut off: it ends in the middle" in report.warnings[0]
    with pytest.raises(LogError, match="cut off"):
        read_recordings([folder], IngestSettings(strict=True))


@pytest.mark.parametrize("member", ["/tmp/dynmap-escaped.bag", "a/../../escaped.bag", "..", "a\0b.bag"])
def test_members_of_a_zip_stay_inside(member, tmp_path):
    path = tmp_path / "inner" / "evil.zip"
    path.parent.mkdir()
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("placeholder", "x")
    data = path.read_bytes()
    name = member.encode()
    grown = len(name) - len("placeholder")
    whole = data.replace(b"placeholder", name)
    whole = bytearray(whole)
    whole[26:28] = len(name).to_bytes(2, "little")
    central = whole.index(b"PK\x01\x02")
    whole[central + 28 : central + 30] = len(name).to_bytes(2, "little")
    end = whole.index(b"PK\x05\x06")
    whole[end + 12 : end + 20] = (end - central).to_bytes(4, "little") + central.to_bytes(4, "little")
    assert len(whole) == len(data) + 2 * grown
    # With its list of members, and without.
    for content in (bytes(whole), bytes(whole[:central])):
        path.write_bytes(content)
        before = sorted(tmp_path.rglob("*"))
        with pytest.raises(LogError):
            read_recordings([path], SETTINGS)
        assert sorted(tmp_path.rglob("*")) == before
    assert not Path("/tmp/dynmap-escaped.bag").exists()


def test_what_is_unpacked_is_private_and_gone_afterwards(tmp_path, monkeypatch):
    seen = []

    def find(path, scratch, limit_bytes):
        seen.append((scratch, stat.S_IMODE(scratch.stat().st_mode)))
        return find_sources(path, scratch, limit_bytes)

    monkeypatch.setattr(reading, "find_sources", find)
    read_recordings([FILES["carmen gz"](tmp_path)], SETTINGS)
    ((scratch, mode),) = seen
    assert mode == 0o700
    assert not scratch.exists()


def test_sizes_in_a_message_are_held_against_its_bytes(tmp_path):
    """A count of ranges of two thousand millions in a message of a few bytes."""
    path = write_mcap(
        tmp_path / "a.mcap", World(), "ros2", compression=CompressionType.NONE, enable_crcs=False
    )
    data = path.read_bytes()
    ranges = World().ranges_m[5].tobytes()
    at = data.index(ranges) - 4
    assert int.from_bytes(data[at : at + 4], "little") == 9
    path.write_bytes(data[:at] + (2_000_000_000).to_bytes(4, "little") + data[at + 4 :])
    log, report = read_recordings([path], SETTINGS)
    assert log.n_scans == 11
    assert report.dropped["message on /scan that cannot be decoded"] == 1
    assert np.isfinite(log.odometry).all()


def test_no_module_runs_what_it_reads():
    """No pickle, no eval, no full YAML loader, no arrays of objects."""
    for path in Path(dynmap_cli.__file__).parent.rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            names = (
                [alias.name for alias in node.names] if isinstance(node, ast.Import | ast.ImportFrom) else []
            )
            assert not {"pickle", "marshal", "shelve", "dill"} & set(names), path
            if isinstance(node, ast.Call):
                called = ast.unparse(node.func)
                assert called not in {"eval", "exec", "np.load", "yaml.load", "yaml.unsafe_load"}, path


@pytest.mark.parametrize("inside", ["", "run"])
def test_an_output_that_is_or_lies_in_the_recording_is_refused(tmp_path, inside):
    folder = FOLDERS["folder db3"](tmp_path)
    before = sorted(folder.rglob("*"))
    with pytest.raises(ArtifactError, match="is, or lies in, the recording that is read"):
        run_one(folder / inside, "ingest", Config(), threads=1, force=False, recordings=[folder])
    assert sorted(folder.rglob("*")) == before


def test_a_name_that_is_no_text_is_refused(tmp_path):
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/a\xff.db3"))
    path.write_bytes(b"SQLite format 3")
    with pytest.raises(LogError, match="its name is no UTF-8 text; rename it"):
        check_path(path)
