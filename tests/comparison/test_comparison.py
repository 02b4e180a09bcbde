"""One recording in several maps of a run."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

from dynmap_cli.comparison.courses import course_in
from dynmap_cli.comparison.figures import draw_beliefs, draw_courses
from dynmap_cli.comparison.maps import ComparedMap, one_state, state_numbers, union_of_states
from dynmap_cli.comparison.stage import OVER_TIME_HEADER, SUMMARY_HEADER, as_summary, as_table
from dynmap_cli.domain.patches import Patch, PatchSet
from dynmap_cli.domain.poses import Trajectory, compose
from dynmap_cli.files.trajectory import read_tum, write_tum
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.progress import no_tick
from tests.cli.conftest import made, run_dynmap, small  # noqa: F401
from tests.localization.worlds import office, patch_sets_of, simulated


def three_states(frame):
    values = [np.full(frame.shape, value, dtype=np.float32) for value in (0.0, 0.6, 0.3)]
    values[0][0, 0] = np.nan
    for one in values:
        one[0, 1] = np.nan
    patches = tuple(
        Patch(k, support, one) for k, (support, one) in enumerate(zip((3, 9, 5), values, strict=True))
    )
    return PatchSet(4, frame, np.ones(frame.shape, dtype=bool), patches, 0.9)


@pytest.fixture(scope="module")
def run():
    return simulated(office())


@pytest.fixture(scope="module")
def sets(run):
    return tuple(patch_sets_of(run))


def test_the_union_reflects_as_the_state_that_reflects_most_and_knows_what_any_state_knows(sets):
    (patch,) = union_of_states(three_states(sets[0].frame)).patches
    assert np.isnan(patch.reflectance[0, 1])
    assert np.isclose(patch.reflectance[0, 0], 0.6)
    assert np.allclose(patch.reflectance[1:], 0.6)
    assert patch.support == 17


@pytest.mark.parametrize(("number", "patch_id"), [(0, 0), (1, 1), (2, 2), (7, 1)])
def test_a_state_is_the_one_of_this_number_or_the_most_common(sets, number, patch_id):
    (patch,) = one_state(three_states(sets[0].frame), number).patches
    assert patch.patch_id == patch_id


def test_states_that_were_seen_most_often_come_first(sets):
    assert state_numbers([three_states(sets[0].frame)]) == [1, 2, 0]
    assert state_numbers([]) == []


@pytest.fixture(scope="module")
def courses(run, sets):
    """The first 120 scans, from the true start, in the patch map and in the map with the door open."""
    settings = LocalizationSettings(start=tuple(run.true_poses[0].tolist()))
    truth = Trajectory(run.log.stamps_ns, run.true_poses)
    log = run.log.select(slice(0, 120))
    maps = [
        ComparedMap("patch map", "as believed", run.true_map, sets),
        ComparedMap("state 1", "as often", run.true_map, tuple(one_state(one, 1) for one in sets)),
    ]
    return [course_in(m, log, settings, truth, seed=0, threads=1, tick=no_tick) for m in maps]


def test_errors_are_those_of_the_particles_and_of_the_pose(courses, run):
    for course in courses:
        n = course.stamps_ns.size
        columns = (
            course.spread_m,
            course.error_m,
            course.pose_error_m,
            course.log_likelihood,
            course.is_lost,
        )
        assert all(column.shape == (n,) for column in columns)
        at = np.searchsorted(run.log.stamps_ns, course.stamps_ns)
        away = np.linalg.norm((course.poses - run.true_poses[at])[:, :2], axis=1)
        np.testing.assert_allclose(course.pose_error_m, away, atol=1e-9)
        assert (course.error_m >= course.pose_error_m - 0.3).all()
    assert courses[0].pose_error_m.mean() < 0.1
    assert courses[0].away_from_m(courses[0]).max() == 0.0
    assert courses[1].away_from_m(courses[0]).max() > 0.0


def test_tables_have_a_line_per_map_and_a_line_per_update(courses):
    header, *lines = as_summary(courses).splitlines()
    assert header == SUMMARY_HEADER
    assert [line.split(",")[0] for line in lines] == ["patch map", "state 1"]
    header, *lines = as_table(courses).splitlines()
    assert header == OVER_TIME_HEADER
    assert len(lines) == sum(course.stamps_ns.size for course in courses)


def test_figures_are_the_same_bytes_each_time(courses):
    for draw in (
        lambda: draw_courses(courses, 0, with_truth=True),
        lambda: draw_beliefs(courses[0], {0: "0 ($lab)"}, 0),
    ):
        assert draw() == draw()
        assert draw().startswith(b"\x89PNG")


def test_the_verb_writes_its_files_with_and_without_truth(small, tmp_path):  # noqa: F811
    truth = small.recording.with_name(small.recording.name + ".truth") / "trajectory.tum"
    turned = read_tum(truth)
    frame = np.array([3.0, -2.0, 1.0])
    moved = tmp_path / "moved.tum"
    write_tum(moved, replace(turned, poses=compose(frame, turned.poses)))
    found, maps = {}, ["patch map", "all beams", "filtered map"]
    for name, words in {
        "plain": (),
        "truth": ("--truth", moved, "--map-truth", moved),
        "false": ("--truth", moved),
    }.items():
        out = tmp_path / name
        result = run_dynmap("compare", small.run_dir, small.recording, "-o", out, "--json", "-q", *words)
        assert result.exit_code == 0, result.output
        found[name] = json.loads(result.stdout)
        figure = "spread.png" if name == "plain" else "pose_error.png"
        files = {path.name for path in out.iterdir() if path.suffix in (".csv", ".png")}
        assert files == {"comparison.csv", "over_time.csv", figure}
        assert set(found[name]["files"]) == files
        assert "no sub-map came into view, so there is no states.png" in found[name]["lines"]
        with (out / "comparison.csv").open(newline="") as stream:
            assert [row["map"] for row in csv.DictReader(stream)] == maps
    assert found["plain"]["maps"]["patch map"]["pose_error_mean_m"] is None
    assert found["truth"]["maps"]["patch map"]["pose_error_mean_m"] < 0.1
    assert found["false"]["maps"]["patch map"]["pose_error_mean_m"] > 1.0
    result = run_dynmap("compare", small.run_dir, small.recording, "--map-truth", moved)
    assert result.exit_code == 2
    assert "--map-truth needs --truth" in result.output
