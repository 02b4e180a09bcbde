"""The door of the room: scans -> path, filtered map, and the probability that each beam hit something static."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dynmap_cli.files.counting_map import write_beams, write_counting_map
from dynmap_cli.files.pgm import write_map
from dynmap_cli.files.registered import write_mountings, write_registered
from dynmap_cli.files.scan_log import read_scan_log
from dynmap_cli.stage import Stage, StageContext

if TYPE_CHECKING:
    from dynmap_cli.mapping.rounds import Round

_BYTES_PER_BEAM, _BYTES_PER_SCAN = 10, 1000
"""Two tables of e and one of what is unknown, or one of each and beams.npz; the trajectory, and local maps: 80 kB for
ten key scans, of which a robot on its way makes one of ten scans."""


def needs(context: StageContext) -> tuple[str, int]:
    """Room for what is kept of each beam, and for beams.npz."""
    log = read_scan_log(context.scans_dir)
    return f"{log.n_scans} scans", log.n_scans * (_BYTES_PER_BEAM * log.n_beams + _BYTES_PER_SCAN)


def run(context: StageContext) -> dict[str, Any]:
    """Read the scans, find path, map and moving beams, write map/."""
    from dynmap_cli.counting.em import occupancy
    from dynmap_cli.mapping.demands import check_scans
    from dynmap_cli.mapping.graph_files import write_graph
    from dynmap_cli.mapping.rounds import build_filter_map
    from dynmap_cli.mapping.summary import summarize

    log = read_scan_log(context.scans_dir)
    settings = context.config.map
    check_scans(log, settings, str(context.scans_dir))
    out = context.out_dir
    result = build_filter_map(log, settings, threads=context.threads, folder=out)
    write_registered(out, result.trajectory, result.beam_interval_s)
    if not np.array_equal(result.sensor_poses, log.sensor_poses):
        write_mountings(out, result.sensor_poses)
    write_beams(
        out / "beams.npz", log.stamps_ns, result.filtered.static_probability, result.filtered.is_unknown
    )
    write_counting_map(out / "reflectance.npz", result.filtered.counting_map)
    write_map(out, "map", occupancy(result.filtered.counting_map))
    _write_rounds(out / "em.csv", result.rounds)
    write_map(out, "unfiltered", result.unfiltered)
    for number in sorted({1, min(2, len(result.rounds)), len(result.rounds)}):
        write_map(out, f"round_{number}", result.rounds[number - 1].occupancy)
    if result.graph is not None:
        write_graph(out, log, result.graph)
    return summarize(log, result, settings.usable_range_m)


def _write_rounds(path: Path, rounds: tuple[Round, ...]) -> None:
    """One line per round: what it reached and what it changed."""
    lines = ["round,log_likelihood,dynamic_share,changed_labels,pose_shift_m\n"]
    for number, one in enumerate(rounds, start=1):
        shift = "" if np.isnan(one.pose_shift_m) else f"{one.pose_shift_m:.6f}"
        lines.append(
            f"{number},{one.log_likelihood:.6f},{one.dynamic_share:.6f},{one.changed_labels:.6f},{shift}\n"
        )
    path.write_text("".join(lines), encoding="ascii")


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
        "map/beam_interval_s.npy",
        "map/trajectory.g2o",
        "map/edges.csv",
        "map/loops.csv",
        "map/beams.npz",
        "map/em.csv",
        "map/unfiltered.pgm",
        "map/unfiltered.yaml",
        "map/round_1.pgm",
        "map/round_1.yaml",
    ),
    run=run,
    needs=needs,
)
