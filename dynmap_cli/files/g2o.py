"""trajectory.g2o: nodes and edges of the pose graph, as other solvers read them (VERTEX_SE2, EDGE_SE2)."""

from __future__ import annotations

from pathlib import Path

from dynmap_cli.arrays import F64, I64


def write_g2o(
    path: Path, nodes: I64, poses: F64, first: I64, second: I64, measured: F64, information: F64
) -> None:
    """Write a graph.

    Parameters
    ----------
    path : Path
    nodes : (n,) int64
        Number of each node.
    poses : (n, 3) float64
    first, second : (m,) int64
        Numbers of the nodes that an edge connects.
    measured : (m, 3) float64
        first_from_second.
    information : (m, 3, 3) float64
    """
    with path.open("w", encoding="ascii", newline="\n") as stream:
        for node, (x, y, yaw) in zip(nodes, poses, strict=True):
            stream.write(f"VERTEX_SE2 {node} {x:.6f} {y:.6f} {yaw:.9f}\n")
        if nodes.size:
            stream.write(f"FIX {int(nodes[0])}\n")
        for a, b, (x, y, yaw), matrix in zip(first, second, measured, information, strict=True):
            upper = (matrix[0, 0], matrix[0, 1], matrix[0, 2], matrix[1, 1], matrix[1, 2], matrix[2, 2])
            numbers = " ".join(f"{value:.6g}" for value in upper)
            stream.write(f"EDGE_SE2 {a} {b} {x:.6f} {y:.6f} {yaw:.9f} {numbers}\n")
