"""`export`, `timeline` and `explain`: what a finished run tells, and that it stays as it was."""

import csv
import json
import re
import shutil

import numpy as np
import pytest

from dynmap_cli.domain.grid import FREE, OCCUPIED
from dynmap_cli.files.patch_archive import read_visits
from dynmap_cli.files.pgm import read_map
from dynmap_cli.files.submaps import read_submaps
from dynmap_cli.files.trajectory import format_stamp, parse_stamp
from dynmap_cli.history.timeline import TIMELINE_HEADER
from tests.cli.conftest import run_dynmap
from tests.cli.test_readme import OUTPUTS

SETTINGS, FILES = 3, 5
VERBS = {"export": ("--state", "latest", "-o", "out"), "timeline": ("-o", "out"), "explain": ("0",)}


def words_of(verb, run_dir, tmp_path):
    """A call of a verb with all that it needs."""
    return (verb, run_dir, *(tmp_path / word if word == "out" else word for word in VERBS[verb]), "-q")


def refused(code, *words):
    """Run a command that has to fail with one line; returns that line."""
    result = run_dynmap(*words)
    assert result.exit_code == code, result.output
    assert result.stdout == ""
    (line,) = result.stderr.splitlines()
    assert line.startswith("dynmap: ")
    return line


def exported(corridor, state, out):
    """The map and what was said of each sub-map."""
    result = run_dynmap("export", corridor.run_dir, "--state", state, "-o", out, "--json", "-q")
    assert result.exit_code == 0, result.output
    grid, warnings = read_map(out / "map.yaml")
    assert warnings == []
    return grid, json.loads(result.stdout)


def doorway(corridor, grid, door):
    """Share of the line from hinge to latch, away from the jambs, that has something occupied within two cells."""
    hinge, latch = corridor.doors()[door]
    line = hinge + np.linspace(0.25, 0.75, 30)[:, None] * (latch - hinge)
    cells = grid.frame.to_cells(line)
    around = [grid.cells[row - 2 : row + 3, col - 2 : col + 3] for row, col in cells]
    return np.mean([(window == OCCUPIED).any() for window in around])


def visits_of(corridor, door):
    archive = corridor.run_dir / "patches" / "patches.zip"
    number = corridor.submap_of(door).submap_id
    return sorted(
        (v for v in read_visits(archive) if v.submap_id == number and v.patch is not None),
        key=lambda v: v.start_ns,
    )


def test_open_opens_all_doors_and_union_closes_them(corridor, tmp_path):
    is_open, _ = exported(corridor, "open", tmp_path / "open")
    is_closed, _ = exported(corridor, "union", tmp_path / "union")
    for door in corridor.doors():
        assert doorway(corridor, is_open, door) == 0.0
        assert doorway(corridor, is_closed, door) == 1.0


def test_every_visit_can_be_painted_by_its_time_and_the_last_is_latest(corridor, tmp_path):
    for door in corridor.doors():
        meanings, visits = corridor.meanings(door), visits_of(corridor, door)
        assert {meanings[visit.patch] for visit in visits} == {"open", "closed"}
        for visit in visits:
            state = f"at={format_stamp(visit.start_ns)}"
            grid, said = exported(corridor, state, tmp_path / f"{door}_{visit.sequence}")
            assert doorway(corridor, grid, door) == (meanings[visit.patch] == "closed")
            (row,) = (row for row in said["submaps"] if row["submap"] == visit.submap_id)
            assert row["states"] == [visit.patch]
            assert parse_stamp(row["seen_s"]) == visit.end_ns
        latest, _ = exported(corridor, "latest", tmp_path / f"{door}_latest")
        assert doorway(corridor, latest, door) == (meanings[visits[-1].patch] == "closed")


def test_outside_the_submaps_nothing_changes_and_the_mask_is_the_submaps(corridor, tmp_path):
    grid, said = exported(corridor, "most-likely", tmp_path / "out")
    mean, _ = read_map(corridor.run_dir / "map" / "map.yaml")
    mask, _ = read_map(tmp_path / "out" / "mask.yaml")
    assert grid.frame == mean.frame == mask.frame
    inside = np.zeros(mean.frame.shape, dtype=bool)
    for submap in read_submaps(corridor.run_dir / "submaps"):
        rows, cols = submap.frame.shape
        inside[submap.row : submap.row + rows, submap.col : submap.col + cols] |= submap.owned
    np.testing.assert_array_equal(mask.cells, np.where(inside, OCCUPIED, FREE))
    np.testing.assert_array_equal(grid.cells[~inside], mean.cells[~inside])
    assert (grid.cells != mean.cells).sum() == sum(row["changed_cells"] for row in said["submaps"])
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "map.pgm",
        "map.yaml",
        "mask.pgm",
        "mask.yaml",
    ]


def test_an_exported_map_can_be_localized_in(corridor, sample_logs, tmp_path):
    exported(corridor, "open", tmp_path / "out")
    words = ("localize", "--map", tmp_path / "out" / "map.yaml", sample_logs / "corridor_tuesday.mcap")
    result = run_dynmap(*words, "-o", tmp_path / "localized", "-q")
    assert result.exit_code == 0, result.output
    assert "never lost" in result.stdout


