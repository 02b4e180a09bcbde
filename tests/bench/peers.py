"""Other programs on the same logs, in the same run, where they are installed."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from dynmap_cli.domain.poses import compose, inverse
from dynmap_cli.evaluation.localization import Localized, score_localization
from dynmap_cli.evaluation.relations import read_relations, score_relations
from dynmap_cli.evaluation.states import read_learned_states
from dynmap_cli.evaluation.trajectories import read_reference, score_trajectory
from dynmap_cli.files.trajectory import read_tum
from tests.bench import beams, localization, real_logs, states
from tests.bench.measured import python, stage_seconds
from tests.bench.tables import Row, Table, number
from tests.bench.worlds import Bench, truth_folder, truth_of

SIMULATED = ("crowd", "still_office", "operator")
WORLDS = ("two_doors", "only_doors", "office_days")
SKIPPED = "skipped: not installed"


@dataclass(frozen=True)
class Compared:
    """Errors and CPU seconds of both programs on one log."""

    unit: str
    ours: float
    theirs: float
    our_cpu_s: float
    their_cpu_s: float

    def cells(self) -> Row:
        """Cells of a row."""
        return [
            self.unit,
            number(self.ours, 4),
            number(self.theirs, 4),
            f"{self.theirs / self.ours:.2f}",
            f"{self.our_cpu_s:.1f}",
            f"{self.their_cpu_s:.1f}",
            f"{self.their_cpu_s / self.our_cpu_s:.2f}",
        ]


def map_both(bench: Bench, name: str, run_dir: Path, error: Callable[[Path], float], unit: str) -> Compared:
    """Map the scans of a run with yag-slam."""
    out = bench.folder / "peers" / f"{name}-yag.tum"
    cost = python("-m", "tests.bench.peer_yag", run_dir / "scans", out, log=out.with_suffix(".txt"))
    ours = run_dir / "map" / "trajectory.tum"
    return Compared(unit, error(ours), error(out), stage_seconds(run_dir)["map"], cost.cpu_s)


def map_real(bench: Bench, log: real_logs.RealLog) -> Compared:
    """Map a real recording with both."""
    run_dir, _ = real_logs.build_log(bench, log, "as recorded")
    folder = bench.data / "benchmark"

    def error(path: Path) -> float:
        if log.relations:
            score = score_relations("", read_tum(path), read_relations(folder / log.relations))
            return score.values["translation_mean_m"]
        return score_trajectory("", read_tum(path), read_reference(folder / log.reference)).values[
            "ate_rmse_m"
        ]

    return map_both(bench, log.name, run_dir, error, "relations, m" if log.relations else "ATE, m")


def map_world(bench: Bench, world: str) -> Compared:
    """Map a simulated recording with both."""
    name = f"{world}-cut"
    recording = bench.recorded(world, name, lane=beams.CUT[world])
    run_dir, _ = bench.built(name, recording)
    truth = read_tum(truth_folder(recording) / "trajectory.tum")
    return map_both(
        bench,
        name,
        run_dir,
        lambda path: score_trajectory("", read_tum(path), truth).values["ate_rmse_m"],
        "ATE, m",
    )


def localize_world(bench: Bench, world: str, seed: int) -> Compared:
    """Localize with AMCL and with the patch map, from the same given start."""
    name = states.name_of(world, seed)
    mapped = bench.recorded(world, name, seed, states.WORLDS[world])
    run_dir, _ = bench.built(name, mapped)
    lane = localization.LANES[world]
    recording = bench.recorded(world, f"{name}-other-day", seed + localization.OTHER_DAY, lane)
    truth, map_truth = truth_of(recording), truth_of(mapped)
    learned = bench.jobs.once(("learned", run_dir.name), lambda: read_learned_states(run_dir, map_truth))
    start = compose(inverse(learned.truth_from_map), truth.trajectory.poses[0])
    given = ",".join(f"{value:.6f}" for value in start)
    out_dir, ours = bench.localized(f"{name}-given-start", run_dir, recording, f"--start={given}")
    out = bench.folder / "peers" / f"{name}-amcl.tum"
    theirs = python(
        "-m", "tests.bench.peer_amcl", out_dir / "scans", run_dir / "map" / "map.yaml",
        *(f"{value:.6f}" for value in start), out, log=out.with_suffix(".txt"),
    )  # fmt: skip
    nothing = np.empty(0, dtype=np.int64)
    result = Localized(read_tum(out_dir / "trajectory.tum"), {}, nothing, nothing.astype(bool), None)
    errors = [
        score_localization("", one, truth, learned).values["position_error_mean_m"]
        for one in (result, replace(result, trajectory=read_tum(out)))
    ]
    return Compared("mean error, m", *errors, ours.cpu_s, theirs.cpu_s)


def tables(bench: Bench) -> list[Table]:
    """Two tables."""
    header = ["error in", "dynmap", "peer", "peer / dynmap", "CPU s dynmap", "CPU s peer", "peer / dynmap"]
    mapping = Table(
        "Peer: yag-slam",
        [
            "The same scans and odometry, as ingested, with the default settings of both. CPU: stage "
            "`map` of dynmap, "
            "two rounds of EM included; the whole process of the peer. Peers come with `pip install "
            '".[peers]"`. Its '
            "result on Intel differs from run to run (0.08 to 0.49 m seen here), and others reached 0.044 m.",
        ],
        ["log", *header],
    )
    localizing = Table(
        "Peer: amcl",
        [
            "AMCL's own code on the filtered map of the run, dynmap on the patch map, both from the "
            "same given start, both with 500 to 3000 particles, 60 beams, updates every 0.1 m or "
            "0.1 rad. CPU: whole processes.",
        ],
        ["world, seed", *header],
    )
    if find_spec("yag_slam"):
        logs = real_logs.LOGS[2:] if bench.quick else real_logs.LOGS
        _add(mapping, {log.name: bench.jobs.start(map_real, bench, log) for log in logs})
        worlds = SIMULATED[:1] if bench.quick else SIMULATED
        _add(mapping, {world: bench.jobs.start(map_world, bench, world) for world in worlds})
    else:
        mapping.rows.append(["yag-slam", SKIPPED, *([""] * 6)])
    if find_spec("amcl"):
        pairs = [(world, seed) for world in WORLDS[: 1 if bench.quick else None] for seed in bench.seeds[:1]]
        _add(localizing, {f"{w}, {s}": bench.jobs.start(localize_world, bench, w, s) for w, s in pairs})
    else:
        localizing.rows.append(["amcl", SKIPPED, *([""] * 6)])
    return [mapping, localizing]


def _add(table: Table, jobs: dict[str, Future[Compared]]) -> None:
    """One row per log, and one line for all in the short form: geometric means."""

    def cells(job: Future[Compared]) -> Row:
        try:
            return job.result().cells()
        except real_logs.AbsentError:
            return ["skipped: no recording"]

    def short() -> str:
        known = [job.result() for job in jobs.values() if job.exception() is None]
        errors = np.exp(np.mean([np.log(one.theirs / one.ours) for one in known]))
        seconds = np.exp(np.mean([np.log(one.their_cpu_s / one.our_cpu_s) for one in known]))
        return (
            f"{errors:.1f} times the error, {seconds:.2f} times the CPU seconds (mean of {len(known)} logs)"
        )

    for name, job in jobs.items():
        table.add(name, lambda job=job: cells(job))
    if jobs:
        table.remark(f"{table.title.lower()}, {next(iter(jobs))} and others", short)
