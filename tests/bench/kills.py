"""Builds that are killed at random moments: what they leave behind, and what the next build makes of it."""

from __future__ import annotations

import random
from pathlib import Path

from tests.bench.measured import python
from tests.bench.tables import Row, Table
from tests.bench.worlds import Bench
from tests.cli import killing
from tests.cli.conftest import ROOM

_MOMENTS, _MOMENTS_QUICK = 25, 3


def tables(bench: Bench) -> list[Table]:
    """One table."""
    table = Table(
        "Builds that are killed",
        [
            "A small room is built into an empty folder and the process killed (SIGKILL) at random moments, then built "
            "again. *At a change*: when a random one of its changes of files in the run directory (opened for "
            "writing, renamed, made, taken away) begins; *in time*: after a random share of the time of a whole build. "
            "*Wrong claims*: manifests left behind that call a stage done of which a file is missing or another. "
            "*Same bytes*: the folder after the second build holds the same files with the same content as one of an "
            "undisturbed build, but for the seconds in manifests.",
        ],
        ["killed", "moments", "killed in time", "wrong claims", "same bytes"],
    )
    count = _MOMENTS_QUICK if bench.quick else _MOMENTS
    table.add("at a change", lambda: _row(bench, "change", count))
    table.add("in time", lambda: _row(bench, "time", count))
    return [table]


def _row(bench: Bench, how: str, count: int) -> Row:
    """Kill and build again so often."""
    folder = bench.folder / "kills" / how
    folder.mkdir(parents=True, exist_ok=True)
    recording = _recording(folder)
    changes, seconds = killing.changes_of_a_build(recording, folder / "whole")
    whole = killing.content_of(folder / "whole")
    draw = random.Random(how)
    killed = wrong = same = 0
    for number in range(count):
        run_dir = folder / f"run_{number}"
        if how == "change":
            killed += killing.kill_at_change(recording, run_dir, draw.randint(1, changes))
        else:
            killed += killing.kill_after(recording, run_dir, draw.uniform(0.0, seconds))
        wrong += len(killing.claims_that_are_wrong(run_dir))
        killing.kill_at_change(recording, run_dir, 0)
        same += killing.content_of(run_dir) == whole
    wrong_text = str(wrong) if wrong == 0 else f"**{wrong}**"
    same_text = f"{same} of {count}" if same == count else f"**{same} of {count}**"
    return [str(count), str(killed), wrong_text, same_text]


def _recording(folder: Path) -> Path:
    """The recording of a small room."""
    scenario, recording = folder / "room.yaml", folder / "room.mcap"
    scenario.write_text(ROOM)
    python("-m", "dynmap_cli", "simulate", scenario, "-o", recording, "--force", log=folder / "simulate.txt")
    return recording
