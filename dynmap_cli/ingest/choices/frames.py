"""Where frames are: the tree of transforms, interpolated in time (REP 103, REP 105)."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dynmap_cli.arrays import F64, I64
from dynmap_cli.domain.mapped import give_back
from dynmap_cli.ingest.choices.transforms import (
    SAME,
    are_same,
    inverse_matrices,
    matrices,
    planar,
    slerp,
    unit,
)
from dynmap_cli.ingest.raw.columns import spans
from dynmap_cli.ingest.raw.recording import RawTransform, sorted_by_stamp

_STILL_M, _STILL_RAD = 0.02, np.radians(2.0)
_LEVEL_COS = np.cos(np.radians(10.0))
_SAMPLES = 64


@dataclass(frozen=True, slots=True)
class Edge:
    """The transform between two frames over time.

    Attributes
    ----------
    stamps_ns : (n,) int64
        Ascending; empty where the transform never changes.
    translations_m : (n or 1, 3) float64
    quaternions : (n or 1, 4) float64
        x, y, z, w; of unit length where the transform never changes, otherwise as recorded.
    """

    stamps_ns: I64
    translations_m: F64
    quaternions: F64

    @property
    def is_fixed(self) -> bool:
        """Whether it is the same at all times."""
        return self.stamps_ns.size == 0

    def at(self, at_ns: I64) -> F64:
        """parent_from_child (n, 4, 4) at each time; NaN outside the recorded span."""
        if self.is_fixed:
            return np.broadcast_to(matrices(self.translations_m, self.quaternions), (at_ns.size, 4, 4))
        stamps = self.stamps_ns
        right = np.clip(np.searchsorted(stamps, at_ns, side="left"), 1, stamps.size - 1)
        left = right - 1
        share = ((at_ns - stamps[left]) / (stamps[right] - stamps[left]))[:, None]
        moved = self.translations_m[left] + share * (self.translations_m[right] - self.translations_m[left])
        turned = slerp(unit(self.quaternions[left]), unit(self.quaternions[right]), share)
        result = matrices(moved, turned)
        result[(at_ns < stamps[0]) | (at_ns > stamps[-1])] = np.nan
        return result


def make_edge(raw: RawTransform) -> Edge:
    """Sort the transforms of one pair of frames; a transform that is repeated unchanged counts as fixed."""
    stamps_ns, values = sorted_by_stamp(raw.stamps_ns, raw.values)
    moved, turned = values[:, :3], values[:, 3:]
    first = unit(turned[:1])[0]
    is_same = all(
        (np.abs(moved[rows] - moved[0]) < SAME).all() and are_same(unit(turned[rows]), first)
        for rows in spans(values.shape[0], values)
    )
    raw.give_back()
    if raw.is_static or is_same:
        return Edge(np.zeros(0, dtype=np.int64), moved[-1:].copy(), unit(turned[-1:]))
    return Edge(stamps_ns, moved, turned)


@dataclass(frozen=True, slots=True)
class FrameTree:
    """All transforms of a recording.

    Attributes
    ----------
    edges : mapping of (parent, child) to Edge
    """

    edges: Mapping[tuple[str, str], Edge]

    def give_back(self) -> None:
        """Take transforms that are in files out of memory."""
        for edge in self.edges.values():
            give_back(edge.stamps_ns)
            give_back(edge.translations_m)

    @property
    def frames(self) -> tuple[str, ...]:
        """All frames by name."""
        return tuple(sorted({frame for pair in self.edges for frame in pair}))

    def path(self, start: str, end: str) -> tuple[str, ...] | None:
        """Fewest steps from one frame to another, either way along transforms; None where they are not joined."""
        neighbours: dict[str, list[str]] = {}
        for parent, child in sorted(self.edges):
            neighbours.setdefault(parent, []).append(child)
            neighbours.setdefault(child, []).append(parent)
        came_from = {start: start}
        queue = deque([start])
        while queue and end not in came_from:
            frame = queue.popleft()
            for near in neighbours.get(frame, []):
                if near not in came_from:
                    came_from[near] = frame
                    queue.append(near)
        if end not in came_from:
            return None
        steps = [end]
        while steps[-1] != start:
            steps.append(came_from[steps[-1]])
        return tuple(reversed(steps))

    def parents(self, frame: str) -> tuple[str, ...]:
        """Frames above *frame*, nearest first; follows the first parent by name where there are several."""
        above: list[str] = []
        while True:
            found = [parent for parent, child in sorted(self.edges) if child == frame and parent not in above]
            if not found or found[0] == frame:
                return tuple(above)
            frame = found[0]
            above.append(frame)

    def edge_between(self, a: str, b: str) -> Edge:
        """The transform that joins two neighbours."""
        return self.edges[(a, b)] if (a, b) in self.edges else self.edges[(b, a)]

    def transform(self, target: str, source: str, at_ns: I64) -> F64 | None:
        """target_from_source (n, 4, 4) at each time; None where the frames are not joined."""
        steps = self.path(target, source)
        if steps is None:
            return None
        result = np.broadcast_to(np.eye(4), (at_ns.size, 4, 4))
        for a, b in pairwise(steps):
            if (a, b) in self.edges:
                result = result @ self.edges[(a, b)].at(at_ns)
            else:
                result = result @ inverse_matrices(self.edges[(b, a)].at(at_ns))
        return np.asarray(result)


@dataclass(frozen=True, slots=True)
class Mounting:
    """How a laser sits on the robot.

    Attributes
    ----------
    robot_from_sensor : (3,) float64
        x, y, yaw.
    is_upside_down : bool
        The sensor's z axis points down, so bearings run clockwise seen from above.
    is_level : bool
        Within 10 deg.
    moves : bool
        It swings or tilts on the robot.
    is_assumed : bool
        Nothing says so.
    """

    robot_from_sensor: F64
    is_upside_down: bool
    is_level: bool
    moves: bool
    is_assumed: bool = False


def find_mounting(tree: FrameTree, base: str, sensor: str, stamps_ns: I64) -> Mounting | None:
    """How a sensor frame lies on the base frame while sweeps are taken; None where the two are not joined."""
    if not sensor:
        return None
    samples = stamps_ns[np.linspace(0, stamps_ns.size - 1, min(_SAMPLES, stamps_ns.size)).astype(np.int64)]
    poses = tree.transform(base, sensor, samples)
    if poses is None:
        return None
    known = poses[np.isfinite(poses).all(axis=(1, 2))]
    if known.shape[0] == 0:
        return None
    middle = known[known.shape[0] // 2]
    relative = inverse_matrices(middle[None]) @ known
    shift_m = np.linalg.norm(relative[:, :3, 3], axis=1)
    turn_rad = np.arccos(np.clip((np.trace(relative[:, :3, :3], axis1=1, axis2=2) - 1.0) / 2.0, -1.0, 1.0))
    return Mounting(
        planar(middle[None])[0],
        is_upside_down=bool(middle[2, 2] < 0.0),
        is_level=bool(abs(middle[2, 2]) > _LEVEL_COS),
        moves=bool(shift_m.max() > _STILL_M or turn_rad.max() > _STILL_RAD),
    )
