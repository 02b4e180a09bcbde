"""`update`: as a build of all recordings, with the numbers of before; what does not fit changes nothing."""

import io
import json
import shutil
import zipfile

import numpy as np
import pytest
import yaml

from dynmap_cli.files.patch_archive import read_patches, read_visits
from dynmap_cli.files.publishing import SWAPPED_IN
from dynmap_cli.files.submaps import read_submaps
from tests.cli.conftest import run_dynmap
from tests.golden.test_threads import contents

RECORDING, FILES = 4, 5
MADE_OF_ALL = ("map.pgm", "map.yaml", "trajectory.tum", "trajectory.g2o", "edges.csv", "loops.csv", "em.csv")


@pytest.fixture(scope="module")
def logs(sample_logs):
    return [sample_logs / f"corridor_{day}.mcap" for day in ("monday", "tuesday")]


@pytest.fixture(scope="module")
def updated(corridor, logs, tmp_path_factory):
    """Monday's run with Tuesday added."""
    run_dir = tmp_path_factory.mktemp("updated") / "run"
    shutil.copytree(corridor.run_dir, run_dir)
    result = run_dynmap("update", run_dir, logs[1], "-q")
    assert result.exit_code == 0, result.output
    return run_dir


@pytest.fixture(scope="module")
def built(logs, tmp_path_factory):
    """Both days built in one go."""
    run_dir = tmp_path_factory.mktemp("built") / "run"
    assert run_dynmap("build", *logs, "-o", run_dir, "-q").exit_code == 0
    return run_dir


def test_an_update_equals_a_build_of_all(updated, built):
    one, other = contents(updated), contents(built)
    same = [f"map/{name}" for name in MADE_OF_ALL]
    same += [name for name in other if name.startswith("scans/") and "manifest" not in name]
    assert [name for name in same if one[name] != other[name]] == []
    assert len(read_submaps(updated / "submaps")) == len(read_submaps(built / "submaps"))


def test_sub_maps_and_states_keep_their_numbers_and_counts_grow(corridor, updated):
    before = {one.submap_id: one for one in corridor.patch_sets}
    after = {one.submap_id: one for one in read_patches(updated / "patches" / "patches.zip")}
    assert set(before) <= set(after)
    for door in corridor.doors():
        number = corridor.submap_of(door).submap_id
        old, new = before[number].patches, {patch.patch_id: patch for patch in after[number].patches}
        for patch in old:
            assert new[patch.patch_id].support >= patch.support
        assert sum(patch.support for patch in new.values()) > sum(patch.support for patch in old)
    recordings = {visit.recording for visit in read_visits(updated / "patches" / "patches.zip")}
    assert recordings == {"corridor_monday.mcap", "corridor_tuesday.mcap"}


def test_a_later_build_of_all_finds_everything_done(updated, logs):
    result = run_dynmap("build", *logs, "-o", updated, "--json", "-q")
    assert not any(stage["ran"] for stage in json.loads(result.stdout)["stages"].values())


def test_a_recording_that_is_there_already_adds_nothing(updated, logs):
    before = contents(updated)
    result = run_dynmap("update", updated, logs[1])
    assert result.exit_code == 0
    assert "is in" in result.stderr
    assert contents(updated) == before


@pytest.mark.parametrize(
    ("start", "found"),
    [
        ("2026-03-04T07:30:00Z", "elsewhere.mcap: does not fit on the map of corridor_monday.mcap: "),
        (None, "corridor_monday.mcap and elsewhere.mcap: they overlap in time"),
    ],
)
def test_what_does_not_fit_changes_nothing(start, found, corridor, sample_logs, tmp_path):
    run_dir = tmp_path / "run"
    shutil.copytree(corridor.run_dir, run_dir)
    world = yaml.safe_load((sample_logs.parent / "configs" / "worlds" / "four_places.yaml").read_text())
    world["robot"] |= {"repeat": 2, "pause_s": 1}
    (tmp_path / "elsewhere.yaml").write_text(yaml.safe_dump(world | ({"start": start} if start else {})))
    other = tmp_path / "elsewhere.mcap"
    assert run_dynmap("simulate", tmp_path / "elsewhere.yaml", "-o", other, "-q").exit_code == 0
    before = contents(run_dir)
    result = run_dynmap("update", run_dir, other, "-q")
    assert result.exit_code == RECORDING
    assert found in result.stderr
    assert contents(run_dir) == before


