"""`edit`: corrections are recorded, applied at once, and honoured by what comes later."""

import csv
import io
import json
import shutil
import zipfile

import numpy as np
import pytest
import yaml

from dynmap_cli.files.patch_archive import read_patches, read_visits
from dynmap_cli.files.submaps import read_submaps
from tests.cli.conftest import run_dynmap
from tests.golden.test_threads import contents

SETTINGS, FILES, USAGE = 3, 5, 2
AREA = "3.0,5.0\n3.0,6.0\n4.2,6.0\n4.2,5.0\n"


@pytest.fixture
def run_dir(corridor, tmp_path):
    """A private copy of Monday's run: sub-maps 0 and 1 of two states each."""
    shutil.copytree(corridor.run_dir, tmp_path / "run")
    return tmp_path / "run"


@pytest.fixture
def area(tmp_path):
    (tmp_path / "area.csv").write_text(AREA)
    return tmp_path / "area.csv"


def edited(run_dir, *words):
    result = run_dynmap("edit", run_dir, *words, "-q")
    assert result.exit_code == 0, result.output
    return result


def submaps_of(run_dir):
    return {one.submap_id: one for one in read_submaps(run_dir / "submaps")}


def states_of(run_dir):
    archive = run_dir / "patches" / "patches.zip"
    return {
        one.submap_id: {patch.patch_id: patch.support for patch in one.patches}
        for one in read_patches(archive)
    }


def test_states_are_merged(run_dir):
    before = states_of(run_dir)
    done = edited(run_dir, "--merge", "0:0,1")
    assert "cluster: sub-map 0: 1 state in 6 visits (6), merged by hand from 2" in done.stdout.splitlines()
    after = states_of(run_dir)
    assert after == {0: {0: sum(before[0].values())}, 1: before[1]}
    visits = read_visits(run_dir / "patches" / "patches.zip")
    assert {visit.patch for visit in visits if visit.submap_id == 0} == {0}


def test_a_dropped_sub_map_is_gone_everywhere(run_dir, tmp_path):
    edited(run_dir, "--drop", "0")
    assert set(submaps_of(run_dir)) == {1}
    assert set(states_of(run_dir)) == {1}
    assert not (run_dir / "submaps" / "submap_000.pgm").exists()
    line = run_dynmap("explain", run_dir, 0, "-q").stderr
    assert "no sub-map 0; there are 1." in line


def test_a_name_is_shown_wherever_the_sub_map_is(run_dir, tmp_path):
    edited(run_dir, "--name", "1", "lab door")
    for words in (
        ("timeline", run_dir),
        ("explain", run_dir, 1),
        ("export", run_dir, "-o", tmp_path / "out"),
    ):
        assert "sub-map 1 (lab door) at" in run_dynmap(*words, "-q").stdout
        assert "lab door" in run_dynmap(*words, "--json", *(["--force"] if "-o" in words else [])).stdout
    assert "Sub-map 1 (lab door) at" in (run_dir / "report.html").read_text()
    with zipfile.ZipFile(run_dir / "patches" / "patches.zip") as archive:
        entries = json.loads(archive.read("manifest.json"))["submaps"]
    listed = yaml.safe_load((run_dir / "submaps" / "submaps.yaml").read_text())["submaps"]
    for names in (entries, listed):
        assert [entry.get("name") for entry in names] == [None, "lab door"]


def test_a_name_makes_no_result_stale_and_states_that_change_do(run_dir, sample_logs):
    assert run_dynmap("localize", run_dir, sample_logs / "corridor_tuesday.mcap", "-q").exit_code == 0
    assert run_dynmap("timeline", run_dir, "-q").exit_code == 0
    for name in ("lab door", "door of the lab"):
        assert "warning" not in edited(run_dir, "--name", "1", name).stderr
    (run_dir / "edits.yaml").write_text((run_dir / "edits.yaml").read_text().replace("door of", "entry of"))
    assert "warning" not in edited(run_dir).stderr
    lines = edited(run_dir, "--merge", "0:0,1").stderr.splitlines()
    assert [line.split(": ")[1] for line in lines] == ["localization/corridor_tuesday", "timeline"]
    assert run_dynmap("timeline", run_dir, "-q").exit_code == 0
    assert "timeline" not in edited(run_dir).stderr


def test_a_polygon_becomes_a_sub_map_of_its_own(run_dir, area):
    edited(run_dir, "--polygon", "add", area)
    added = submaps_of(run_dir)[2]
    assert added.by_hand
    assert added.owned.sum() * added.frame.resolution_m**2 == pytest.approx(1.2)
    assert states_of(run_dir)[2] == {0: 6}
    result = run_dynmap("explain", run_dir, 2, "-q")
    assert result.exit_code == 0
    assert "cells were added by hand" in result.stdout


