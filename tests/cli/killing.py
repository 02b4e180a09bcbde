"""Builds that are killed at one moment, and whether the next one makes it good."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from dynmap_cli.files.manifest import damaged, read_manifest
from dynmap_cli.runs.floor_plan import STAGES

_CHILD = """
import os, signal, sys
folder, kill_at, *words = sys.argv[1:]
seen = 0

def watch(event, args):
    global seen
    if event == "open":
        is_change = bool(args[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))
    else:
        is_change = event in {"os.rename", "os.remove", "os.mkdir", "os.rmdir"}
    if is_change and isinstance(args[0], (str, os.PathLike)) and os.fspath(args[0]).startswith(folder):
        seen += 1
        if seen == int(kill_at):
            os.kill(os.getpid(), signal.SIGKILL)

sys.addaudithook(watch)
from dynmap_cli.cli import main
try:
    main(words)
finally:
    print("changes", seen)
"""


def _start(recording: Path, folder: Path, kill_at: int) -> subprocess.Popen[str]:
    """A build in a process of its own that kills itself at a change of a file, 0 = at none."""
    words = [
        sys.executable,
        "-c",
        _CHILD,
        folder,
        kill_at,
        "build",
        recording,
        "-o",
        folder,
        "-q",
        "--threads",
        1,
    ]
    project = Path(__file__).resolve().parents[2]
    return subprocess.Popen(
        list(map(str, words)), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=project
    )


def changes_of_a_build(recording: Path, folder: Path) -> tuple[int, float]:
    """How many changes of files a build makes, and how many seconds it takes."""
    started = time.perf_counter()
    said, errors = _start(recording, folder, 0).communicate()
    assert "changes" in said, errors
    return int(said.split("changes")[1]), time.perf_counter() - started


def kill_at_change(recording: Path, folder: Path, number: int) -> bool:
    """Build, and be killed at that change of a file; whether there was so many."""
    process = _start(recording, folder, number)
    process.communicate()
    return process.returncode == -signal.SIGKILL


def kill_after(recording: Path, folder: Path, seconds: float) -> bool:
    """Build, and be killed after that time; whether it was still running."""
    process = _start(recording, folder, 0)
    time.sleep(seconds)
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()
    return process.returncode == -signal.SIGKILL


def claims_that_are_wrong(folder: Path) -> list[str]:
    """Stages whose manifest says that they are done, while a file is not as it says."""
    wrong = []
    for stage in STAGES:
        manifest = read_manifest(folder / stage.folder, stage.name)
        if manifest is not None and damaged(folder / stage.folder, manifest) is not None:
            wrong.append(stage.name)
    return wrong


def content_of(folder: Path) -> dict[str, bytes | str]:
    """Every file, manifests without the seconds they took."""
    found: dict[str, bytes | str] = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_dir():
            found[f"{name}/"] = ""
        elif path.name.endswith(".manifest.json"):
            manifest = json.loads(path.read_text(encoding="utf-8"))
            found[name] = json.dumps({**manifest, "seconds": 0.0}, sort_keys=True)
        elif path.name != ".lock":
            found[name] = path.read_bytes()
    return found
