"""`-`: a recording through a pipe."""

import json
import os
import subprocess
import sys

import pytest
import yaml

from tests.ingest.corpus import FILES


def dynmap(words, data):
    """Call the command line with something on its standard input."""
    return subprocess.run(
        [sys.executable, "-m", "dynmap_cli", *map(str, words)], input=data, capture_output=True, check=False
    )


def test_a_recording_through_a_pipe_is_that_of_a_file(made, tmp_path):
    data = made.recording.read_bytes()
    for name in ("first", "second"):
        done = dynmap(["ingest", "-", "-o", tmp_path / name, "-q"], data)
        assert done.returncode == 0, done.stderr
    folders = [made.run_dir / "scans", tmp_path / "first" / "scans", tmp_path / "second" / "scans"]
    for path in folders[0].glob("*.npy"):
        assert all((folder / path.name).read_bytes() == path.read_bytes() for folder in folders[1:])
    assert yaml.safe_load((folders[1] / "recordings.json").read_text()) == ["stdin"]


@pytest.mark.parametrize("variant", ["ros1", "db3", "carmen xz", "ros1 in zst"])
def test_every_format_of_one_file_comes_through_a_pipe(variant, tmp_path):
    done = dynmap(["check", "-", "--json", "-q"], FILES[variant](tmp_path).read_bytes())
    assert done.returncode == 0, done.stderr
    (drive,) = json.loads(done.stdout)["drives"]
    assert drive["scans"] == 60
    assert drive["recordings"][0]["name"] == "stdin"
    assert not drive["damage"]


def test_a_file_as_standard_input_is_read_where_it_lies(made):
    with made.recording.open("rb") as stream:
        words = [sys.executable, "-m", "dynmap_cli", "check", "-", "-q"]
        done = subprocess.run(words, stdin=stream, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "build will work: dynmap build - -o RUN"


def test_nothing_through_a_pipe_is_refused():
    done = dynmap(["check", "-", "-q"], b"")
    assert done.returncode == 4
    assert done.stderr.decode().splitlines()[-1].endswith("the file is empty")


def test_a_pipe_without_end_that_is_no_recording_is_refused():
    words = [sys.executable, "-m", "dynmap_cli", "check", "-", "-q"]
    reading, writing = os.pipe()
    done = subprocess.Popen(words, stdin=reading, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL)
    os.close(reading)
    with pytest.raises(BrokenPipeError):
        while True:
            os.write(writing, bytes(1 << 16))
    os.close(writing)
    assert b"not a known recording" in done.communicate()[1]
    assert done.returncode == 4


@pytest.mark.parametrize("words", [["--help"], ["--version"], ["check", "--help"], ["config", "show"]])
def test_a_pipe_that_nobody_reads_is_said(words):
    reading, writing = os.pipe()
    os.close(reading)
    try:
        done = subprocess.run(
            [sys.executable, "-m", "dynmap_cli", *words],
            stdout=writing,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    finally:
        os.close(writing)
    assert done.returncode == 5
    (line,) = done.stderr.splitlines()
    assert line.startswith("dynmap: stdout: cannot be written (Broken pipe)")
