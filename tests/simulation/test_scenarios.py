"""Scenario files: what is wrong is said in one line, with file and key."""

import pytest
from click.testing import CliRunner

from dynmap_cli.cli import main
from dynmap_cli.errors import ConfigError
from dynmap_cli.simulation import load_scenario, parse_scenario

PATH = "robot: {path: [[0, 0], [1, 0]]}\n"
DOOR = "world: {doors: [{name: d, hinge: [0, 0], latch: [1, 0], %s}]}\n" + PATH

BAD = {
    "unknown key": (PATH + "sead: 3\n", "unknown key 'sead', did you mean 'seed'?"),
    "unknown inner key": (DOOR % "hings: [0, 0]", "unknown key 'world.doors.0.hings', did you mean 'hinge'?"),
    "no path": ("seed: 3\n", "robot.path is missing"),
    "missing": ("world: {doors: [{name: d, hinge: [0, 0]}]}\n" + PATH, "'world.doors.0.latch' is missing"),
    "too many beams": (
        PATH + "lasers: [{beams: 400, rate_hz: 10, beam_interval_s: 0.001}]\n",
        "do not fit into 1/10 s",
    ),
    "no time": (
        "robot: {path: [[0, 0]]}\nlasers: [{beam_interval_s: 0.0005}]\n",
        "is over before the first scan",
    ),
    "negative": (PATH + "lasers: [{rate_hz: -1}]\n", "lasers.0.rate_hz = -1 is not allowed"),
    "not finite": (PATH + "lasers: [{max_range_m: .inf}]\n", "lasers.0.max_range_m = inf is not allowed"),
    "unknown state": (DOOR % "schedule: [[0, ajar]]", "'d' has no state 'ajar', only closed, open"),
    "two sources": (DOOR % "schedule: [[0, open]], process: {mean_s: 3}", "both a schedule and a process"),
    "no routes": (PATH + "movers: [{does: wander}]\n", "wanderers need world.routes"),
    "one name": (PATH + "lasers: [{}, {}]\n", "two lasers have the same name"),
    "wait first": ("robot: {path: [{wait_s: 3}]}\n", "must be a place [x, y]"),
    "unknown behaviour": (
        PATH + "movers: [{does: fly}]\n",
        "'walk', 'wander', 'stream', 'stand', 'accompany', 'follow', 'block'",
    ),
    "far away": ("robot: {path: [[0, 0], [1.0e+300, 0]]}\n", "is not allowed"),
    "aliases": (PATH + "world: {legs: [&a {at: [0, 0]}, *a]}\n", "anchors and aliases"),
    "tiny cells": (PATH + "map_resolution_m: 1.0e-9\n", "map_resolution_m"),
    "many people": (PATH + "generate: {kind: crowd, people: 1000000000}\n", "generate.people"),
    "a long stay": ("robot: {path: [[0, 0], {wait_s: 1.0e+7}]}\n", "readings of the lasers, at most 3e+08"),
    "many visits": (
        "robot: {path: [[0, 0], [1, 0]], repeat: 10000, days: 1000}\n",
        "are more than 20000 steps",
    ),
    "a long time": (
        "robot: {path: [[0, 0], [1, 0]], repeat: 100, pause_s: 1.0e+7}\n",
        "seconds from first to last, at most 4e+07",
    ),
    "a wide world": (
        PATH + "world: {walls: [[[0, 0], [9.0e+4, 9.0e+4]]]}\n",
        "a grid has at most 1.2e+08 cells",
    ),
    "nowhere to walk": (PATH + "movers: [{does: walk, path: [[0, 0], [0, 0]]}]\n", "shorter than 0.1 m"),
    "nowhere to go": (PATH + "world: {routes: [[[0, 0], [0, 0]]]}\n", "0.1 m or more from the next"),
    "another age": (PATH + "start: 9999-01-01T00:00:00Z\n", "start"),
    "a list": ("- 1\n", "expected 'key: value' lines, found list"),
    "not YAML": ("a: [1\n", "not YAML"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_scenario_is_refused_in_one_line_that_names_it(tmp_path, name):
    content, expected = BAD[name]
    path = tmp_path / "bad.yaml"
    path.write_text(content, encoding="utf-8")
    result = CliRunner().invoke(main, ["simulate", str(path), "-o", str(tmp_path / "log.mcap")])
    assert result.exit_code == ConfigError.exit_code
    assert result.stderr.startswith(f"dynmap: {path}: ")
    assert expected in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert not (tmp_path / "log.mcap").exists()


def test_a_missing_scenario_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"nowhere.yaml: scenario cannot be read \(No such file"):
        load_scenario(tmp_path / "nowhere.yaml")


def test_two_objects_of_one_name_are_refused():
    box = {"name": "twin", "size_m": [1, 1], "places": {"a": [0, 0, 0]}}
    with pytest.raises(ConfigError, match="two objects are called 'twin'"):
        parse_scenario({"world": {"boxes": [box, box]}, "robot": {"path": [[0, 0]]}})


def test_the_seed_of_the_command_line_wins(tmp_path):
    path = tmp_path / "s.yaml"
    path.write_text("seed: 3\n" + PATH, encoding="utf-8")
    assert load_scenario(path).seed == 3
    assert load_scenario(path, 9).seed == 9
