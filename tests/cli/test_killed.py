"""Builds that are killed, run out of disk, or may not write: nothing half-made counts, and the next build is as any."""

import os
import random
import re
import shutil
import subprocess
import sys

import pytest

from tests.cli import killing
from tests.cli.conftest import run_dynmap

FILES, RECORDING = 5, 4


def assert_is_made_good(made, folder):
    assert killing.claims_that_are_wrong(folder) == []
    result = run_dynmap("build", made.recording, "-o", folder, "-q")
    assert result.exit_code == 0, result.output
    found, whole = killing.content_of(folder), killing.content_of(made.run_dir)
    assert sorted(found) == sorted(whole)
    assert [name for name in whole if found[name] != whole[name]] == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_build_that_is_killed_at_a_change_of_a_file(made, tmp_path, seed):
    number = random.Random(seed).randrange(1, 120)
    assert killing.kill_at_change(made.recording, tmp_path / "run", number)
    assert_is_made_good(made, tmp_path / "run")


@pytest.mark.slow
def test_a_build_that_is_killed_at_any_time(made, tmp_path):
    killing.kill_after(made.recording, tmp_path / "run", 2.5)
    assert_is_made_good(made, tmp_path / "run")


@pytest.mark.slow
def test_a_build_that_is_killed_while_it_replaces_another(made, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(made.run_dir, folder)
    assert run_dynmap("segment", folder, "--set", "segmentation.window_s=5", "-q").exit_code == 0
    assert killing.kill_at_change(made.recording, folder, 12)
    assert_is_made_good(made, folder)


LIMITED = """
import resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]), int(sys.argv[1])))
from dynmap_cli.cli import main
main(sys.argv[2:])
"""


@pytest.mark.slow
@pytest.mark.parametrize("n_bytes", [3000, 60_000])
def test_a_disk_that_is_full(made, tmp_path, n_bytes):
    folder = tmp_path / "run"
    words = [sys.executable, "-c", LIMITED, n_bytes, "build", made.recording, "-o", folder, "-q"]
    done = subprocess.run(list(map(str, words)), capture_output=True, text=True, check=False)
    assert done.returncode == FILES, done.stderr
    assert re.search(r"cannot be written \((File too large|not to its end)", done.stderr.splitlines()[-1])
    assert "Traceback" not in done.stderr
    assert_is_made_good(made, folder)


def test_a_place_that_may_not_be_written(made, tmp_path):
    tmp_path.chmod(0o555)
    try:
        if os.access(tmp_path, os.W_OK):
            pytest.skip("this user writes everywhere")
        result = run_dynmap("build", made.recording, "-o", tmp_path / "run", "-q")
        assert result.exit_code == FILES
        assert "cannot be written" in result.stderr
    finally:
        tmp_path.chmod(0o755)


def test_a_build_that_is_refused_leaves_no_folder(made, tmp_path):
    short = tmp_path / "short.mcap"
    short.write_bytes(made.recording.read_bytes()[:200])
    for verb in ("build", "ingest"):
        assert run_dynmap(verb, short, "-o", tmp_path / "deep" / "run", "-q").exit_code == RECORDING
        assert not (tmp_path / "deep").exists()
    (tmp_path / "mine").mkdir()
    assert run_dynmap("build", short, "-o", tmp_path / "mine", "-q").exit_code == RECORDING
    assert (tmp_path / "mine").is_dir()
    out = tmp_path / "out"
    assert run_dynmap("localize", made.run_dir, short, "-o", out, "-q").exit_code == RECORDING
    assert not out.exists()
