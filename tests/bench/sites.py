"""Large sites: what a whole build costs there, and whether the way is right."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

import numpy as np

from dynmap_cli.files.trajectory import read_tum
from tests.bench.mapped import ate_m
from tests.bench.measured import Cost, stage_seconds, summary_of
from tests.bench.site_worlds import Crossings, campus, corridors
from tests.bench.tables import Row, Table, number
from tests.bench.worlds import Bench, truth_folder

ATE_BOUND_M = 0.1
_STAGES = ("ingest", "map", "segment", "cluster", "report")
_CORRIDORS: Crossings = [
    (0, 0), (5, 0), (5, 3), (0, 3), (0, 0), (0, 1), (5, 1), (5, 2), (0, 2), (0, 1), (1, 1), (1, 0), (2, 0), (2, 3),
    (3, 3), (3, 0), (4, 0), (4, 3), (5, 3),
]  # fmt: skip
_CAMPUS: Crossings = [
    (0, 0), (5, 0), (5, 4), (0, 4), (0, 0), (0, 2), (5, 2), (5, 1), (1, 1), (1, 4), (3, 4), (3, 0), (4, 0), (4, 4),
]  # fmt: skip
_LARGER: Crossings = [
    (0, 0), (9, 0), (9, 10), (0, 10), (0, 0), (0, 5), (9, 5), (9, 2), (2, 2), (2, 8), (6, 8), (6, 0), (4, 0), (4, 10),
]  # fmt: skip
SITES: Mapping[str, Callable[[int], dict[str, Any]]] = {
    "corridors": lambda seed: corridors(seed, (5, 3), _CORRIDORS),
    "campus": lambda seed: campus(seed, (5, 4), _CAMPUS),
    "larger campus": lambda seed: campus(seed, (9, 10), _LARGER),
}
_SEEDS: Mapping[str, tuple[int, ...]] = {"corridors": (1, 2), "campus": (1, 2), "larger campus": (1,)}


@dataclass(frozen=True)
class Site:
    """One site, built.

    Attributes
    ----------
    way_m : float
        Truly driven.
    ate_m : float
        After alignment.
    summary : dict
        What the stage `map` said.
    seconds : dict
        CPU seconds of each stage.
    cost : Cost
        Of the whole build.
    """

    way_m: float
    ate_m: float
    summary: dict[str, Any]
    seconds: dict[str, float]
    cost: Cost


def tables(bench: Bench) -> list[Table]:
    """One table."""
    table = Table(
        "Large sites",
        [
            "Simulated, drawn from the seed. *Corridors*: 5 x 3 blocks of 42 x 32 m between corridors of 2.6 m, 180 "
            "beams of 50 m. *Campus*: 5 x 4 houses on plots of 55 x 50 m, trees and lamps, 361 beams of 80 m, of which "
            "half meet nothing. *Larger campus*: 9 x 10 houses. 5 scans per second, 20 people, wheels that slip in "
            "turns. A whole `dynmap build` with one thread into an empty folder, cells of 5 cm. ATE after alignment; "
            f"bound {ATE_BOUND_M:g} m, what misses it is **bold**. *Lost*: scans that fitted nowhere.",
        ],
        [
            "site, seed", "scans", "m driven", "map, m", "ATE m", "lost", "loops", "rejected",
            *(f"{stage}, CPU s" for stage in _STAGES), "whole build, CPU s", "peak MB",
        ],
    )  # fmt: skip
    pairs = [(name, seed) for name in SITES for seed in _SEEDS[name]]
    pairs = pairs[:1] if bench.quick else pairs
    # The largest first: it takes longer than all others.
    jobs = {pair: bench.jobs.start(measure, bench, *pair) for pair in reversed(pairs)}
    for name, seed in pairs:
        table.add(f"{name}, {seed}", lambda job=jobs[name, seed]: _row(job))
    return [table]


def measure(bench: Bench, name: str, seed: int) -> Site:
    """Simulate and build."""
    slug = f"{name.replace(' ', '-')}-seed-{seed}"
    recording = bench.simulated(slug, SITES[name](seed))
    run_dir, cost = bench.built(slug, recording)
    truth = read_tum(truth_folder(recording) / "trajectory.tum")
    way_m = float(np.linalg.norm(np.diff(truth.poses[:, :2], axis=0), axis=1).sum())
    error_m = ate_m(read_tum(run_dir / "map" / "trajectory.tum"), truth)
    return Site(way_m, error_m, summary_of(run_dir / "map", "map"), stage_seconds(run_dir), cost)


def _row(job: Future[Site]) -> Row:
    site = job.result()
    found = site.summary
    error = number(site.ate_m, 3)
    return [
        f"{found['scans']}",
        number(site.way_m, 0),
        " x ".join(number(size, 0) for size in found["size_m"]),
        error if site.ate_m <= ATE_BOUND_M else f"**{error}**",
        f"{found['lost_scans']}",
        f"{found['loops']}",
        f"{sum(found['rejected_loops'].values())}",
        *(number(site.seconds[stage], 1) for stage in _STAGES),
        number(site.cost.cpu_s, 0),
        number(site.cost.peak_mb, 0),
    ]
