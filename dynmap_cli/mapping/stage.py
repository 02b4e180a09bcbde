"""The door of the room."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from dynmap_cli.counting.em import occupancy
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.errors import LogError
from dynmap_cli.files.counting_map import write_beams, write_counting_map
from dynmap_cli.files.g2o import write_g2o
from dynmap_cli.files.pgm import write_map
from dynmap_cli.files.scan_log import read_scan_log
from dynmap_cli.files.trajectory import write_tum
from dynmap_cli.mapping.back_end import Graph
from dynmap_cli.mapping.rounds import FilterMap, Round, build_filter_map
from dynmap_cli.stage import Stage, StageContext

_WRONG_MAP = 0.06


def run(context: StageContext) -> dict[str, Any]:
    """Read the scans, find path, map and moving beams, write map/."""
    log = read_scan_log(context.scans_dir)
    settings = context.config.map
    if log.n_scans < 2:
        msg = f"{context.scans_dir}: {log.n_scans} scans, a map needs at least 2. Use a longer recording."
        raise LogError(msg)
    if settings.poses == "recorded" and not log.has_odometry.all():
        missing = int((~log.has_odometry).sum())
        msg = f"{context.scans_dir}: {missing} scans without recorded pose. Use map.poses: estimate."
        raise LogError(msg)
    result = build_filter_map(log, settings, threads=context.threads)
    out = context.out_dir
    write_tum(out / "trajectory.tum", result.trajectory)
    write_beams(out / "beams.npz", log.stamps_ns, result.filtered.static_probability)
    write_counting_map(out / "reflectance.npz", result.filtered.counting_map)
    write_map(out, "map", occupancy(result.filtered.counting_map))
    _write_rounds(out / "em.csv", result.rounds)
    write_map(out, "unfiltered", result.unfiltered)
    for number in sorted({1, min(2, len(result.rounds)), len(result.rounds)}):
        write_map(out, f"round_{number}", result.rounds[number - 1].occupancy)
    if result.graph is not None:
        _write_graph(out / "trajectory.g2o", result.graph)
    return _summary(log, result)


def _write_rounds(path: Path, rounds: tuple[Round, ...]) -> None:
    """One line per round: what it reached and what it changed."""
    lines = ["round,log_likelihood,dynamic_share,changed_labels,pose_shift_m\n"]
    for number, one in enumerate(rounds, start=1):
        shift = "" if np.isnan(one.pose_shift_m) else f"{one.pose_shift_m:.6f}"
        lines.append(
            f"{number},{one.log_likelihood:.6f},{one.dynamic_share:.6f},{one.changed_labels:.6f},{shift}\n"
        )
    path.write_text("".join(lines), encoding="ascii")


def _write_graph(path: Path, graph: Graph) -> None:
    """Write the graph with scan numbers as names of the nodes."""
    edges = graph.edges
    write_g2o(
        path,
        graph.keys,
        graph.poses,
        graph.keys[edges.first],
        graph.keys[edges.second],
        edges.measured,
        edges.information * graph.weights[:, None, None],
    )


def _path_length_m(log: ScanLog, result: FilterMap) -> float:
    """Distance travelled, along the order in which the sweeps were made."""
    in_order = result.trajectory.poses[np.argsort(log.arrival_index, kind="stable"), :2]
    return float(np.linalg.norm(np.diff(in_order, axis=0), axis=1).sum())


def _summary(log: ScanLog, result: FilterMap) -> dict[str, Any]:
    """What was found, as numbers and as sentences."""
    filtered = result.filtered
    frame = filtered.counting_map.frame
    ended = int(np.isfinite(filtered.static_probability).sum())
    summary: dict[str, Any] = {
        "scans": log.n_scans,
        "path_m": round(_path_length_m(log, result), 2),
        "rounds": len(result.rounds),
        "dynamic_share": round(filtered.dynamic_share, 5),
        "log_likelihood": round(filtered.log_likelihood, 3),
        "size_m": [round(frame.cols * frame.resolution_m, 2), round(frame.rows * frame.resolution_m, 2)],
        "lost_scans": result.lost_scans,
        "calibration": {
            key: round(value, 6) if isinstance(value, float) else value
            for key, value in asdict(result.calibration).items()
        },
    }
    lines = [
        f"{log.n_scans} scans along {summary['path_m']:.1f} m, map of "
        f"{summary['size_m'][0]:.1f} m x {summary['size_m'][1]:.1f} m",
        f"{100 * filtered.dynamic_share:.2f} % of {ended} beams hit something that moves",
        *result.calibration.findings(),
    ]
    if result.graph is not None:
        summary["loops"] = len(result.graph.loops)
        summary["rejected_loops"] = result.graph.rejected
        summary["contradictions"] = round(result.graph.contradictions, 4)
        lines.append(f"{len(result.graph.loops)} loops closed")
        if result.graph.contradictions > _WRONG_MAP:
            lines.append(
                f"warning: {100 * result.graph.contradictions:.0f} % of the places seen twice contradict each other "
                "in free space; the map is probably wrong somewhere"
            )
    if result.lost_scans:
        lines.append(f"warning: {result.lost_scans} scans fitted nowhere; their poses come from the odometry")
    return {**summary, "lines": lines}


STAGE = Stage(
    name="map",
    title="finding path, map and moving beams",
    section="map",
    folder="map",
    reads=("scans/",),
    writes=(
        "map/map.pgm",
        "map/map.yaml",
        "map/reflectance.npz",
        "map/trajectory.tum",
        "map/trajectory.g2o",
        "map/beams.npz",
        "map/em.csv",
        "map/unfiltered.pgm",
        "map/unfiltered.yaml",
        "map/round_1.pgm",
        "map/round_1.yaml",
    ),
    run=run,
)