def test_a_line_per_submap_says_which_state_and_when(corridor, tmp_path):
    result = run_dynmap("export", corridor.run_dir, "-o", tmp_path / "out")
    lines = result.stdout.splitlines()
    assert [line.split(" at ")[0] for line in lines[:2]] == ["sub-map 0", "sub-map 1"]
    assert all("last seen 2026-03-02T08:0" in line for line in lines[:2])
    assert [line.split()[0] for line in lines[2:]] == ["map", "mask"]


def test_an_exported_map_is_replaced_with_force_only_and_a_run_never(corridor, tmp_path, unharmed):
    out = tmp_path / "out"
    exported(corridor, "open", out)
    before, run_before = unharmed(out), unharmed(corridor.run_dir)
    words = ("export", corridor.run_dir, "--state", "union", "-q", "-o")
    assert "exists already. Pass --force" in refused(FILES, *words, out)
    assert unharmed(out) == before
    assert run_dynmap(*words, out, "--force").exit_code == 0
    assert unharmed(out) != before
    for folder in ("map", "submaps", "patches", ""):
        assert "holds files of a run" in refused(FILES, *words, corridor.run_dir / folder, "--force")
    (tmp_path / "taken").write_text("a file")
    assert "taken" in refused(FILES, *words, tmp_path / "taken" / "out")
    assert "taken" in refused(FILES, *words, tmp_path / "taken")
    assert unharmed(corridor.run_dir) == run_before


def test_times_and_words_that_no_state_is_known_by(corridor, tmp_path):
    words = ("export", corridor.run_dir, "-o", tmp_path / "out", "-q", "--state")
    line = refused(SETTINGS, *words, "at=1970-01-02")
    assert "before the first visit" in line
    assert "2026-03-02T08:0" in line
    for text in ("newest", "at=noon", "at="):
        result = run_dynmap(*words, text)
        assert result.exit_code == 2
        assert f"--state {text}: " in result.stderr
    assert not (tmp_path / "out").exists()


