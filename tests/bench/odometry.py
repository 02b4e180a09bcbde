"""Odometry made worse: what it does to the path, and what the calibration says of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

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
_OTHER_DRAW = 9
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


def _csail(bench: Bench, _seed: int) -> tuple[Path, Trajectory]:
    log = next(log for log in LOGS if log.name == "CSAIL")
    folder = bench.data / "benchmark"
    if not (folder / log.file).exists():
        raise AbsentError
    return folder / log.file, read_reference(folder / log.reference)


def _office(bench: Bench, seed: int) -> tuple[Path, Trajectory]:
    lane = {"path": _REVERSING_PATH, "repeat": 2, "pause_s": 0.0}
    recording = bench.recorded("still_office", f"office-reversing-{seed}", seed, lane)
    return recording, read_reference(truth_folder(recording) / "trajectory.tum")


SOURCES: dict[str, Callable[[Bench, int], tuple[Path, Trajectory]]] = {
    "CSAIL": _csail,
    "office, reversing": _office,
}
"""Recordings, by their seed where they are simulated, and the poses they are compared with."""


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
            "The odometry of a real and of simulated recordings, changed after ingest. ATE in m once aligned, against "
            "reference poses (CSAIL, not surveyed, some 0.05 m off themselves) and against the truth; one registration "
            "of all beams. Which scans become key scans, and with that some of the error, is chance: each line is the "
            f"median of {len(bench.seeds)} draws (the same changes of the odometry with 1 mm of further noise on the "
            "ranges, a tenth of what lasers have, and in the office also with another seed), *from, to* are the least "
            "and the largest. *Ratio*: of the medians. *Moved*: root mean square distance of the path from the one as "
            "recorded; in its own line from another draw of it, which is what chance does. Bound: 1.2 times the error "
            "as recorded, 1.1 times without odometry; what misses it is **bold**. *Faults*: stretches in which the "
            "odometry was found to stand still, slip or be wrong. *Said* is what else was found out about it, in the "
            "first draw.",
        ],
        [
            "recording",
            "odometry",
            "ATE m",
            "from",
            "to",
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
        jobs = {
            what: [bench.jobs.start(_map, bench, name, what, seed) for seed in bench.seeds]
            for what in (_UNPERTURBED, *BOUNDS)
        }
        again = bench.jobs.start(_map, bench, name, _UNPERTURBED, bench.seeds[0], _OTHER_DRAW)
        for what in jobs:
            table.add(name, lambda what=what, jobs=jobs, again=again: _row(jobs, what, again))
        table.remark(f"{name}, odometry made worse", lambda jobs=jobs: _worst(jobs))
    return [table]


def _map(bench: Bench, name: str, what: str, seed: int, draw: int | None = None) -> Outcome:
    recording, reference = SOURCES[name](bench, seed)
    draw = seed if draw is None else draw
    variant = Variant(f"{what}, all beams, {draw}", perturbation=what, draw=draw, filtered=False)
    outcome = mapped(bench, recording.name.split(".")[0], recording, variant)
    return Outcome(ate_m(outcome.trajectory, reference), outcome.trajectory, outcome.found)


def _median_m(jobs: Sequence[Future[Outcome]]) -> float:
    return float(np.median([job.result().error_m for job in jobs]))


def _row(jobs: dict[str, list[Future[Outcome]]], what: str, again: Future[Outcome]) -> Row:
    try:
        usual, outcomes = ([job.result() for job in jobs[each]] for each in (_UNPERTURBED, what))
        others = outcomes if what != _UNPERTURBED else [again.result()]
    except AbsentError:
        return [what, "skipped: no recording"]
    ratio, bound = "-", "-"
    if what != _UNPERTURBED:
        times = _median_m(jobs[what]) / _median_m(jobs[_UNPERTURBED])
        ratio = number(times, 2) if times <= BOUNDS[what] else f"**{number(times, 2)}**"
        bound = f"{BOUNDS[what]}"
    moved = np.median([ate_m(b.trajectory, a.trajectory) for a, b in zip(usual, others, strict=False)])
    errors = [outcome.error_m for outcome in outcomes]
    counts = [
        f"{np.median([outcome.found[each] for outcome in outcomes]):.0f}"
        for each in ("lost_scans", "loops", "wheel_faults")
    ]
    spread = [number(value, 4) for value in (float(np.median(errors)), min(errors), max(errors))]
    said = "; ".join(outcomes[0].found["findings"])
    return [what, *spread, ratio, bound, number(float(moved)), *counts, said]


def _worst(jobs: dict[str, list[Future[Outcome]]]) -> str:
    """How many perturbations keep the bound, and the worst."""
    try:
        usual_m = _median_m(jobs[_UNPERTURBED])
        ratios = {what: _median_m(jobs[what]) / usual_m for what in BOUNDS}
    except AbsentError:
        return "skipped: no recording"
    kept = sum(ratio <= BOUNDS[what] for what, ratio in ratios.items())
    worst = max(ratios, key=lambda what: ratios[what])
    return f"{kept} of {len(BOUNDS)} within the bound; worst {ratios[worst]:.2f} times: {worst}"
