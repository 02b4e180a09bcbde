"""Compressed recordings that are cut off, salvaged and cleaned."""

import pytest

from dynmap_cli.errors import LogError
from dynmap_cli.export.salvaging import write_salvaged
from dynmap_cli.export.sources import copy_sources
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from tests.cli.conftest import run_dynmap
from tests.ingest.corpus import FILES

SETTINGS, STRICT = IngestSettings(), IngestSettings(strict=True)


@pytest.mark.parametrize("variant", ["mcap in gz", "mcap in zip", "ros1 in gz", "ros1 in zip"])
def test_what_can_be_unpacked_is_salvaged(variant, tmp_path):
    path = FILES[variant](tmp_path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    log, _ = read_recordings([path], SETTINGS)
    done = write_salvaged([path], tmp_path / "out.mcap", SETTINGS)
    again, report = read_recordings([tmp_path / "out.mcap"], STRICT)
    assert again.n_scans == log.n_scans > 20
    assert not report.damage
    assert "damaged or cut off: it ends in the middle" in done.losses[0] or "zip" in variant
    with pytest.raises(LogError, match="--strict"):
        copy_sources([path], STRICT, lambda *_: None)


def test_a_text_log_is_cleaned_as_far_as_it_could_be_unpacked(tmp_path):
    path = FILES["carmen gz"](tmp_path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    result = run_dynmap("clean", path, "-o", tmp_path / "clean.mcap", "--threads", 1)
    assert result.exit_code == 0, result.output
    assert (
        "packed.gz: the gzip file is damaged or cut off: it ends in the middle; cleaned as far"
        in result.stdout
    )
