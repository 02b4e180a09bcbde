"""Every variant of every container: read back as it was written, and cut off or damaged anywhere."""

import os
import random
import shutil

import numpy as np
import pytest

from dynmap_cli.errors import LogError
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from tests.fuzz.law import obey
from tests.ingest.corpus import FILES, FOLDERS, WORLD, scans_within, text_ranges_m, wean_ranges_cm

SETTINGS = IngestSettings()
STRICT = IngestSettings(strict=True)
PLACES = int(os.environ.get("DYNMAP_CORPUS_PLACES", "6"))
"""How many places of each file are tried; `make damage` tries 200."""


def expected_ranges_m(variant):
    """Ranges of all scans as the container can hold them."""
    if variant.startswith("carmen"):
        ranges_m = text_ranges_m()
        ranges_m[:, 0] = np.nan
        return ranges_m.astype(np.float32)
    return (wean_ranges_cm() * 0.01).astype(np.float32) if variant.startswith("wean") else WORLD.ranges_m


@pytest.mark.parametrize("variant", [*FILES, *FOLDERS])
def test_every_variant_reads_back_what_was_written(variant, tmp_path):
    path = {**FILES, **FOLDERS}[variant](tmp_path)
    log, report = read_recordings([path], SETTINGS)
    expected = expected_ranges_m(variant)
    found = np.where(np.isinf(log.ranges_m), np.nan, log.ranges_m)
    np.testing.assert_allclose(found, np.where(np.isinf(expected), np.nan, expected), rtol=1e-6)
    assert (np.diff(log.stamps_ns) == 10**8).all()
    poses = np.column_stack([0.05 * np.arange(60), np.zeros(60), np.full(60, 0.3)])
    np.testing.assert_allclose(log.odometry, poses if "wean" in variant else WORLD.poses, atol=1e-6)
    assert not report.dropped
    if "unindexed" not in variant or "mcap" in variant:
        assert not report.damage


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Each file once, as bytes."""
    return {
        variant: (path.name, path.read_bytes())
        for variant, write in FILES.items()
        for path in [write(tmp_path_factory.mktemp("whole"))]
    }


def recovered(folder, name, data, settings=SETTINGS):
    """Scans that were used or left out with a count, and what is said of damage; by the law of all readers."""
    folder.mkdir()
    (folder / name).write_bytes(data)
    found = []
    refusal = obey(lambda folder: found.append(read_recordings([folder / name], settings)), folder)
    shutil.rmtree(folder)
    if refusal is not None:
        assert isinstance(refusal, LogError)
        assert name in str(refusal)
        return 0, [str(refusal)]
    ((log, report),) = found
    return log.n_scans + sum(report.dropped.values()), report.damage


@pytest.mark.parametrize("variant", FILES)
def test_of_a_file_that_is_cut_anywhere_all_scans_before_are_recovered(written, variant, tmp_path):
    name, data = written[variant]
    assert scans_within(variant, data, len(data)) == 60
    rng = random.Random(f"cut {variant}")
    for cut in sorted(rng.randrange(len(data)) for _ in range(PLACES)):
        count, damage = recovered(tmp_path / "cut", name, data[:cut])
        expected = scans_within(variant, data, cut)
        assert count >= expected, cut
        if " " in variant and name.startswith("packed"):
            assert damage, cut
            assert recovered(tmp_path / "strict", name, data[:cut], STRICT)[0] == 0


@pytest.mark.parametrize("variant", FILES)
def test_of_a_file_with_a_wrong_byte_all_scans_before_are_recovered(written, variant, tmp_path):
    name, data = written[variant]
    rng = random.Random(f"flip {variant}")
    for at in sorted(rng.randrange(len(data)) for _ in range(PLACES)):
        changed = bytearray(data)
        changed[at] ^= rng.randrange(1, 256)
        count, _ = recovered(tmp_path / "flip", name, bytes(changed))
        # One message may be taken for another, or its end for its own.
        assert count >= scans_within(variant, data, at) - 1, at


def test_of_a_zip_whose_list_points_beside_its_file_all_is_recovered(written, tmp_path):
    name, data = written["carmen zip"]
    changed = bytearray(data)
    changed[data.rindex(b"PK\x01\x02") + 42] ^= 0xAA
    count, damage = recovered(tmp_path / "beside", name, bytes(changed))
    assert count == 60
    assert "the list of its files is missing or damaged" in " ".join(damage)
