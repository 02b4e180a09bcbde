"""The verb: tables, JSON, figures, bad input."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from dynmap_cli.cli import main
from dynmap_cli.domain.poses import Trajectory
from dynmap_cli.evaluation.scores import Score, as_lines, as_record, bands
from dynmap_cli.files.trajectory import write_tum
from tests.evaluation.test_trajectories import shaken, walk


def run(*words):
    return CliRunner().invoke(main, ["evaluate", *map(str, words)])


@pytest.fixture
def pair(tmp_path):
    truth = walk(1)
    write_tum(tmp_path / "truth.tum", truth)
    write_tum(tmp_path / "est.tum", shaken(truth, 2))
    return tmp_path / "est.tum", tmp_path / "truth.tum"


def test_table_json_and_figure(pair, tmp_path):
    assert "ate_rmse_m" in run("trajectory", *pair).stdout
    first = run("trajectory", *pair, "--json", "--plot", tmp_path / "a.png")
    second = run("trajectory", *pair, "--json", "--plot", tmp_path / "b.png")
    assert json.loads(first.stdout)["results"][0]["complete"] is True
    assert first.stdout == second.stdout
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_several_pairs_give_bands(pair):
    record = json.loads(run("trajectory", *pair, pair[1], pair[1], "--json").stdout)
    band = record["bands"]["ate_rmse_m"]
    assert band["p05"] <= band["mean"] <= band["p95"]


def test_an_odd_number_of_arguments_is_a_usage_error(pair):
    result = run("trajectory", pair[0])
    assert result.exit_code == 2
    assert "pairs" in result.stderr


def test_a_missing_file_is_one_line(pair, tmp_path):
    result = run("trajectory", tmp_path / "none.tum", pair[1])
    assert result.exit_code == 5
    assert len(result.stderr.splitlines()) == 1


def test_nothing_to_compare_is_shown_and_fails(pair, tmp_path):
    later = Trajectory(walk(1).stamps_ns + 10**15, walk(1).poses)
    write_tum(tmp_path / "later.tum", later)
    result = run("trajectory", tmp_path / "later.tum", pair[1], "--json")
    assert result.exit_code == 4
    assert json.loads(result.stdout)["results"][0]["coverage"] == 0.0
    assert result.stderr.splitlines()[-1].startswith("dynmap: later: nothing could be compared.")


def test_an_incomplete_row_makes_the_means_void():
    good, gap = Score("a", 1.0, {"x": 1.0}), Score("b", 0.5, {"x": 0.0})
    assert bands([good, good], 0)["x"].mean == 1.0
    assert np.isnan(bands([good, gap], 0)["x"].mean)
    record = as_record([good, gap], 0)
    assert record["bands"]["x"]["mean"] is None
    assert record["results"][1]["complete"] is False
    assert "INCOMPLETE" in "\n".join(as_lines([good, gap], 0))


def test_nan_never_counts_as_good():
    assert np.isnan(bands([Score("a", 1.0, {"x": np.nan}), Score("b", 1.0, {"x": 0.0})], 0)["x"].mean)
    assert as_record([Score("a", 1.0, {"x": np.nan})], 0)["results"][0]["x"] is None


def test_bands_depend_on_the_seed_only():
    scores = [Score(str(k), 1.0, {"x": float(k)}) for k in range(8)]
    assert bands(scores, 3) == bands(scores, 3)


def test_a_trajectory_with_nan_is_read(tmp_path, pair):
    truth = walk(1)
    poses = truth.poses.copy()
    poses[:60] = np.nan
    write_tum(tmp_path / "gap.tum", Trajectory(truth.stamps_ns, poses))
    record = json.loads(run("trajectory", tmp_path / "gap.tum", pair[1], "--json").stdout)
    assert record["results"][0]["complete"] is False