def test_a_polygon_around_a_door_learns_the_states_of_the_door(run_dir, area):
    """It takes the place of what was found there."""
    before = states_of(run_dir)
    box = submaps_of(run_dir)[0].rectangle
    left, bottom, right, top = box.left_m - 0.2, box.bottom_m - 0.2, box.right_m + 0.2, box.top_m + 0.2
    area.write_text(f"{left},{bottom}\n{right},{bottom}\n{right},{top}\n{left},{top}\n")
    edited(run_dir, "--polygon", "add", area)
    assert set(submaps_of(run_dir)) == {1, 2}
    assert sorted(states_of(run_dir)[2].values()) == sorted(before[0].values())


def test_everything_is_honoured_by_an_update(run_dir, area, sample_logs):
    """Tuesday sees all doors in all states again: nothing comes back, and numbers stay."""
    edited(run_dir, "--polygon", "add", area, "--merge", "0:0,1", "--name", "2", "shelf", "--drop", "1")
    before, edits = states_of(run_dir), (run_dir / "edits.yaml").read_bytes()
    result = run_dynmap("update", run_dir, sample_logs / "corridor_tuesday.mcap", "-q")
    assert result.exit_code == 0, result.output
    assert "warning" not in result.stderr
    assert (run_dir / "edits.yaml").read_bytes() == edits
    after = states_of(run_dir)
    assert 1 not in after
    assert after[0].keys() == {0}
    assert after[0][0] > before[0][0]
    assert submaps_of(run_dir)[2].name == "shelf"
    assert np.isclose(submaps_of(run_dir)[2].owned.sum() * 0.0025, 1.2)
    found = read_submaps(run_dir / "submaps" / "found")
    assert {0, 1} <= {one.submap_id for one in found}
    assert 2 not in {one.submap_id for one in found}
    with zipfile.ZipFile(run_dir / "patches" / "found.zip") as archive:
        rows = list(csv.DictReader(io.StringIO(archive.read("sequences.csv").decode())))
    assert {row["patch"] for row in rows if row["submap"] == "0"} >= {"0", "1"}
    # And taken back after the update, all is there again under the old numbers.
    for _ in range(4):
        edited(run_dir, "--undo", "1")
    assert {0, 1} <= set(states_of(run_dir))
    assert set(states_of(run_dir)[0]) >= {0, 1}
    assert not (run_dir / "edits.yaml").exists()


def test_undo_takes_back_all_that_a_correction_did(corridor, run_dir):
    edited(run_dir, "--drop", "0")
    edited(run_dir, "--undo", "1")
    for name in ("submaps/submaps.yaml", "submaps/submap_000.pgm", "patches/patches.zip", "report.html"):
        assert (run_dir / name).read_bytes() == (corridor.run_dir / name).read_bytes(), name


@pytest.mark.parametrize(
    ("rounds", "learns"),
    [
        ([("--name", "1", "lab door")], [False]),
        (
            [("--merge", "0:0,1", "--name", "0", "wall"), ("--name", "0", "gate"), ("--undo", "1")],
            [False] * 3,
        ),
        ([("--drop", "0"), ("--name", "1", "lab door"), ("--undo", "1")], [True, False, True]),
        ([("--polygon", "add", "AREA", "--merge", "1:0,1"), ("--drop", "2")], [True, True]),
    ],
)
def test_only_what_a_correction_changes_is_done_again_and_makes_the_same_bytes(run_dir, area, rounds, learns):
    for words, is_learned in zip(rounds, learns, strict=True):
        done = run_dynmap("edit", run_dir, *(area if word == "AREA" else word for word in words))
        assert done.exit_code == 0, done.output
        assert "segment: correcting areas that change" in done.stderr
        assert ("cluster: learning the states of each area" in done.stderr) is is_learned
        assert ("cluster: correcting the states of each area" in done.stderr) is not is_learned
    before = contents(run_dir)
    assert run_dynmap("segment", run_dir, "--force", "-q").exit_code == 0
    assert run_dynmap("cluster", run_dir, "--force", "-q").exit_code == 0
    edited(run_dir)
    assert contents(run_dir) == before


def test_the_list_changes_nothing(run_dir):
    assert edited(run_dir, "--list").stdout == "no correction\n"
    edited(run_dir, "--name", "1", "lab door", "--drop", "0")
    before = contents(run_dir)
    assert edited(run_dir, "--list").stdout.splitlines() == [
        "correction 1: sub-map 1 is called lab door",
        "correction 2: sub-map 0 is dropped",
    ]
    assert run_dynmap("edit", run_dir, "--list", "--drop", "1").exit_code == USAGE
    edited(run_dir)
    assert contents(run_dir) == before


