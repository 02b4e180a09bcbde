"""From the files of a simulated recording, and of a run that is as good as the truth, to the table."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from dynmap_cli import __version__
from dynmap_cli.cli import main
from dynmap_cli.counting.counts import count_beams
from dynmap_cli.counting.em import occupancy
from dynmap_cli.counting.frames import frame_of_scans
from dynmap_cli.domain.poses import Trajectory, compose
from dynmap_cli.files.counting_map import write_beams
from dynmap_cli.files.manifest import Manifest, write_manifest
from dynmap_cli.files.pgm import write_map
from dynmap_cli.files.registered import write_registered
from dynmap_cli.files.scan_log import write_scan_log
from dynmap_cli.simulation.run import simulate
from dynmap_cli.simulation.scenario import load_scenario
from dynmap_cli.simulation.truth import write_truth

SETTINGS = {
    "resolution_m": 0.05,
    "usable_range_m": 30.0,
    "static_prior": 0.95,
    "support_cells": 1,
    "stop_at_walls": True,
    "look_s": 5.0,
    "look_prior": 0.8,
}


def evaluate(*words):
    result = CliRunner().invoke(main, ["evaluate", *map(str, words), "--json"])
    assert result.exit_code == 0, result.stderr
    return json.loads(result.stdout)["results"][0]


@pytest.fixture(scope="module")
def written(sample_logs, tmp_path_factory):
    """Folders of a truth, and of a run with true poses, in a frame of its own, and true labels."""
    simulated = simulate(load_scenario(sample_logs / "corridor_monday.yaml", None))
    truth, run = tmp_path_factory.mktemp("log.truth"), tmp_path_factory.mktemp("run")
    write_truth(truth, simulated)
    (run / "scans").mkdir()
    (run / "map").mkdir()
    poses = compose(np.array([2.0, 1.0, 0.5]), simulated.true_poses)
    write_scan_log(run / "scans", replace(simulated.log, ranges_m=simulated.log.ranges_m.copy()))
    write_registered(run / "map", Trajectory(simulated.log.stamps_ns, poses), simulated.log.beam_interval_s)
    labels = np.where(simulated.beam_class == 1, 0.0, 1.0).astype(np.float32)
    labels[simulated.beam_class == 2] = np.nan
    write_beams(run / "map" / "beams.npz", simulated.log.stamps_ns, labels, np.zeros(labels.shape, bool))
    frame = frame_of_scans(simulated.log, poses, 30.0, 0.05)
    write_map(run / "map", "map", occupancy(count_beams(simulated.log, poses, frame, 30.0, weights=labels)))
    write_manifest(run / "map", Manifest("map", SETTINGS, {}, {}, {}, 0.0, __version__))
    return run, truth


def test_beams(written):
    record = evaluate("beams", *written)
    assert record["complete"]
    assert record["F1"] == pytest.approx(1.0)
    rows = {row["method"]: row for row in record["details"]["methods at the same poses"]}
    assert rows["plain counting"]["F1"] < record["F1"]
    assert rows["paper to the letter"]["F1"] < record["F1"]


def test_trajectory(written):
    run, truth = written
    record = evaluate("trajectory", run / "map" / "trajectory.tum", truth / "trajectory.tum")
    assert record["ate_max_m"] < 1e-5


def test_map_against_the_true_map_and_alone(written):
    run, truth = written
    record = evaluate("map", run / "map" / "map.yaml", truth / "map.yaml")
    assert record["occupied_precision"] > 0.95
    assert record["turn_deg"] == pytest.approx(-np.degrees(0.5), abs=0.3)
    alone = evaluate("map", run)
    assert alone["complete"]
    assert 5.0 < alone["line_thickness_mm"] < 30.0


def test_a_run_without_map_is_one_line(written, tmp_path):
    result = CliRunner().invoke(main, ["evaluate", "beams", str(tmp_path), str(written[1])])
    assert result.exit_code == 5
    assert "dynmap build" in result.stderr


def test_a_folder_that_is_no_truth_is_one_line(written):
    result = CliRunner().invoke(main, ["evaluate", "beams", str(written[0]), str(written[0])])
    assert result.exit_code == 5
    assert len(result.stderr.splitlines()) == 1
