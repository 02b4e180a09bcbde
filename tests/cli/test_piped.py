"""`-`: a recording through a pipe."""

import subprocess
import sys

import yaml


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


def test_a_file_as_standard_input_is_read_where_it_lies(made):
    with made.recording.open("rb") as stream:
        words = [sys.executable, "-m", "dynmap_cli", "check", "-", "-q"]
        done = subprocess.run(words, stdin=stream, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "build will work: dynmap build" in done.stdout


def test_nothing_through_a_pipe_is_refused():
    done = dynmap(["check", "-", "-q"], b"")
    assert done.returncode == 4
    assert done.stderr.decode().splitlines()[-1].endswith("the file is empty")
