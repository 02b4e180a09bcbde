"""The door of this room: a scenario file in, a recording and its truth out."""

from __future__ import annotations

import logging
import shutil
from pathlib import Path
from typing import Any

from dynmap_cli.compiling import announce_compilation
from dynmap_cli.errors import ArtifactError, ConfigError
from dynmap_cli.files.atomic import scratch_folder
from dynmap_cli.progress import progress
from dynmap_cli.simulation.recording import check_suffix, write_recording
from dynmap_cli.simulation.run import count_scans, simulate
from dynmap_cli.simulation.scenario import load_scenario
from dynmap_cli.simulation.size import check_size
from dynmap_cli.simulation.truth import summarize, write_truth

_log = logging.getLogger(__name__)


def truth_folder(recording: Path) -> Path:
    """Where the truth of a recording is kept."""
    return recording.with_name(recording.name + ".truth")


def simulate_to_files(
    scenario_path: Path, recording: Path, *, seed: int | None = None, force: bool = False
) -> dict[str, Any]:
    """Write the recording of a scenario, and `<recording>.truth/` beside it.

    Raises
    ------
    ConfigError
        If the scenario or the suffix of the recording is not allowed, or no scan would come of it.
    ArtifactError
        If the recording or its truth is there already and *force* is not given.
    """
    check_suffix(recording)
    scenario = load_scenario(scenario_path, seed)
    truth = truth_folder(recording)
    for path in (recording, truth):
        if path.exists() and not force:
            msg = f"{path}: exists already. Pass --force to replace it, or choose another output."
            raise ArtifactError(msg)
    try:
        check_size(scenario)
    except ConfigError as err:
        msg = f"{scenario_path}: {err}"
        raise ConfigError(msg) from err
    scans = count_scans(scenario)
    if scans == 0:
        msg = f"{scenario_path}: the robot's path is over before the first scan is. Give it further places, or wait_s."
        raise ConfigError(msg)
    announce_compilation()
    with progress("simulate", scans, "scans") as tick:
        run = simulate(scenario, tick)
    _log.info("simulate: writing %s", recording)
    write_recording(recording, run)
    with scratch_folder(truth) as part:
        write_truth(part, run)
        if truth.exists():
            shutil.rmtree(truth)
        part.rename(truth)
    summary = summarize(run)
    summary["lines"] += [f"recording  {recording}", f"truth      {truth}/"]
    return {**summary, "recording": str(recording), "truth": str(truth), "seed": scenario.seed}
