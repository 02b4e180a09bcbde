"""What a folder holds from before is not replaced unasked, and a stage that runs again says why."""

import json
import shutil

import pytest

from tests.cli.conftest import run_dynmap


@pytest.fixture(scope="module")
def other(made, tmp_path_factory):
    """Another recording with the name of the first."""
    path = tmp_path_factory.mktemp("other") / made.recording.name
    scenario = made.recording.parent / "room.yaml"
    assert run_dynmap("simulate", scenario, "-o", path, "--seed", 4, "-q").exit_code == 0
    return path


@pytest.mark.parametrize("verb", [("build",), ("build", "--from", "ingest"), ("ingest",)])
def test_a_run_of_another_recording_is_kept(small, other, unharmed, verb):
    before = unharmed(small.run_dir)
    result = run_dynmap(*verb, other, "-o", small.run_dir)
    assert result.exit_code == 5
    assert unharmed(small.run_dir) == before
    line = result.stderr.splitlines()[-1]
    for words in (str(small.recording), str(other), "another output with -o", "--force"):
        assert words in line


def test_the_same_recording_elsewhere_is_the_same(small, tmp_path):
    moved = tmp_path / "moved.mcap"
    shutil.copy(small.recording, moved)
    assert run_dynmap("ingest", moved, "-o", small.run_dir, "-q").exit_code == 0


def test_force_replaces_a_run(small, other):
    assert run_dynmap("ingest", other, "-o", small.run_dir, "--force", "-q").exit_code == 0
    assert run_dynmap("ingest", small.recording, "-o", small.run_dir, "-q").exit_code == 5


def test_localizing_another_recording_of_the_same_name(small, other, unharmed):
    assert run_dynmap("localize", small.run_dir, small.recording, "-q").exit_code == 0
    before = unharmed(small.run_dir)
    result = run_dynmap("localize", small.run_dir, other, "-q")
    assert result.exit_code == 5
    assert str(other) in result.stderr
    assert str(small.run_dir / "localization" / "room") in result.stderr
    assert unharmed(small.run_dir) == before
    assert run_dynmap("localize", small.run_dir, other, "--force", "-q").exit_code == 0


def test_a_stage_says_which_setting_changed(small):
    words = ("segment", small.run_dir, "--set", "segmentation.min_cells=7")
    lines = run_dynmap(*words).stderr.splitlines()
    assert any(
        line.startswith("segment: runs again, segmentation.min_cells ") and line.endswith(" -> 7")
        for line in lines
    )
    assert "runs again" not in run_dynmap(*words).stderr


def test_a_stage_says_which_file_changed(small):
    (small.run_dir / "submaps" / "submaps.yaml").unlink()
    assert "segment: runs again, missing or damaged: " in run_dynmap("segment", small.run_dir).stderr
    assert run_dynmap("map", small.run_dir, "--set", "map.resolution_m=0.1", "-q").exit_code == 0
    assert "segment: runs again, changed: map/" in run_dynmap("segment", small.run_dir).stderr


def test_results_of_an_older_map_are_named_until_they_are_made_again(small):
    localize = ("localize", small.run_dir, small.recording, "-q")
    build = ("build", small.recording, "-o", small.run_dir, "-q")
    assert "older map" not in run_dynmap(*localize).stderr
    assert run_dynmap("compare", small.run_dir, small.recording, "-q").exit_code == 0
    assert "older map" not in run_dynmap(*build).stderr
    coarser = (*build, "--set", "map.resolution_m=0.1")
    for words in (coarser, coarser):
        said = run_dynmap(*words)
        assert said.exit_code == 0
        assert [line.split(":")[1].strip() for line in said.stderr.splitlines() if "older map" in line] == [
            "localization/room",
            "comparison/room",
        ]
    assert json.loads(run_dynmap(*coarser, "--json").stdout)["outdated"]
    assert [line.split(":")[1] for line in run_dynmap(*localize).stderr.splitlines() if "older" in line] == [
        " comparison/room"
    ]


def test_a_folder_that_is_not_written_any_more_goes(small):
    out = small.run_dir / "localization" / "room"
    words = ("localize", small.run_dir, small.recording, "-q")
    assert run_dynmap(*words, "--smooth").exit_code == 0
    assert (out / "smoothed" / "states.csv").is_file()
    assert run_dynmap(*words).exit_code == 0
    assert not (out / "smoothed").exists()
