"""A recording of a crowd as it is and as `dynmap clean` writes it, each mapped with another program."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from dynmap_cli.files.scan_log import read_scan_log
from dynmap_cli.files.trajectory import read_tum
from tests.bench.mapped import ate_m, ingested
from tests.bench.measured import dynmap, python
from tests.bench.tables import Row, Table, number, percent
from tests.bench.worlds import Bench, truth_folder

WORLDS: dict[str, Mapping[str, Any]] = {"crowd": {"repeat": 1}, "guided_tour": {"repeat": 1}}
SKIPPED = "skipped: yag-slam is not installed"


@dataclass(frozen=True)
class Compared:
    """Errors of the other program on both recordings, and the share of the beams that was removed."""

    raw_m: float
    clean_m: float
    removed: float


def compare(bench: Bench, world: str, seed: int) -> Compared:
    """Simulate, clean, map both with yag-slam."""
    name = f"{world}-to-be-cleaned-{seed}"
    recording = bench.recorded(world, name, seed, WORLDS[world])
    truth = read_tum(truth_folder(recording) / "trajectory.tum")
    clean = recording.with_name(f"{name}-clean.mcap")
    dynmap("clean", recording, "-o", clean, "--force", log=clean.with_suffix(".txt"))
    errors = []
    runs = {raw.stem: ingested(bench, raw.stem, raw)[0] for raw in (recording, clean)}
    for stem, run_dir in runs.items():
        out = bench.folder / "peers" / f"{stem}-yag.tum"
        python("-m", "tests.bench.peer_yag", run_dir / "scans", out, log=out.with_suffix(".txt"))
        errors.append(ate_m(read_tum(out), truth))
    return Compared(*errors, _removed_share(*(run_dir / "scans" for run_dir in runs.values())))


def _removed_share(raw: Path, clean: Path) -> float:
    """Share of the beams with an end point that have none in the clean recording."""
    counts = [int(np.isfinite(read_scan_log(folder).ranges_m).sum()) for folder in (raw, clean)]
    return 1.0 - counts[1] / counts[0]


def tables(bench: Bench) -> list[Table]:
    """One table."""
    table = Table(
        "Cleaned recordings, mapped with yag-slam",
        [
            "`dynmap clean LOG -o CLEAN.mcap`, then LOG and CLEAN.mcap through yag-slam with its default settings. ATE "
            "in m after alignment. The clean recording should give the lower error; where it does not, it is **bold**.",
        ],
        ["world, seed", "beams removed", "ATE m, LOG", "ATE m, CLEAN.mcap", "LOG / CLEAN.mcap"],
    )
    if not find_spec("yag_slam"):
        table.rows.append(["crowd", SKIPPED, "", "", ""])
        return [table]
    pairs = [(world, seed) for world in WORLDS for seed in bench.seeds]
    jobs = {f"{w}, {s}": bench.jobs.start(compare, bench, w, s) for w, s in pairs}
    for name, job in jobs.items():
        table.add(name, lambda job=job: _row(job))

    def short() -> str:
        known = [job.result() for job in jobs.values()]
        better = sum(one.clean_m < one.raw_m for one in known)
        return f"lower error on {better} of {len(known)} cleaned recordings"

    table.remark("yag-slam on recordings cleaned by dynmap", short)
    return [table]


def _row(job: Future[Compared]) -> Row:
    one = job.result()
    clean = number(one.clean_m, 4)
    return [
        percent(one.removed),
        number(one.raw_m, 4),
        clean if one.clean_m < one.raw_m else f"**{clean}**",
        f"{one.raw_m / one.clean_m:.2f}",
    ]
