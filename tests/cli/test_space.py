"""Each stage looks for room on the disk before it begins."""

import shutil

import pytest

from dynmap_cli.config import Config
from dynmap_cli.errors import ArtifactError
from dynmap_cli.files.space import check_space
from dynmap_cli.runs.floor_plan import STAGES
from dynmap_cli.runs.pipeline import context_of, run_one

FREE_BYTES = 1000


@pytest.fixture
def full_disk(monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(10**9, 0, FREE_BYTES))


def test_what_is_needed_is_said_where_it_is_much(tmp_path, monkeypatch, caplog):
    caplog.set_level("INFO")
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(9 * 10**9, 0, 7 * 10**9))
    check_space("map", "1000 scans", 10**7, tmp_path)
    assert caplog.text == ""
    check_space("map", "1000 scans", 3 * 10**9, tmp_path / "not" / "there")
    assert "map: 1000 scans need about 3.0 GB on the disk, 7.0 GB are free" in caplog.text
    with pytest.raises(
        ArtifactError, match=r"^map: 7.1 GB are needed on the disk of .* for 1000 scans, 7.0 GB"
    ):
        check_space("map", "1000 scans", 71 * 10**8, tmp_path)


@pytest.mark.parametrize("name", [stage.name for stage in STAGES if stage.needs])
def test_a_stage_is_refused_where_the_disk_is_full_and_its_files_stay(made, full_disk, unharmed, name):
    before = unharmed(made.run_dir)
    with pytest.raises(
        ArtifactError, match=f"^{name}: .* are needed on the disk of .*, 1.0 kB are free. Free"
    ) as no:
        run_one(made.run_dir, name, Config(), threads=1, force=True)
    assert "\n" not in str(no.value) and no.value.exit_code == 5
    assert unharmed(made.run_dir) == before


def test_the_room_a_map_needs_grows_with_its_beams(made):
    stage = next(stage for stage in STAGES if stage.name == "map")
    what, n_bytes = stage.needs(context_of(made.run_dir, Config(), 1, ()))
    assert what.endswith(" scans")
    assert n_bytes > (made.run_dir / "map" / "beams.npz").stat().st_size
