"""The pose graph on disk: trajectory.g2o, the origin of each edge (edges.csv), what became of loops (loops.csv)."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from dynmap_cli.arrays import I64
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.files.g2o import write_g2o
from dynmap_cli.files.trajectory import format_stamp
from dynmap_cli.mapping.back_end import Graph
from dynmap_cli.mapping.pose_graph import residuals, squared_distances

EDGES_HEADER = "first,second,kind,shift_residual_m,turn_residual_rad,mahalanobis,weight"
LOOPS_HEADER = "first,second,first_stamp_s,second_stamp_s,verdict,reason"
_KINDS = ("chain", "loop", "dense", "placed")


def write_graph(folder: Path, log: ScanLog, graph: Graph) -> None:
    """Write the three files; scans are named by their row in trajectory.tum."""
    rows = np.argsort(log.arrival_index, kind="stable")[graph.keys].astype(np.int64)
    edges = graph.edges
    write_g2o(
        folder / "trajectory.g2o",
        rows,
        graph.poses,
        rows[edges.first],
        rows[edges.second],
        edges.measured,
        edges.information * graph.weights[:, None, None],
    )
    _write_edges(folder / "edges.csv", rows, graph)
    _write_loops(folder / "loops.csv", log.stamps_ns, rows, graph)


def rejected_by_reason(graph: Graph) -> dict[str, int]:
    """How many pairs of local maps were turned down for which reason."""
    return dict(sorted(Counter(graph.rejected.values()).items()))


def _write_edges(path: Path, rows: I64, graph: Graph) -> None:
    """One line per edge of trajectory.g2o, in its order."""
    error = residuals(graph.poses, graph.edges)
    distance = np.sqrt(squared_distances(graph.poses, graph.edges))
    with path.open("w", encoding="ascii", newline="\n") as stream:
        stream.write(EDGES_HEADER + "\n")
        for k in range(len(graph.edges)):
            stream.write(
                f"{rows[graph.edges.first[k]]},{rows[graph.edges.second[k]]},{_KINDS[graph.edges.kind[k]]},"
                f"{np.hypot(error[k, 0], error[k, 1]):.6f},{abs(error[k, 2]):.6f},{distance[k]:.4f},"
                f"{graph.weights[k]:.4f}\n"
            )


def _write_loops(path: Path, stamps_ns: I64, rows: I64, graph: Graph) -> None:
    """One line per pair of local maps: closed, rejected and why, or in contradiction at the end."""
    found = [(loop.fixed, loop.moved, "closed", "") for loop in graph.loops]
    found += [(*pair, "rejected", reason) for pair, reason in graph.rejected.items()]
    found += [(*pair, "contradiction", "points in free space") for pair in graph.contradicting]
    lines = [LOOPS_HEADER + "\n"]
    for fixed, moved, verdict, reason in sorted(found):
        first, second = rows[graph.anchors[fixed]], rows[graph.anchors[moved]]
        stamps = f"{format_stamp(int(stamps_ns[first]))},{format_stamp(int(stamps_ns[second]))}"
        lines.append(f"{first},{second},{stamps},{verdict},{reason}\n")
    path.write_text("".join(lines), encoding="ascii")