def test_a_list_that_was_changed_by_hand_is_applied(run_dir):
    where = "{submap: 0, rectangle_m: [4.1, 9.75, 4.6, 11.0]}"
    (run_dir / "edits.yaml").write_text(f"format_version: 1\ncorrections:\n- drop: {where}\n")
    edited(run_dir)
    assert set(submaps_of(run_dir)) == {1}
    assert {one.submap_id for one in read_submaps(run_dir / "known")} == {0, 1}
    (run_dir / "edits.yaml").write_text("format_version: 1\ncorrections:\n- paint: {submap: 0}\n")
    before = contents(run_dir)
    result = run_dynmap("edit", run_dir, "-q")
    assert result.exit_code == FILES
    assert "edits.yaml: not a list of corrections (correction 1: " in result.stderr
    assert contents(run_dir) == before


def test_a_build_with_force_keeps_corrections_of_the_same_recordings_only(small, tmp_path):
    words = ("build", small.recording, "-o", small.run_dir, "--force", "-q")
    polygon = tmp_path / "niche.csv"
    polygon.write_text("0,0\n1,0\n1,1\n")
    edited(small.run_dir, "--polygon", "add", polygon)
    assert run_dynmap(*words).exit_code == 0
    assert set(submaps_of(small.run_dir)) == {0}
    other = tmp_path / "again.mcap"
    scenario = small.recording.with_name("room.yaml")
    assert run_dynmap("simulate", scenario, "--seed", "9", "-o", other, "-q").exit_code == 0
    result = run_dynmap("build", other, "-o", small.run_dir, "--force", "-q")
    assert result.exit_code == 0
    assert "edits.yaml.old" in result.stderr
    assert submaps_of(small.run_dir) == {}


@pytest.mark.parametrize(
    ("words", "code", "found"),
    [
        (("--drop", "7"), SETTINGS, "--drop 7: no sub-map 7; there are 0, 1."),
        (("--drop", "1", "--drop", "1"), SETTINGS, "--drop 1: no sub-map 1; there are 0."),
        (("--name", "7", "x"), SETTINGS, "--name 7: no sub-map 7; there are 0, 1."),
        (("--name", "1", " "), SETTINGS, "--name 1: a name has 1 to 60 printable characters"),
        (("--merge", "7:0,1"), SETTINGS, "--merge 7:0,1: no sub-map 7; there are 0, 1."),
        (("--merge", "1:0,5"), SETTINGS, "--merge 1:0,5: no state 5; sub-map 1 has states 0, 1."),
        (("--merge", "1:0,0"), SETTINGS, "two states or more are needed"),
        (("--undo", "1"), SETTINGS, "--undo 1: no such correction; there is none."),
        (("--polygon", "add", "none.csv"), SETTINGS, "none.csv: not a polygon (No such file or directory)."),
        (("--merge", "1"), USAGE, "--merge 1: expected ID:STATE,STATE, for instance 3:0,2"),
        (("--polygon", "remove", "x"), USAGE, "'remove' is not 'add'"),
    ],
)
def test_what_makes_no_sense_is_refused_and_changes_nothing(words, code, found, run_dir):
    before = contents(run_dir)
    result = run_dynmap("edit", run_dir, *words)
    assert result.exit_code == code
    assert found in result.stderr
    assert "up to date" not in result.stderr
    assert contents(run_dir) == before


def test_a_polygon_outside_of_the_map_is_refused(run_dir, tmp_path):
    far = tmp_path / "far.csv"
    far.write_text("100,0\n101,0\n101,1\n")
    result = run_dynmap("edit", run_dir, "--polygon", "add", far, "-q")
    assert result.exit_code == SETTINGS
    assert "no cell of the map lies in this polygon; the map is x " in result.stderr


def test_a_run_that_is_not_there_or_not_finished_is_refused(run_dir, tmp_path):
    missing = run_dynmap("edit", tmp_path / "none", "--list")
    assert missing.exit_code == FILES
    assert not (tmp_path / "none").exists()
    scans = run_dir / "scans" / "ranges_m.npy"
    scans.rename(tmp_path / "away.npy")
    before = contents(run_dir)
    assert run_dynmap("edit", run_dir, "--drop", "0", "-q").exit_code == FILES
    assert contents(run_dir) == before
    (tmp_path / "away.npy").rename(scans)
    shutil.rmtree(run_dir / "map")
    unfinished = run_dynmap("edit", run_dir, "--drop", "0", "-q")
    assert unfinished.exit_code == FILES
    assert "stage 'map' is not done here" in unfinished.stderr