def test_the_timeline_has_a_row_for_every_visit(corridor, tmp_path, unharmed):
    before = unharmed(corridor.run_dir)
    words = ("timeline", corridor.run_dir, "-o")
    result = run_dynmap(*words, tmp_path / "one")
    assert result.exit_code == 0, result.output
    with (tmp_path / "one" / "timeline.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    visits = {(v.submap_id, v.sequence): v for v in read_visits(corridor.run_dir / "patches" / "patches.zip")}
    assert len(rows) == len(visits) == 12
    for row in rows:
        visit = visits[int(row["submap"]), int(row["visit"])]
        assert (parse_stamp(row["enter_s"]), parse_stamp(row["leave_s"])) == (visit.start_ns, visit.end_ns)
        assert row["state"] == ("" if visit.patch is None else str(visit.patch))
    stay = {one.submap_id: one.stay_probability for one in corridor.patch_sets}
    for number, line in enumerate(result.stdout.splitlines()[:2]):
        assert line.startswith(f"sub-map {number} at (")
        assert "6 visits (state 0 in 3, state 1 in 3)" in line
        assert f"stays for a minute with probability {stay[number]:.3f}" in line
    assert run_dynmap(*words, tmp_path / "two").exit_code == 0
    assert unharmed(tmp_path / "one") == unharmed(tmp_path / "two")
    assert unharmed(corridor.run_dir) == before
    assert f"`{TIMELINE_HEADER}`" in OUTPUTS


def test_the_timeline_lies_in_the_run_by_default(small):
    assert run_dynmap("timeline", small.run_dir, "-q").exit_code == 0
    assert {path.name for path in (small.run_dir / "timeline").iterdir()} == {"timeline.csv", "timeline.png"}


def test_explain_shows_evidence_visits_states_and_scores(corridor, unharmed):
    before = unharmed(corridor.run_dir)
    for submap in read_submaps(corridor.run_dir / "submaps"):
        found = json.loads(run_dynmap("explain", corridor.run_dir, submap.submap_id, "--json", "-q").stdout)
        evidence = found["evidence"]
        assert found["contested_cells"] == submap.contested.sum()
        assert evidence["occupied_in_windows"][0] >= evidence["windows_needed"] == 2
        assert evidence["free_in_windows"][0] >= 2
        assert {row["occupied_cells"] > row["free_cells"] for row in evidence["windows"]} == {True, False}
        assert len(found["visits"]) == 6
        assert [state["visits"] for state in found["states"]] == [3, 3]
        assert {state["occupied_cells"] > state["free_cells"] for state in found["states"]} == {True, False}
        assert int(np.argmax(found["bic"])) == 1
        assert found["objects"]
        for thing in found["objects"]:
            seen = [thing["visits"][str(visit["visit"])] for visit in found["visits"]]
            assert [seen.count(state) for state in ("on", "off", "unknown")] == [
                thing["on"],
                thing["off"],
                thing["unknown"],
            ]
            states = [visit["state"] for visit in found["visits"]]
            assert len({pair for pair in zip(states, seen, strict=True) if pair[1] != "unknown"}) == 2
        text = run_dynmap("explain", corridor.run_dir, submap.submap_id, "-q").stdout
        assert text.startswith(f"sub-map {submap.submap_id} at (")
        assert len(text.splitlines()) > 6 + len(evidence["windows"]) + len(found["visits"])
        assert "BIC by the number of states: 1: " in text
        assert "objects: cells that switch together" in text
        start_s = float(found["recordings"][0]["start_s"])
        assert "t in seconds from the first scan of corridor_monday.mcap (2026-03-02T08:00:00Z)" in text
        for visit in found["visits"]:
            enter, leave = (float(visit[f"{what}_s"]) - start_s for what in ("enter", "leave"))
            assert re.search(rf"corridor_monday.mcap +{enter:.1f} +{leave:.1f} ", text)
    assert unharmed(corridor.run_dir) == before


def test_a_place_is_named_alike_by_all(corridor):
    built = run_dynmap("segment", corridor.run_dir, "-q").stdout
    timeline = run_dynmap("timeline", corridor.run_dir, "-o", corridor.run_dir.parent / "places", "-q").stdout
    for submap in read_submaps(corridor.run_dir / "submaps"):
        assert f"{submap.submap_id} at {submap.place} " in built
        assert f"sub-map {submap.submap_id} at {submap.place}: " in timeline
        explained = run_dynmap("explain", corridor.run_dir, submap.submap_id, "-q").stdout
        assert explained.startswith(f"sub-map {submap.submap_id} at {submap.place}, ")


def test_a_submap_that_is_not_there(corridor, small):
    line = refused(SETTINGS, "explain", corridor.run_dir, "7", "-q")
    assert "no sub-map 7; there are 0, 1." in line
    assert "nothing was seen in two states" in refused(SETTINGS, "explain", small.run_dir, "0", "-q")
    assert run_dynmap("explain", corridor.run_dir, "door").exit_code == 2


def test_a_run_in_which_nothing_changes(small, tmp_path):
    result = run_dynmap("export", small.run_dir, "--state", "at=5", "-o", tmp_path / "out")
    assert result.exit_code == 0
    assert "no sub-map" in result.stdout
    mean, _ = read_map(small.run_dir / "map" / "map.yaml")
    grid, _ = read_map(tmp_path / "out" / "map.yaml")
    mask, _ = read_map(tmp_path / "out" / "mask.yaml")
    np.testing.assert_array_equal(grid.cells, mean.cells)
    assert (mask.cells == FREE).all()
    result = run_dynmap("timeline", small.run_dir, "-o", tmp_path / "timeline")
    assert "no sub-map" in result.stdout
    assert (tmp_path / "timeline" / "timeline.csv").read_text() == f"{TIMELINE_HEADER}\n"


@pytest.mark.parametrize("verb", VERBS)
def test_runs_that_are_missing_unfinished_damaged_or_stale(small, tmp_path, verb):
    assert "no such run directory" in refused(FILES, *words_of(verb, tmp_path / "gone", tmp_path))
    (tmp_path / "empty").mkdir()
    assert "is not done here" in refused(FILES, *words_of(verb, tmp_path / "empty", tmp_path))
    archive = small.run_dir / "patches" / "patches.zip"
    whole = archive.read_bytes()
    archive.write_bytes(whole[: len(whole) // 2])
    line = refused(FILES, *words_of(verb, small.run_dir, tmp_path))
    assert "patches.zip" in line
    assert "again with --force" in line
    archive.write_bytes(whole)
    stale = ("map", small.run_dir, "--set", "map.resolution_m=0.1", "-q")
    assert run_dynmap(*stale).exit_code == 0
    shutil.copytree(small.run_dir, tmp_path / "stale")
    if verb != "timeline":
        assert "made from another map/" in refused(FILES, *words_of(verb, tmp_path / "stale", tmp_path))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("verb", VERBS)
def test_corrections_that_are_damaged_or_not_followed_yet_are_said(small, tmp_path, verb):
    edits = small.run_dir / "edits.yaml"
    edits.write_text("corrections: [")
    assert "edits.yaml: not a list of corrections" in refused(FILES, *words_of(verb, small.run_dir, tmp_path))
    edits.write_text(
        "format_version: 1\ncorrections:\n- add: {submap: 7, polygon_m: [[1, 1], [2, 1], [2, 2]]}\n"
    )
    assert "edits.yaml: changed since 'segment' was run" in refused(
        FILES, *words_of(verb, small.run_dir, tmp_path)
    )


@pytest.mark.parametrize("stage", ["map", "submaps", "patches"])
def test_a_stage_that_is_not_done_is_noticed(small, tmp_path, stage):
    for verb in ("timeline", "export"):
        shutil.rmtree(small.run_dir / stage, ignore_errors=True)
        assert "is not done here" in refused(FILES, *words_of(verb, small.run_dir, tmp_path))
