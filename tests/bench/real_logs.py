"""Real recordings: paths against hand-checked relations and reference poses, CPU seconds and memory."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynmap_cli.counting.counts import count_beams
from dynmap_cli.counting.em import occupancy
from dynmap_cli.counting.frames import frame_of_scans
from dynmap_cli.domain.grid import OCCUPIED
from dynmap_cli.evaluation.association import nearest_stamp
from dynmap_cli.evaluation.relations import read_relations, score_relations
from dynmap_cli.evaluation.scores import Score
from dynmap_cli.evaluation.trajectories import read_reference, score_trajectory
from dynmap_cli.evaluation.truth import read_run
from dynmap_cli.files.pgm import read_map
from dynmap_cli.files.trajectory import read_tum
from tests.bench.measured import Cost, stage_seconds
from tests.bench.tables import Row, Table, number
from tests.bench.worlds import Bench

STAGES = ("ingest", "map", "segment", "cluster", "report")
ODOMETRY = {"as recorded": (), "none": ("--odom", "none")}


@dataclass(frozen=True)
class RealLog:
    """A public recording, and what others reached on it.

    Attributes
    ----------
    name, file, relations, reference : str
    others : tuple of (str, str, str, str)
        Program, translation error, rotation error, CPU seconds; as published, or as run on the same log on another
        machine with two cores.
    """

    name: str
    file: str
    relations: str | None
    reference: str
    others: tuple[tuple[str, str, str, str], ...]


LOGS = (
    RealLog(
        "Intel",
        "intel.clf.bz2",
        "intel.relations",
        "intel.ref.txt",
        (
            ("Cartographer, published", "0.0229 ± 0.0239", "0.453", ""),
            ("graph mapping, published", "0.031 ± 0.026", "", ""),
            ("particle filter, published", "0.070 ± 0.083", "", ""),
            ("scan matching, published", "0.220 ± 0.296", "", ""),
            ("Cartographer, correlative, as run", "0.021", "0.32", "283"),
            ("Karto, as run", "0.022", "0.70", "73"),
            ("GMapping, as run", "0.041", "1.9", "57"),
            ("yag-slam, as run", "0.044", "1.3", "9.3"),
        ),
    ),
    RealLog(
        "fr079",
        "fr079.clf.bz2",
        "fr079.relations",
        "fr079.ref.txt",
        (
            ("Cartographer, published, tuned", "0.0452 ± 0.0354", "0.538", ""),
            ("graph mapping, published", "0.056 ± 0.042", "", ""),
            ("particle filter, published", "0.061 ± 0.044", "", ""),
            ("scan matching, published", "0.258 ± 0.427", "", ""),
            ("MRPT particle filter with ICP, as run", "0.078", "1.5", "137"),
            ("MRPT ICP, as run", "0.187", "", ""),
            ("yag-slam, as run", "1.67, wrong map", "", ""),
            ("GMapping, as run", "1.78, wrong map", "", ""),
            ("Cartographer, as run", "2.54, wrong map", "", ""),
            ("Karto, as run", "4.99, wrong map", "", ""),
        ),
    ),
    RealLog("CSAIL", "mit-csail.clf.bz2", None, "mit-csail.ref.txt", ()),
)


class AbsentError(Exception):
    """The recording is not on this machine."""


def build_log(bench: Bench, log: RealLog, odometry: str) -> tuple[Path, Cost]:
    """Build with default settings."""
    recording = bench.data / "benchmark" / log.file
    if not recording.exists():
        raise AbsentError
    name = f"{log.name}-odometry-{odometry.replace(' ', '-')}"
    return bench.built(name, recording, *ODOMETRY[odometry])


def relations_row(bench: Bench, log: RealLog, run_dir: Path) -> Row:
    """Errors against relations, where there are some, and against the reference poses."""
    folder = bench.data / "benchmark"
    estimate = read_tum(run_dir / "map" / "trajectory.tum")
    ate = score_trajectory("", estimate, read_reference(folder / log.reference))
    cells = ["-"] * 7
    if log.relations:
        v = score_relations("", estimate, read_relations(folder / log.relations)).values
        cells = [
            f"{v['relations_used']:.0f} of {v['relations']:.0f}",
            f"{v['translation_mean_m']:.4f} ± {v['translation_std_m']:.4f}",
            number(v["translation_median_m"], 4),
            number(v["translation_max_m"], 3),
            f"{v['rotation_mean_deg']:.3f} ± {v['rotation_std_deg']:.3f}",
            number(v["rotation_median_deg"], 3),
            number(v["rotation_max_deg"], 2),
        ]
    return [*cells, *_ate_cells(ate)]


def _ate_cells(score: Score) -> Row:
    if not score.is_complete:
        return [f"incomplete, {100 * score.coverage:.0f} % of the poses"]
    return [f"{score.values['ate_rmse_m']:.3f}"]


def sharpness_cells(bench: Bench, log: RealLog, run_dir: Path) -> Row:
    """Occupied cells of maps drawn from the same scans, at our poses and at the reference poses."""
    reference = read_reference(bench.data / "benchmark" / log.reference)
    run = read_run(run_dir)
    partner = nearest_stamp(reference.stamps_ns, run.log.stamps_ns, 0.001)
    scans = np.flatnonzero(partner >= 0)
    chosen = run.log.select(scans)
    counts = []
    for poses in (run.poses[scans], reference.poses[partner[scans]]):
        frame = frame_of_scans(chosen, poses, 30.0, 0.05)
        cells = occupancy(count_beams(chosen, poses, frame, 30.0)).cells
        counts.append(int((cells == OCCUPIED).sum()))
    grid, _ = read_map(run_dir / "map" / "map.yaml")
    whole = int((grid.cells == OCCUPIED).sum())
    ratio = counts[0] / counts[1]
    return [f"{scans.size}", f"{counts[0]}", f"{counts[1]}", f"{ratio:.3f}", f"{whole}"]


def tables(bench: Bench) -> list[Table]:
    """Three tables: errors, sharpness of maps, costs."""
    logs = LOGS[2:] if bench.quick else LOGS
    jobs: dict[tuple[str, str], Future[tuple[Path, Cost]]] = {
        (log.name, odometry): bench.jobs.start(build_log, bench, log, odometry)
        for log in logs
        for odometry in ODOMETRY
    }
    errors = Table(
        "Real recordings: path",
        [
            "`dynmap build LOG` with default settings, the same for all logs. Errors of relative poses "
            "that were "
            "checked by hand (Kuemmerle et al., 2009), and root mean square distance (ATE) to "
            "reference poses which "
            "others computed and which are not surveyed truth. Below each log: what other programs are "
            "reported to reach "
            "(*published*), or reached on this log on another machine with two cores (*as run*).",
        ],
        [
            "log",
            "odometry",
            "relations",
            "m mean ± std",
            "median",
            "max",
            "deg mean ± std",
            "median",
            "max",
            "ATE m",
            "CPU s",
        ],
    )
    sharp = Table(
        "Real recordings: occupied cells",
        [
            "Occupied cells of 5 cm of plain counting maps, drawn from the same scans (those that have "
            "a reference "
            "pose) at the poses found and at the reference poses: the fewer, the sharper. Last: "
            "occupied cells of the "
            "map as built.",
        ],
        ["log", "odometry", "scans", "cells, poses found", "cells, reference poses", "ratio", "map.pgm"],
    )
    costs = Table(
        "Real recordings: cost",
        [
            "CPU seconds per stage (from the manifests) and of the whole `dynmap build` process with "
            "one thread, start "
            "included, compilation not; peak resident memory.",
        ],
        ["log", "odometry", *STAGES, "whole process", "peak MB", "CPU ms per scan"],
    )
    for log in logs:
        for odometry in ODOMETRY:
            _add_rows(bench, log, odometry, jobs[log.name, odometry], (errors, sharp, costs))
        for program, translation, rotation, seconds in log.others:
            errors.rows.append([log.name, program, "", translation, "", "", rotation, "", "", "", seconds])
    return [errors, sharp, costs]


def _add_rows(
    bench: Bench, log: RealLog, odometry: str, job: Future[tuple[Path, Cost]], into: Sequence[Table]
) -> None:
    """One row of each table."""
    errors, sharp, costs = into

    def outcome() -> tuple[Path, Cost]:
        return job.result()

    def error_row() -> Row:
        try:
            run_dir, cost = outcome()
        except AbsentError:
            return [f"dynmap, {odometry}", "skipped: no recording"]
        return [f"**dynmap, {odometry}**", *relations_row(bench, log, run_dir), f"{cost.cpu_s:.1f}"]

    def sharp_row() -> Row:
        try:
            run_dir, _ = outcome()
        except AbsentError:
            return [odometry, "skipped: no recording"]
        return [odometry, *sharpness_cells(bench, log, run_dir)]

    def cost_row() -> Row:
        try:
            run_dir, cost = outcome()
        except AbsentError:
            return [odometry, "skipped: no recording"]
        seconds = stage_seconds(run_dir)
        n_scans = read_run(run_dir).log.n_scans
        cells = [number(seconds.get(stage, float("nan")), 1) for stage in STAGES]
        return [
            odometry, *cells, f"{cost.cpu_s:.1f}", f"{cost.peak_mb:.0f}", f"{1000 * cost.cpu_s / n_scans:.2f}",
        ]  # fmt: skip

    def short() -> str:
        try:
            run_dir, cost = outcome()
        except AbsentError:
            return "skipped: no recording"
        row = relations_row(bench, log, run_dir)
        where = f"{row[1]} m, {row[4]} deg" if log.relations else f"{row[7]} m ATE to reference poses"
        return f"{where}; {cost.cpu_s:.0f} s CPU, {cost.peak_mb:.0f} MB"

    errors.add(log.name, error_row)
    sharp.add(log.name, sharp_row)
    costs.add(log.name, cost_row)
    errors.remark(f"{log.name}, odometry {odometry}", short)
