"""A robot that goes round and round an office of about 115 m a lap: accuracy after hours, and cost per scan."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from dynmap_cli.domain.poses import Trajectory
from dynmap_cli.files.trajectory import read_tum
from tests.bench.map_once import CALIBRATION, REST
from tests.bench.mapped import Mapped, Variant, ate_m, ingested, mapped
from tests.bench.tables import Row, Table, number
from tests.bench.worlds import Bench, truth_folder

LAPS = {1: 17, 2: 33, 4: 66, 8: 133}
"""Laps that take so many hours."""
ATE_BOUND_M = 0.05
PICTURE = Path(__file__).with_name("length.png")
_TWO_HOURS = 2
OFFICE = {
    "seed": 16,
    "turn_deg": 12,
    "generate": {
        "kind": "office",
        "size_m": [36, 19],
        "boxes": 6,
        "people": 4,
        "talking": 2,
        "changes": {"mean_s": 900, "when": "away"},
        "seed": 16,
    },
}
"""An office in which things change behind the robot."""
_SCENARIO = {
    **OFFICE,
    "lasers": [
        {
            "beams": 181,
            "fov_deg": 180,
            "max_range_m": 25,
            "rate_hz": 5,
            "dropout_share": 0.01,
            "grazing_deg": 3,
        }
    ],
    "odometry": {"rate_hz": 20, "translation_scale": 1.01, "rotation_scale": 0.985, "bias_degpm": 0.3},
}
_COLUMNS = {
    "front end": ("front end",),
    "loops, graph": ("loops, graph", "fitting poses"),
    "counting, EM": ("counting, EM", "looks"),
}


@dataclass(frozen=True)
class Patrolled:
    """One patrol, mapped."""

    truth: Trajectory
    outcome: Mapped
    ingest_s: float

    def ms_per_scan(self) -> dict[str, float]:
        """CPU milliseconds per scan of each part."""
        seconds = dict(self.outcome.found["seconds"])
        parts = {"reading": self.ingest_s}
        parts |= {column: sum(seconds.pop(name, 0.0) for name in names) for column, names in _COLUMNS.items()}
        parts["calibration"] = seconds.pop(CALIBRATION, 0.0)
        parts["rest"] = seconds.pop(REST, 0.0)
        return {name: 1000.0 * value / self.truth.stamps_ns.size for name, value in parts.items()}


def patrolled(bench: Bench, hours: int) -> Patrolled:
    """Simulate, ingest, map."""
    laps = 2 * hours if bench.quick else LAPS[hours]
    name = f"patrol-{laps}-laps"
    recording = bench.simulated(name, {**_SCENARIO, "robot": {"repeat": laps, "speed_mps": 0.6}})
    _, ingest_s = ingested(bench, name, recording)
    outcome = mapped(bench, name, recording, Variant("as recorded"))
    return Patrolled(read_tum(truth_folder(recording) / "trajectory.tum"), outcome, ingest_s)


def patrol_row(one: Patrolled) -> Row:
    """Length and error."""
    stamps, poses = one.truth.stamps_ns, one.truth.poses
    error_m = ate_m(one.outcome.trajectory, one.truth)
    found = one.outcome.found
    return [
        f"{(stamps[-1] - stamps[0]) / 3.6e12:.2f}",
        f"{stamps.size}",
        f"{np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1).sum():.0f}",
        number(error_m, 4) if error_m <= ATE_BOUND_M else f"**{number(error_m, 4)}**",
        f"{found['keys']}",
        f"{found['loops']}",
        number(found["contradictions"]),
    ]


_HEADER = ["h", "scans", "m driven", "ATE m", "key scans", "loops", "contradictions"]
_ABOUT = (
    "A simulated robot with 181 beams at 5 Hz and odometry that errs goes round and round in an office, about 115 m "
    "a lap, with people, doors and boxes that change. ATE after alignment; bound 0.05 m, what misses it is **bold**."
)


def tables(bench: Bench) -> list[Table]:
    """Two hours of patrol."""
    job = bench.jobs.start(patrolled, bench, _TWO_HOURS)
    table = Table("Patrol of two hours", [_ABOUT], ["", *_HEADER, "CPU s", "peak MB"])
    table.add("patrol", lambda: [*patrol_row(job.result()), *_cost_cells(job.result().outcome)])
    table.remark(
        "patrol of two hours, ATE",
        lambda: f"{number(ate_m(job.result().outcome.trajectory, job.result().truth), 4)} m",
    )
    return [table]


def _cost_cells(outcome: Mapped) -> Row:
    return [f"{outcome.cost.cpu_s:.1f}", f"{outcome.cost.peak_mb:.0f}"]


def length_tables(bench: Bench) -> list[Table]:
    """CPU per scan over the length of the recording, as a table and as a picture."""
    jobs = {hours: bench.jobs.start(patrolled, bench, hours) for hours in LAPS}
    parts = ["reading", *_COLUMNS, "calibration", "rest"]
    table = Table(
        "Cost per scan over the length of a recording",
        [
            f"{_ABOUT} CPU milliseconds per scan of each part, two rounds of EM, one thread; peak memory of the "
            "mapping process. Flat rows are what is wanted: ![CPU per scan](length.png)",
        ],
        ["patrol of", *_HEADER, *(f"ms, {part}" for part in parts), "ms, all", "peak MB"],
    )
    for hours, job in jobs.items():
        table.add(f"{hours} h", lambda job=job: _length_row(job, parts))
    known = {hours: job.result() for hours, job in jobs.items() if job.exception() is None}
    if known:
        draw(known, bench.folder / PICTURE.name if bench.quick else PICTURE)
    return [table]


def _length_row(job: Future[Patrolled], parts: list[str]) -> Row:
    one = job.result()
    spent = one.ms_per_scan()
    cells = [number(spent[part]) for part in parts]
    return [*patrol_row(one), *cells, number(sum(spent.values())), f"{one.outcome.cost.peak_mb:.0f}"]


def draw(known: dict[int, Patrolled], path: Path) -> None:
    """Lines of CPU milliseconds per scan over hours."""
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axes = figure.subplots()
    spent = {hours: one.ms_per_scan() for hours, one in known.items()}
    for part in next(iter(spent.values())):
        axes.plot(list(spent), [row[part] for row in spent.values()], "o-", label=part)
    axes.set(xlabel="hours of patrol", ylabel="CPU ms per scan", xscale="log", ylim=(0, None))
    axes.set_xticks(list(spent), [str(hours) for hours in spent])
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=110)
