"""Simulated recordings and the runs made of them, each made once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from dynmap_cli.evaluation.truth import Truth, read_truth
from tests.bench.measured import WORLDS, Cost, Jobs, dynmap

LANE = Mapping[str, Any]
"""What replaces keys of `robot` in the scenario, so that the recording is short."""


@dataclass(frozen=True)
class Bench:
    """What all tables share.

    Attributes
    ----------
    folder : Path
        Where recordings and runs are made.
    data : Path
        Real recordings; may be missing.
    quick : bool
        One seed instead of several.
    jobs : Jobs
    """

    folder: Path
    data: Path
    quick: bool
    jobs: Jobs

    @property
    def seeds(self) -> tuple[int, ...]:
        """Seeds of what is measured several times."""
        return (1,) if self.quick else (1, 2, 3)

    def recorded(self, world: str, name: str, seed: int | None = None, lane: LANE | None = None) -> Path:
        """Simulate a world of configs/worlds; the building stays that of the scenario whatever the seed."""
        content = yaml.safe_load((WORLDS / f"{world}.yaml").read_text(encoding="utf-8"))
        if "generate" in content:
            content["generate"].setdefault("seed", content["seed"])
        content["robot"].update(lane or {})
        content["seed"] = content["seed"] if seed is None else seed
        return self.simulated(name, content)

    def simulated(self, name: str, content: Mapping[str, Any]) -> Path:
        """Simulate a scenario, given as what stands in its file."""
        path = self.folder / "logs" / f"{name}.mcap"

        def make() -> Path:
            path.parent.mkdir(parents=True, exist_ok=True)
            scenario = path.with_suffix(".yaml")
            scenario.write_text(yaml.safe_dump(dict(content)), encoding="utf-8")
            dynmap("simulate", scenario, "-o", path, "--force", log=path.with_suffix(".txt"))
            return path

        return self.jobs.once(("simulate", name), make)

    def built(self, name: str, recording: Path, *options: object) -> tuple[Path, Cost]:
        """Build a recording; the run directory and what it cost."""
        run_dir = self.folder / "runs" / name

        def make() -> tuple[Path, Cost]:
            cost = dynmap(
                "build", recording, "-o", run_dir, "--force", *options, log=run_dir.with_suffix(".txt")
            )
            return run_dir, cost

        return self.jobs.once(("build", name), make)

    def localized(self, name: str, *words: object) -> tuple[Path, Cost]:
        """Localize; the output directory and what it cost."""
        out_dir = self.folder / "localized" / name

        def make() -> tuple[Path, Cost]:
            return out_dir, dynmap(
                "localize", *words, "-o", out_dir, "--force", log=out_dir.with_suffix(".txt")
            )

        return self.jobs.once(("localize", name), make)


def truth_folder(recording: Path) -> Path:
    """Where `dynmap simulate` writes what was really there."""
    return recording.with_name(recording.name + ".truth")


def truth_of(recording: Path) -> Truth:
    """What was really there."""
    return read_truth(truth_folder(recording))
