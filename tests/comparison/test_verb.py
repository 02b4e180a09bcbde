"""`dynmap compare` as it is called: done once, through a pipe, and killed."""

import json
import subprocess
import sys

import pytest

from tests.cli.conftest import made, run_dynmap, small  # noqa: F401

FILES = ("comparison.csv", "over_time.csv", "spread.png")
"""Without truth there is no figure of errors, and no figure of states where no sub-map came into view."""
KILLED = """
import os, signal, sys
from tests.comparison.test_verb import FILES
from pathlib import Path
rename, left = Path.replace, [int(sys.argv[1])]

def killing(self, target):
    if Path(target).name in FILES:
        left[0] -= 1
        if left[0] < 0:
            os.kill(os.getpid(), signal.SIGKILL)
    return rename(self, target)

Path.replace = killing
from dynmap_cli.cli import main
main(sys.argv[2:])
"""


def contents(folder):
    return {name: (folder / name).read_bytes() for name in FILES if (folder / name).exists()}


def test_it_is_not_done_twice_and_again_where_something_changed(small, tmp_path):  # noqa: F811
    out = tmp_path / "out"
    words = ("compare", small.run_dir, small.recording, "-o", out)
    first = run_dynmap(*words)
    assert first.exit_code == 0, first.output
    again = run_dynmap(*words)
    assert "compare: up to date" in again.stderr
    assert again.stdout == first.stdout
    assert "--states 3 -> 2" in run_dynmap(*words, "--states", 2).stderr
    (out / "spread.png").write_bytes(b"")
    assert "missing or damaged" in run_dynmap(*words, "--states", 2).stderr


@pytest.mark.parametrize("moved", [0, 1, 2])
def test_a_killed_one_claims_nothing_and_the_next_makes_it_good(small, tmp_path, moved):  # noqa: F811
    out = tmp_path / "out"
    words = list(map(str, ("compare", small.run_dir, small.recording, "-o", out, "-q")))
    assert run_dynmap(*words, "--seed", 1).exit_code == 0
    done = subprocess.run(
        [sys.executable, "-c", KILLED, str(moved), *words], check=False, capture_output=True
    )
    assert done.returncode == -9, done.stderr
    assert not (out / "compare.manifest.json").exists()
    assert run_dynmap(*words).exit_code == 0
    found = contents(out)
    assert json.loads((out / "compare.manifest.json").read_text())["outputs"].keys() == set(FILES)
    assert run_dynmap(*words, "--force").exit_code == 0
    assert contents(out) == found
    assert not list(out.glob(".*.part"))


def test_a_recording_comes_through_a_pipe_and_is_named(small, tmp_path):  # noqa: F811
    out = tmp_path / "out"
    words = [sys.executable, "-m", "dynmap_cli", "compare", small.run_dir, "-", "-o", out, "-q"]
    done = subprocess.run(words, input=small.recording.read_bytes(), capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    assert set(contents(out)) == set(FILES)
    done = subprocess.run(words, input=b"no recording", capture_output=True, check=False)
    assert done.returncode != 0
    assert b"standard input" in done.stderr
    assert b"/dev/stdin" not in done.stderr
