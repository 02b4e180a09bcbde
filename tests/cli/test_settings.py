"""Settings: described, complete, checked."""

from pathlib import Path

import pytest
import yaml

from dynmap_cli.config import Config, known_keys, load_config, parse_assignments
from tests.cli.conftest import run_dynmap

CONFIGS = Path(__file__).parents[2] / "configs"


def test_default_yaml_is_what_config_show_prints():
    assert (CONFIGS / "default.yaml").read_text(encoding="utf-8") == run_dynmap("config", "show").stdout


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.yaml")), ids=lambda path: path.name)
def test_every_settings_file_is_allowed(path):
    load_config(path, {})


def test_default_yaml_changes_nothing():
    assert load_config(CONFIGS / "default.yaml", {}).config == Config()


def test_every_key_says_why():
    assert [key for key, description in known_keys().items() if len(description) < 10] == []


def test_the_command_line_beats_the_file_and_both_are_named(tmp_path):
    settings = tmp_path / "site.yaml"
    settings.write_text("map: {resolution_m: 0.1, max_rounds: 3}\n")
    words = ("--config", settings, "--set", "map.resolution_m=0.2", "--seed", 4)
    shown = run_dynmap("config", "show", *words).stdout
    content = yaml.safe_load(shown)
    assert (content["seed"], content["map"]["resolution_m"], content["map"]["max_rounds"]) == (4, 0.2, 3)
    assert "resolution_m: 0.2  # from command line" in shown
    assert f"max_rounds: 3  # from {settings}" in shown


def test_assignments_are_read_as_yaml():
    assert parse_assignments(["a.b=0.5", "c=[1, 2]", "d=x=y"]) == {"a.b": 0.5, "c": [1, 2], "d": "x=y"}
