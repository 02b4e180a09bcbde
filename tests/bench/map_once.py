"""The mapping room once, on ingested scans: with other parameters or perturbed scans, and what each part cost.

A process of its own, so that CPU seconds and peak memory are those of one run:
`python -m tests.bench.map_once SCANS_DIR OUT_DIR` reads OUT_DIR/task.json, writes trajectory.tum and found.json.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from unittest.mock import patch

from dynmap_cli.arrays import F64
from dynmap_cli.domain.poses import Trajectory
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.files.scan_log import read_scan_log
from dynmap_cli.files.trajectory import write_tum
from dynmap_cli.mapping import registrar, rounds, site
from dynmap_cli.mapping.loops import LoopParams
from dynmap_cli.mapping.settings import MapSettings
from dynmap_cli.mapping.warnings import warn_of_odometry
from dynmap_cli.scan_matching.matcher import FrontEndParams
from tests.bench.perturbations import PERTURBATIONS, redrawn

PARTS = (
    (registrar, "register", "front end"),
    (registrar, "close_loops", "loops, graph"),
    (site, "close_loops", "loops, graph"),
    (site, "refine_graph", "fitting poses"),
    (rounds, "filter_beams", "counting, EM"),
    (rounds, "filter_by_looks", "looks"),
)
"""Which module calls which function, and what that is called in the tables."""
CALIBRATION, REST = "calibration", "rest"


class Clock:
    """CPU seconds of parts; what a part calls belongs to it, what the rest calls to the part that is called."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._open: list[str] = []
        self._since = time.process_time()

    def timed(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The same function; what it uses is added to *part*."""

        def wrapper(*args: Any, **options: Any) -> Any:
            self._charge()
            self._open.append(part if self._open in ([], [REST]) else self._open[-1])
            try:
                return function(*args, **options)
            finally:
                self._charge()
                self._open.pop()

        return wrapper

    def _charge(self) -> None:
        now = time.process_time()
        part = self._open[-1] if self._open else REST
        self.seconds[part] = self.seconds.get(part, 0.0) + now - self._since
        self._since = now


def main(scans_dir: Path, out_dir: Path) -> None:
    """Read, perturb, map, write."""
    task = json.loads((out_dir / "task.json").read_text())
    clock = Clock()
    log = PERTURBATIONS[task["perturbation"]](read_scan_log(scans_dir))
    log = redrawn(log, task["draw"]) if task["draw"] else log
    front, loops = FrontEndParams(**task["front"]), LoopParams(**task["loops"])
    with ExitStack() as stack:
        for caller, name, part in PARTS:
            stack.enter_context(patch.object(caller, name, clock.timed(part, getattr(caller, name))))
        calibrate = clock.timed(CALIBRATION, registrar.Registrar._calibrate)
        stack.enter_context(patch.object(registrar.Registrar, "_calibrate", calibrate))
        stack.enter_context(patch.object(registrar, "FrontEndParams", lambda: front))
        for caller in (registrar, site):
            stack.enter_context(patch.object(caller, "LoopParams", lambda: loops))
        found = (_map if task["filtered"] else _register)(log, MapSettings(**task["map"]), clock, out_dir)
    (out_dir / "found.json").write_text(json.dumps({"scans": log.n_scans, "seconds": clock.seconds, **found}))


def _map(log: ScanLog, settings: MapSettings, clock: Clock, out_dir: Path) -> dict[str, Any]:
    """Rounds of registration and filtering, as in `dynmap map`."""
    result = clock.timed(REST, rounds.build_filter_map)(log, settings, threads=1)
    write_tum(out_dir / "trajectory.tum", result.trajectory)
    shares = [one.dynamic_share for one in result.rounds]
    return {"dynamic_share": shares, **_registration(result)}


def _register(log: ScanLog, settings: MapSettings, clock: Clock, out_dir: Path) -> dict[str, Any]:
    """Registration alone; no beam is filtered."""

    def poses() -> tuple[site.Site, F64]:
        whole = site.Site(log, settings.model_copy(update={"max_rounds": 1}))
        return whole, whole.poses(None, "once")

    whole, found = clock.timed(REST, poses)()
    write_tum(out_dir / "trajectory.tum", Trajectory(log.stamps_ns, found))
    return _registration(whole)


def _registration(result: rounds.FilterMap | site.Site) -> dict[str, Any]:
    """What registration says of itself."""
    graph, (drive,) = result.graph, result.drives
    return {
        "keys": graph.keys.size if graph else 0,
        "loops": len(graph.loops) if graph else 0,
        "contradictions": graph.contradictions if graph else 0.0,
        "lost_scans": int(drive.front.is_lost.sum()) if drive.front else 0,
        "findings": [drive.calibration.sentence(), *warn_of_odometry(drive.calibration)],
        "wheel_faults": len(drive.wheel_faults),
    }


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
