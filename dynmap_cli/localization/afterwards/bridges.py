"""Where the filter jumped away and came back: the motion in between tells whether the robot was ever elsewhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import B1, F64
from dynmap_cli.domain.poses import between, compose, wrap_angle

MOST_SKIPPED = 12
"""Stretches between two jumps that one bridge may leave out."""
LONGEST_M = 20.0
"""Odometry is not trusted over a longer way."""
SLACK_M, SLACK_RAD = 0.5, 0.35
SLACK_PER_M, SLACK_RAD_PER_M = 0.05, 0.05
"""How far odometry may be off at the other end of a bridge: at once, and per metre of the way."""

Cost = Callable[[int, F64], float]
"""(node, pose) -> negative log-likelihood of its scan; ends in places that the map does not know must be neutral."""


@dataclass(frozen=True, slots=True)
class Way:
    """What odometry says between the nodes of a drive.

    Attributes
    ----------
    odometry : (n, 3) float64
    measured : (n - 1,) bool
        Whether both ends of a step have it.
    """

    odometry: F64
    measured: B1


def bridged(poses: F64, jumps: list[int], way: Way, cost: Cost, jump_cost: float) -> F64:
    """Poses (n, 3) with the cheapest choice of stretches; those left out are replaced by the motion in between.

    A jump costs as much as being carried anywhere; a bridge costs nothing itself, but must fit the odometry. The
    robot is taken to be where the filter has it in the first and in the last stretch.

    Parameters
    ----------
    poses : (n, 3) float64
        Of the filter.
    jumps : list of int
        Nodes after which the filter went elsewhere, ascending.
    way : Way
    cost : callable
    jump_cost : float
    """
    if len(jumps) < 2:
        return poses
    starts, ends = [0, *(jump + 1 for jump in jumps)], [*jumps, poses.shape[0] - 1]
    own = [
        0.0,
        *(_total(poses, range(a, b + 1), cost) for a, b in zip(starts[1:-1], ends[1:-1], strict=True)),
        0.0,
    ]
    best, before = [own[0]], [-1]
    bridges: dict[tuple[int, int], F64] = {}
    for j in range(1, len(starts)):
        choices = [(best[j - 1] + jump_cost, j - 1)]
        for i in range(j - 2, max(j - 2 - MOST_SKIPPED, -1), -1):
            bridge = _bridge(poses, ends[i], starts[j], way)
            if bridge is not None:
                bridges[i, j] = bridge
                nodes = range(ends[i] + 1, starts[j])
                choices.append((best[i] + sum(cost(n, bridge[n - ends[i] - 1]) for n in nodes), i))
        cheapest, origin = min(choices)
        best.append(cheapest + own[j])
        before.append(origin)
    result = poses.copy()
    j = len(starts) - 1
    while j > 0:
        i = before[j]
        if i < j - 1:
            result[ends[i] + 1 : starts[j]] = bridges[i, j]
        j = i
    return result


def _total(poses: F64, nodes: range, cost: Cost) -> float:
    return sum(cost(node, poses[node]) for node in nodes)


def _bridge(poses: F64, start: int, end: int, way: Way) -> F64 | None:
    """Poses of the nodes between two nodes by odometry, bent to end where the filter ends; None where it cannot."""
    if not bool(way.measured[start:end].all()):
        return None
    steps = between(way.odometry[start:end], way.odometry[start + 1 : end + 1])
    path = np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))
    if float(path[-1]) > LONGEST_M:
        return None
    missed = between(compose(poses[start], between(way.odometry[start], way.odometry[end])), poses[end])
    if abs(float(missed[2])) > SLACK_RAD + SLACK_RAD_PER_M * path[-1]:
        return None
    turns = float(missed[2]) / steps.shape[0]
    pose, reached = poses[start], []
    for step in steps:
        pose = compose(pose, step + np.array([0.0, 0.0, turns]))
        reached.append(pose)
    bent = np.array(reached)
    missed_m = poses[end, :2] - bent[-1, :2]
    if float(np.hypot(*missed_m)) > SLACK_M + SLACK_PER_M * path[-1]:
        return None
    share = path / max(float(path[-1]), 1e-9)
    bent[:, :2] += share[:, None] * missed_m
    bent[:, 2] = wrap_angle(bent[:, 2])
    return np.asarray(bent[:-1])
