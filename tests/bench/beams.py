"""Every world of configs/worlds through `dynmap build`: labels of beams, path, false sub-maps."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dynmap_cli.counting.counts import twists_of
from dynmap_cli.counting.em import FilterParams, filter_beams
from dynmap_cli.counting.frames import frame_of_scans
from dynmap_cli.counting.standing import LookParams, filter_by_looks
from dynmap_cli.evaluation.beams import PROBABILITY_LIMITS, score_beams
from dynmap_cli.evaluation.scores import Score
from dynmap_cli.evaluation.trajectories import score_trajectory
from dynmap_cli.evaluation.truth import Run, Truth, read_run, same_scans
from dynmap_cli.files.trajectory import read_tum
from dynmap_cli.mapping.settings import MapSettings
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
METHODS = {
    "run": "dynmap",
    "run, without unknown beams": "dynmap, without the beams it calls unknown",
    "without watches": "dynmap without watches",
    "with grazing beams": "dynmap with grazing beams as evidence",
    "without looks": "dynmap without looks",
    "plain counting": "plain counting map",
    "paper to the letter": "the paper to the letter",
}
NOISE_M = 0.02


@dataclass(frozen=True)
class Judged:
    """One world, judged.

    Attributes
    ----------
    score : Score
        Of the beams, at the poses that were found.
    noisy_score : Score
        Of the beams, at true poses with noise.
    ate_m : float
        NaN where poses are missing.
    scans, submaps : int
    moving_share : float
        Of the beams with an end point.
    cost : Cost
    """

    score: Score
    noisy_score: Score
    ate_m: float
    scans: int
    submaps: int
    moving_share: float
    cost: Cost


def measure(score: Score, method: str, name: str) -> float:
    """One measure of the run or of an ablation."""
    rows = score.details["methods at the same poses"]
    return float(next(row[name] for row in rows if row["method"] == method))


def unknown(score: Score, beam_class: str) -> float:
    """Share of the beams of a class that are called unknown."""
    return float(next(row["unknown"] for row in score.details["by class"] if row["class"] == beam_class))


def judge(bench: Bench, world: str) -> Judged:
    """Simulate, build, compare with the truth."""
    recording = bench.recorded(world, f"{world}-cut", lane=CUT[world])
    run_dir, cost = bench.built(f"{world}-cut", recording)
    truth, run = truth_of(recording), read_run(run_dir)
    path = score_trajectory(world, read_tum(run_dir / "map" / "trajectory.tum"), truth.trajectory)
    ended = truth.beam_class != truth.no_return
    return Judged(
        score_beams(world, run, truth),
        score_beams(world, at_noisy_poses(run, truth), truth),
        path.values["ate_rmse_m"] if path.is_complete else math.nan,
        truth.trajectory.stamps_ns.size,
        _count_submaps(run_dir),
        float((truth.beam_class[ended] == truth.moving).mean()),
        cost,
    )


def at_noisy_poses(run: Run, truth: Truth) -> Run:
    """The same scans filtered at their true poses with independent noise, instead of those that were found."""
    mine, theirs = same_scans(run.log.stamps_ns, truth)
    poses = np.full((run.log.n_scans, 3), np.nan)
    poses[mine] = truth.trajectory.poses[theirs]
    poses[:, :2] += np.random.default_rng(1).normal(0.0, NOISE_M, (run.log.n_scans, 2))
    settings = MapSettings()
    usable_m = settings.usable_range_m
    frame = frame_of_scans(run.log, poses, usable_m, settings.resolution_m)
    twists = twists_of(run.log, poses)
    by_beams = filter_beams(run.log, poses, frame, FilterParams(), twists=twists)
    filtered = filter_by_looks(by_beams, run.log, poses, LookParams(), usable_range_m=usable_m, twists=twists)
    return replace(
        run,
        poses=poses,
        static_probability=filtered.static_probability,
        is_unknown=filtered.is_unknown,
    )


def _count_submaps(run_dir: Path) -> int:
    return int(summary_of(run_dir / "submaps", "segment")["submaps"])


def row_of(judged: Judged) -> Row:
    """Cells of one world: the run."""
    scans, score = f"{judged.scans}", judged.score
    if not score.is_complete:
        scans += f", INCOMPLETE ({percent(score.coverage)})"
    return [
        scans,
        percent(judged.moving_share, 2),
        number(judged.ate_m),
        f"{judged.submaps}",
        *_measures(score),
        f"{judged.cost.cpu_s:.1f}",
        f"{judged.cost.peak_mb:.0f}",
    ]


def _measures(score: Score) -> list[str]:
    """Cells of the labels: with unknown beams as kept, their shares, and without them."""
    names = ("static_kept_SA", "dynamic_found_DA", "harmonic_HA", "F1")
    known = "run, without unknown beams"
    return [
        *(number(measure(score, "run", name)) for name in names),
        percent(unknown(score, "static"), 2),
        percent(unknown(score, "moving"), 2),
        *(number(measure(score, known, name)) for name in ("dynamic_found_DA", "harmonic_HA")),
    ]


_MEASURES = ["SA", "DA", "HA", "F1", "unknown static", "unknown moving", "DA known", "HA known"]


def tables(bench: Bench) -> list[Table]:
    """The run, the same at true poses, the ablations, and the reliability."""
    worlds = ["crowd", "round_walls"] if bench.quick else list(CUT)
    jobs: dict[str, Future[Judged]] = {world: bench.jobs.start(judge, bench, world) for world in worlds}

    def known() -> list[Judged]:
        return [job.result() for job in jobs.values() if job.exception() is None]

    inside = Table(
        "Beams, inside the whole program",
        [
            "Each world of `configs/worlds`, cut to fewer visits, through `dynmap simulate` and "
            "`dynmap build`: poses are those that were found. SA = share of the beams on walls that are kept, "
            "DA = share of the beams on moving things that are removed, HA = their harmonic mean, F1 of "
            '"moving". Beams that are called unknown are kept, and count so; beside stand their share of '
            "the beams on walls and on moving things, and DA and HA without them. Beams on doors and boxes are "
            "in neither share. ATE in m, after alignment."
        ],
        ["world", "scans", "moving", "ATE", "sub-maps", *_MEASURES, "CPU s", "peak MB"],
    )
    at_truth = Table(
        "Beams, at true poses",
        [f"The same scans, filtered at their true poses with {100 * NOISE_M:g} cm of noise in x and y."],
        ["world", *_MEASURES],
    )
    ablation = Table(
        "Beams, ablations",
        [
            "At the poses that were found: SA and DA without watches; with grazing beams as evidence against a "
            "place; without looks; of the plain counting map, thresholded; of the paper to the letter (support "
            "of the end cell alone)."
        ],
        ["world", *(f"{name} {method}" for method in list(METHODS)[2:] for name in ("SA", "DA"))],
    )
    for world in worlds:
        inside.add(world, lambda world=world: row_of(jobs[world].result()))
        at_truth.add(world, lambda world=world: _measures(jobs[world].result().noisy_score))
        ablation.add(world, lambda world=world: _ablations(jobs[world].result().score))
    for method, words in METHODS.items():
        inside.remark(
            f"beams in {len(worlds)} worlds, mean, {words}",
            lambda method=method: _overall([one.score for one in known()], method),
        )
    at_truth.remark(
        f"beams in {len(worlds)} worlds, mean, dynmap at true poses with {100 * NOISE_M:g} cm of noise",
        lambda: _overall([one.noisy_score for one in known()], "run"),
    )

    def paths() -> str:
        errors = [one.ate_m for one in known()]
        return f"{np.median(errors):.3f} m median, {np.max(errors):.3f} m largest"

    inside.remark(f"ATE in {len(worlds)} worlds", paths)
    return [inside, at_truth, ablation, _reliability(known)]


def _ablations(score: Score) -> Row:
    """Cells of one world: SA and DA of each ablation."""
    names = ("static_kept_SA", "dynamic_found_DA")
    return [number(measure(score, method, name)) for method in list(METHODS)[2:] for name in names]


def _overall(scores: Sequence[Score], method: str) -> str:
    """Mean and least HA of the worlds in which something moves, least SA of all."""
    shares = [measure(score, method, "harmonic_HA") for score in scores]
    kept = [measure(score, method, "static_kept_SA") for score in scores]
    return f"HA {np.nanmean(shares):.3f}, least {np.nanmin(shares):.3f}; least SA {np.min(kept):.3f}"


def _reliability(known: Callable[[], list[Judged]]) -> Table:
    """Of the beams of all worlds that are called static with some probability, how many are."""
    table = Table(
        "Beams, reliability",
        [
            "All worlds together: beams on walls and on moving things by their static_probability; what is "
            "said on average, and the share that really hit a wall. First at the poses that were found, then at "
            f"true poses with {100 * NOISE_M:g} cm of noise."
        ],
        ["static_probability", "beams", "said", "true", "beams, true poses", "said", "true"],
    )

    def row(number_of_bin: int) -> Row:
        cells: list[str] = []
        for name in ("score", "noisy_score"):
            rows = [getattr(one, name).details["reliability"][number_of_bin] for one in known()]
            rows = [each for each in rows if each["beams"]]
            beams = sum(each["beams"] for each in rows)
            shares = [
                sum(each[what] * each["beams"] for each in rows) / max(beams, 1)
                for what in ("mean", "static")
            ]
            cells += [f"{beams}", *(number(share) for share in shares)]
        return cells

    for k, (low, high) in enumerate(itertools.pairwise(PROBABILITY_LIMITS)):
        table.add(f"{low:g} to {high:g}", lambda k=k: row(k))
    return table
