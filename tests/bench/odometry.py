"""Odometry made worse: what it does to the path, and what the calibration says of it."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dynmap_cli.domain.poses import Trajectory
from dynmap_cli.evaluation.trajectories import read_reference
from tests.bench.mapped import Variant, ate_m, mapped
from tests.bench.real_logs import LOGS, AbsentError
from tests.bench.tables import Row, Table, number
from tests.bench.worlds import Bench, truth_folder

BOUNDS = {
    "odometry 0.2 s late": 1.2,
    "turns 5 % too large": 1.2,
    "2 deg/m bias": 1.2,
    "no sign": 1.2,
    "frozen for 5 s": 1.2,
    "no odometry": 1.1,
}
"""How many times the error without perturbation is allowed."""
_UNPERTURBED = "as recorded"
_REVERSING_PATH = [
    [1.1, 5.9],
    [20.0, 5.9],
    {"to": [12.0, 5.9], "backwards": True},
    [34.9, 5.9],
    [34.9, 13.1],
    [20.0, 13.1],
    {"to": [28.0, 13.1], "backwards": True},
    [1.1, 13.1],
    {"to": [9.0, 13.1], "backwards": True},
    [1.1, 13.1],
    [1.1, 5.9],
]
"""Around the ring of corridors of an office of the usual size, back and forth."""


def _csail(bench: Bench) -> tuple[Path, Trajectory]:
    log = next(log for log in LOGS if log.name == "CSAIL")
    folder = bench.data / "benchmark"
    if not (folder / log.file).exists():
        raise AbsentError
    return folder / log.file, read_reference(folder / log.reference)


def _office(bench: Bench) -> tuple[Path, Trajectory]:
    lane = {"path": _REVERSING_PATH, "repeat": 2, "pause_s": 0.0}
    recording = bench.recorded("still_office", "office-reversing", lane=lane)
    return recording, read_reference(truth_folder(recording) / "trajectory.tum")


SOURCES: dict[str, Callable[[Bench], tuple[Path, Trajectory]]] = {
    "CSAIL": _csail,
    "office, reversing": _office,
}
"""Recordings, and the poses they are compared with."""


@dataclass(frozen=True)
class Outcome:
    """What became of one perturbation."""

    error_m: float
    trajectory: Trajectory
    found: dict[str, Any]


def tables(bench: Bench) -> list[Table]:
    """One table."""
    table = Table(
        "Odometry made worse",
        [
            "The odometry of a real and of a simulated recording, changed after ingest; scans as they are. ATE in m "
            "after alignment, against reference poses (CSAIL, not surveyed, some 0.05 m off themselves) and against "
            "the truth; one registration of all beams. *Moved*: root mean square distance of the path from the one as "
            "recorded. Bound: 1.2 times the error as recorded, 1.1 times without odometry; what misses it is "
            "**bold**. *Faults*: stretches in which the odometry was found to stand still, slip or be wrong. *Said* "
            "is what else was found out about it.",
        ],
        [
            "recording",
            "odometry",
            "ATE m",
            "ratio",
            "bound",
            "moved m",
            "lost scans",
            "loops",
            "faults",
            "said",
        ],
    )
    for name in SOURCES:
        jobs = {what: bench.jobs.start(_map, bench, name, what) for what in (_UNPERTURBED, *BOUNDS)}
        for what in jobs:
            table.add(name, lambda what=what, jobs=jobs: _row(jobs, what))
        table.remark(f"{name}, odometry made worse", lambda jobs=jobs: _worst(jobs))
    return [table]


def _map(bench: Bench, name: str, what: str) -> Outcome:
    recording, reference = SOURCES[name](bench)
    variant = Variant(f"{what}, all beams", perturbation=what, filtered=False)
    outcome = mapped(bench, name.replace(", ", "-"), recording, variant)
    return Outcome(ate_m(outcome.trajectory, reference), outcome.trajectory, outcome.found)


def _row(jobs: dict[str, Future[Outcome]], what: str) -> Row:
    try:
        usual, outcome = jobs[_UNPERTURBED].result(), jobs[what].result()
    except AbsentError:
        return [what, "skipped: no recording"]
    found, ratio, bound, moved = outcome.found, "-", "-", "-"
    if what != _UNPERTURBED:
        times = outcome.error_m / usual.error_m
        ratio = number(times, 2) if times <= BOUNDS[what] else f"**{number(times, 2)}**"
        bound = f"{BOUNDS[what]}"
        moved = number(ate_m(outcome.trajectory, usual.trajectory))
    counts = [f"{found[name]}" for name in ("lost_scans", "loops", "wheel_faults")]
    return [what, number(outcome.error_m, 4), ratio, bound, moved, *counts, "; ".join(found["findings"])]


def _worst(jobs: dict[str, Future[Outcome]]) -> str:
    """How many perturbations keep the bound, and the worst."""
    try:
        usual_m = jobs[_UNPERTURBED].result().error_m
        ratios = {what: jobs[what].result().error_m / usual_m for what in BOUNDS}
    except AbsentError:
        return "skipped: no recording"
    kept = sum(ratio <= BOUNDS[what] for what, ratio in ratios.items())
    worst = max(ratios, key=lambda what: ratios[what])
    return f"{kept} of {len(BOUNDS)} within the bound; worst {ratios[worst]:.2f} times: {worst}"
