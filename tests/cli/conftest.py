"""A small recording and its run, for tests that need files between stages but not their quality."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from dynmap_cli.cli import main

ROOM = """
about: A room with a niche, one round.
seed: 3
world:
  walls:
    - {points: [[0, 0], [5, 0], [5, 3], [3, 3], [3, 3.8], [2, 3.8], [2, 3], [0, 3]], closed: true}
robot: {path: [[1, 1], [4, 1.2], [4, 2], [1, 1.8]], speed_mps: 0.8}
lasers: [{beams: 91, fov_deg: 270, max_range_m: 8, rate_hz: 4}]
"""


@dataclass(frozen=True)
class Small:
    """A recording and a finished run of it."""

    recording: Path
    run_dir: Path


def run_dynmap(*words: object) -> Result:
    """Call the command line as a user does."""
    return CliRunner().invoke(main, [str(word) for word in words])


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Small:
    """Made once; tests take a copy of it with `small`."""
    folder = tmp_path_factory.mktemp("small")
    scenario = folder / "room.yaml"
    scenario.write_text(ROOM)
    small = Small(folder / "room.mcap", folder / "run")
    for words in (
        ("simulate", scenario, "-o", small.recording),
        ("build", small.recording, "-o", small.run_dir),
    ):
        result = run_dynmap(*words)
        assert result.exit_code == 0, result.output
    return small


@pytest.fixture
def small(made: Small, tmp_path: Path) -> Small:
    """A private copy of the run."""
    shutil.copytree(made.run_dir, tmp_path / "run")
    return Small(made.recording, tmp_path / "run")


@pytest.fixture
def unharmed() -> Callable[[Path], dict[str, bytes]]:
    """Files of a folder with their content, to compare before and after."""

    def contents(folder: Path) -> dict[str, bytes]:
        return {
            path.relative_to(folder).as_posix(): path.read_bytes()
            for path in sorted(folder.rglob("*"))
            if path.is_file() and path.name != ".lock"
        }

    return contents