@pytest.mark.parametrize("moved", ["nothing", "known", "scans", "map"])
def test_an_update_that_was_killed_while_it_took_its_place_goes_on(moved, corridor, updated, logs, tmp_path):
    """It was made to the end; then some files had been moved, and the manifest of one stage was gone."""
    run_dir = tmp_path / "run"
    shutil.copytree(corridor.run_dir, run_dir)
    made = run_dir / SWAPPED_IN
    shutil.copytree(updated, made)
    (made / "scans" / "left_over.part").write_text("")
    (run_dir / ".update.part").mkdir()
    if moved == "known":
        (made / "known").rename(run_dir / "known")
    elif moved != "nothing":
        (run_dir / moved / f"{'ingest' if moved == 'scans' else moved}.manifest.json").unlink()
        for name in list((made / moved).iterdir())[:3]:
            if not name.name.endswith(".manifest.json"):
                name.replace(run_dir / moved / name.name)
    assert run_dynmap("update", run_dir, logs[1], "-q").exit_code == 0
    one, other = contents(run_dir), contents(updated)
    assert sorted(one) == sorted(other)
    assert [name for name in other if one[name] != other[name]] == []


def test_seed_and_settings_of_localize_stay(corridor, updated, tmp_path):
    run_dir = tmp_path / "run"
    shutil.copytree(updated, run_dir)
    noted = yaml.safe_load((run_dir / "run.yaml").read_text())
    noted["settings"]["seed"] = 7
    noted["settings"]["localization"]["max_particles"] = 4321
    (run_dir / "run.yaml").write_text(yaml.safe_dump(noted))
    assert run_dynmap("edit", run_dir, "--name", "0", "door", "-q").exit_code == 0
    settings = yaml.safe_load((run_dir / "run.yaml").read_text())["settings"]
    assert settings["seed"] == 7
    assert settings["localization"]["max_particles"] == 4321
    (run_dir / "run.yaml").write_text("not: [a run")
    result = run_dynmap("edit", run_dir, "--name", "0", "gate", "-q")
    assert result.exit_code == 0
    assert "run.yaml: cannot be read" in result.stderr


@pytest.mark.parametrize(
    ("key", "value", "found"),
    [
        (
            "states",
            "objects",
            "localization.states = 'objects' is not allowed: `belief` replaces it (States: ",
        ),
        ("gone", 1, "unknown setting 'gone' in section 'localization'"),
    ],
)
def test_a_setting_of_another_version_is_one_of_run_yaml(small, sample_logs, key, value, found):
    path = small.run_dir / "run.yaml"
    noted = yaml.safe_load(path.read_text())
    noted["settings"]["localization"][key] = value
    path.write_text(yaml.safe_dump(noted))
    result = run_dynmap("update", small.run_dir, sample_logs / "corridor_tuesday.mcap")
    assert result.exit_code == 3
    (line,) = result.stderr.splitlines()
    assert line.startswith(f"dynmap: {path}: {found}")
    assert line.endswith("Correct it in this file, nothing of the run has to be made again.")


def test_a_setting_of_another_version_is_one_of_its_stage(small):
    path = small.run_dir / "map" / "map.manifest.json"
    manifest = json.loads(path.read_text())
    manifest["settings"]["resolution_m"] = -1
    path.write_text(json.dumps(manifest))
    result = run_dynmap("edit", small.run_dir, "-q")
    assert result.exit_code == 3
    assert result.stderr.startswith(f"dynmap: {path}: map.resolution_m = -1 is not allowed: ")
    assert f"run `dynmap build LOG -o {small.run_dir} --force`." in result.stderr


def test_a_run_that_is_not_finished_is_refused(corridor, logs, tmp_path):
    run_dir = tmp_path / "run"
    shutil.copytree(corridor.run_dir, run_dir)
    shutil.rmtree(run_dir / "patches")
    result = run_dynmap("update", run_dir, logs[1], "-q")
    assert result.exit_code == FILES
    assert "stage 'cluster' is not done here" in result.stderr
    missing = run_dynmap("update", tmp_path / "none", logs[1], "-q")
    assert missing.exit_code == FILES
    assert "no such run directory" in missing.stderr


def test_what_was_known_is_in_the_run(corridor, updated):
    known = updated / "known"
    assert (known / "patches.zip").read_bytes() == (corridor.run_dir / "patches/patches.zip").read_bytes()
    with zipfile.ZipFile(io.BytesIO((known / "patches.zip").read_bytes())) as archive:
        assert "manifest.json" in archive.namelist()
    assert np.array_equal(
        [one.submap_id for one in read_submaps(known)],
        [one.submap_id for one in read_submaps(corridor.run_dir / "submaps")],
    )
