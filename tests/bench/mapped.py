"""Ingested scans through the mapping room, each variant once."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dynmap_cli.domain.poses import Trajectory
from dynmap_cli.evaluation.relations import read_relations, score_relations
from dynmap_cli.evaluation.trajectories import score_trajectory
from dynmap_cli.files.trajectory import read_tum
from tests.bench.measured import Cost, dynmap, python, stage_seconds
from tests.bench.worlds import Bench


@dataclass(frozen=True)
class Variant:
    """One way to run the mapping room.

    Attributes
    ----------
    name : str
        Different for different variants of the same scans.
    perturbation : str
        One of `PERTURBATIONS`.
    draw : int
        Seed of a trace of noise on the ranges, see `redrawn`; 0 = as they are.
    map, front, loops : mapping
        What differs from the defaults in `MapSettings`, `FrontEndParams` and `LoopParams`.
    filtered : bool
        Rounds of registration and filtering, as in `dynmap map`; otherwise one registration of all beams.
    """

    name: str
    perturbation: str = "as recorded"
    draw: int = 0
    map: Mapping[str, Any] = field(default_factory=dict)
    front: Mapping[str, float] = field(default_factory=dict)
    loops: Mapping[str, float] = field(default_factory=dict)
    filtered: bool = True

    def task(self) -> dict[str, Any]:
        """What `map_once` reads."""
        return {
            "perturbation": self.perturbation,
            "draw": self.draw,
            "map": dict(self.map),
            "front": dict(self.front),
            "loops": dict(self.loops),
            "filtered": self.filtered,
        }


@dataclass(frozen=True)
class Mapped:
    """What came out.

    Attributes
    ----------
    trajectory : Trajectory
    found : dict
        Counts, findings and CPU seconds of the parts, as `map_once` wrote them.
    cost : Cost
        Of the whole process, start and reading included.
    """

    trajectory: Trajectory
    found: dict[str, Any]
    cost: Cost


def ingested(bench: Bench, name: str, recording: Path) -> tuple[Path, float]:
    """The run directory of an ingested recording, and the CPU seconds of the stage."""
    run_dir = bench.folder / "ingested" / name

    def make() -> tuple[Path, float]:
        dynmap("ingest", recording, "-o", run_dir, "--force", log=run_dir.with_suffix(".txt"))
        return run_dir, stage_seconds(run_dir)["ingest"]

    return bench.jobs.once(("ingest", name), make)


def mapped(bench: Bench, name: str, recording: Path, variant: Variant) -> Mapped:
    """Map an ingested recording."""
    run_dir, _ = ingested(bench, name, recording)
    slug = "".join(letter if letter.isalnum() else "-" for letter in variant.name)
    out_dir = bench.folder / "mapped" / name / slug

    def make() -> Mapped:
        out_dir.mkdir(parents=True, exist_ok=True)
        (out_dir / "task.json").write_text(json.dumps(variant.task()))
        cost = python("-m", "tests.bench.map_once", run_dir / "scans", out_dir, log=out_dir / "printed.txt")
        found = json.loads((out_dir / "found.json").read_text())
        return Mapped(read_tum(out_dir / "trajectory.tum"), found, cost)

    return bench.jobs.once(("map", name, variant.name), make)


def relations_m(trajectory: Trajectory, relations: Path) -> float:
    """Mean translation error of relative poses that were checked by hand."""
    return score_relations("", trajectory, read_relations(relations)).values["translation_mean_m"]


def ate_m(trajectory: Trajectory, reference: Trajectory) -> float:
    """Root mean square distance after alignment; NaN where poses are missing."""
    score = score_trajectory("", trajectory, reference)
    return score.values["ate_rmse_m"] if score.is_complete else float("nan")
