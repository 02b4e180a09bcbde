"""Every world of configs/worlds through `dynmap build`: labels of beams, path, false sub-maps."""

from __future__ import annotations

import math
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynmap_cli.evaluation.beams import score_beams
from dynmap_cli.evaluation.scores import Score
from dynmap_cli.evaluation.trajectories import score_trajectory
from dynmap_cli.evaluation.truth import read_run
from dynmap_cli.files.trajectory import read_tum
from tests.bench.measured import Cost, summary_of
from tests.bench.tables import Row, Table, number, percent
from tests.bench.worlds import LANE, Bench, truth_of

CUT: dict[str, LANE] = {
    "two_doors": {"repeat": 3},
    "four_places": {"repeat": 10},
    "round_walls": {},
    "still_office": {"repeat": 1},
    "office_days": {"repeat": 1, "days": 2},
    "office_two_hours": {"repeat": 1},
    "watched_doors": {"repeat": 2},
    "crowd": {"repeat": 2},
    "concourse": {},
    "guided_tour": {"repeat": 1},
    "operator": {"repeat": 1},
    "home": {"repeat": 1, "days": 1},
    "glass_lobby": {"repeat": 3},
    "warehouse": {"repeat": 1},
    "car_park": {"repeat": 1, "days": 2},
    "no_odometry": {"repeat": 1},
    "bad_odometry": {"repeat": 1},
    "only_doors": {"repeat": 3},
    "torso_height": {"repeat": 1},
    "hard_cases": {},
}
"""Every world, with fewer visits than its scenario asks for, so that the whole table takes minutes."""
METHODS = ("run", "without looks", "plain counting", "paper to the letter")


@dataclass(frozen=True)
class Judged:
    """One world, judged.

    Attributes
    ----------
    score : Score
        Of the beams.
    ate_m : float
        NaN where poses are missing.
    scans, submaps : int
    moving_share : float
        Of the beams with an end point.
    cost : Cost
    """

    score: Score
    ate_m: float
    scans: int
    submaps: int
    moving_share: float
    cost: Cost

    def measure(self, method: str, name: str) -> float:
        """One measure of the run or of an ablation."""
        rows = self.score.details["methods at the same poses"]
        return float(next(row[name] for row in rows if row["method"] == method))


def judge(bench: Bench, world: str) -> Judged:
    """Simulate, build, compare with the truth."""
    recording = bench.recorded(world, f"{world}-cut", lane=CUT[world])
    run_dir, cost = bench.built(f"{world}-cut", recording)
    truth = truth_of(recording)
    path = score_trajectory(world, read_tum(run_dir / "map" / "trajectory.tum"), truth.trajectory)
    ended = truth.beam_class != truth.no_return
    return Judged(
        score_beams(world, read_run(run_dir), truth),
        path.values["ate_rmse_m"] if path.is_complete else math.nan,
        truth.trajectory.stamps_ns.size,
        _count_submaps(run_dir),
        float((truth.beam_class[ended] == truth.moving).mean()),
        cost,
    )


def _count_submaps(run_dir: Path) -> int:
    return int(summary_of(run_dir / "submaps", "segment")["submaps"])


def row_of(judged: Judged) -> Row:
    """Cells of one world."""
    scans = f"{judged.scans}"
    if not judged.score.is_complete:
        scans += f", INCOMPLETE ({percent(judged.score.coverage)})"
    cells = [scans, percent(judged.moving_share, 2), number(judged.ate_m), f"{judged.submaps}"]
    for method in METHODS:
        names = ("static_kept_SA", "dynamic_found_DA", "harmonic_HA", "F1")
        cells += [number(judged.measure(method, name)) for name in names]
    return [*cells, f"{judged.cost.cpu_s:.1f}", f"{judged.cost.peak_mb:.0f}"]


def tables(bench: Bench) -> list[Table]:
    """One table."""
    worlds = ["crowd", "round_walls"] if bench.quick else list(CUT)
    jobs: dict[str, Future[Judged]] = {world: bench.jobs.start(judge, bench, world) for world in worlds}
    table = Table(
        "Beams, inside the whole program",
        [
            "Each world of `configs/worlds`, cut to fewer visits, through `dynmap simulate` and "
            "`dynmap build`: poses "
            "are those that were found. SA = share of the beams on walls that are kept, DA = share of "
            "the beams on "
            'moving things that are removed, HA = their harmonic mean, F1 of "moving". Beside: three '
            "ablations at the same "
            "poses: the filter without looks, the plain counting map thresholded, and the paper to the letter "
            "(support of the end cell alone). "
            "Beams on doors and boxes are in neither share. ATE in m, after alignment.",
        ],
        ["world", "scans", "moving", "ATE", "sub-maps"]
        + [
            f"{name} {method}"
            for method in ("", "no looks", "plain", "paper")
            for name in ("SA", "DA", "HA", "F1")
        ]
        + ["CPU s", "peak MB"],
    )
    table.header = [word.strip() for word in table.header]
    for world in worlds:
        table.add(world, lambda world=world: row_of(jobs[world].result()))

    def overall(method: str) -> str:
        known = [job.result() for job in jobs.values() if job.exception() is None]
        shares = [one.measure(method, "harmonic_HA") for one in known if one.moving_share > 0]
        kept = [one.measure(method, "static_kept_SA") for one in known]
        return f"HA {np.mean(shares):.3f}, least {np.min(shares):.3f}; least SA {np.min(kept):.3f}"

    for method, words in zip(
        METHODS,
        ("dynmap", "dynmap without looks", "plain counting map", "the paper to the letter"),
        strict=True,
    ):
        table.remark(f"beams in {len(worlds)} worlds, mean, {words}", lambda method=method: overall(method))

    def paths() -> str:
        errors = [job.result().ate_m for job in jobs.values() if job.exception() is None]
        return f"{np.median(errors):.3f} m median, {np.max(errors):.3f} m largest"

    table.remark(f"ATE in {len(worlds)} worlds", paths)
    return [table]
