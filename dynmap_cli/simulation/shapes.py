"""A world as line segments and circles, each with the object and state it belongs to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from dynmap_cli.arrays import F64, I32
from dynmap_cli.simulation.quantities import Point
from dynmap_cli.simulation.scenario import Arc, Door, Wall, World

LEAF_THICKNESS_M = 0.04
_LEG_RADIUS_M = 0.02
_ARC_PIECE_M = 0.1


@dataclass(frozen=True, slots=True)
class Shapes:
    """What does not move while it is in a state.

    Attributes
    ----------
    segments : (n_segments, 4) float64
        x, y of both ends, metres.
    segment_gates : (n_segments, 2) int32
        Object and state in which a segment is there; object -1 = always.
    segment_returns : (n_segments,) float64
        Share of beams that are reflected.
    circles : (n_circles, 3) float64
        x, y, radius.
    circle_gates : (n_circles, 2) int32
    """

    segments: F64
    segment_gates: I32
    segment_returns: F64
    circles: F64
    circle_gates: I32


@dataclass(slots=True)
class _Collector:
    """Gathers rows before they become arrays."""

    segments: list[tuple[float, ...]] = field(default_factory=list)
    segment_gates: list[tuple[int, int]] = field(default_factory=list)
    returns: list[float] = field(default_factory=list)
    circles: list[tuple[float, ...]] = field(default_factory=list)
    circle_gates: list[tuple[int, int]] = field(default_factory=list)

    def polyline(self, points: Sequence[Point], gate: tuple[int, int], returns: float = 1.0) -> None:
        """Add the segments between successive points."""
        for start, end in pairwise(points):
            self.segments.append((*start, *end))
            self.segment_gates.append(gate)
            self.returns.append(returns)

    def circle(self, at: Point, radius_m: float, gate: tuple[int, int]) -> None:
        """Add a circle."""
        self.circles.append((*at, radius_m))
        self.circle_gates.append(gate)


def shapes_of(world: World) -> Shapes:
    """Turn a world into shapes; object k is the k-th of its doors and boxes, in this order."""
    rows = _Collector()
    always = (-1, 0)
    for wall in world.walls:
        rows.polyline(_closed(wall), always, wall.returns)
    for arc in world.arcs:
        rows.polyline(_arc_points(arc), always, arc.returns)
    for leg in world.legs:
        rows.circle(leg.at, leg.radius_m, always)
    for number, door in enumerate(world.doors):
        for state, position in enumerate(door.states.values()):
            rows.polyline(_leaf(door, position), (number, state))
    for number, box in enumerate(world.boxes, start=len(world.doors)):
        for state, place in enumerate(box.places.values()):
            corners = rectangle((place[0], place[1], math.radians(place[2])), box.size_m)
            if box.shape == "solid":
                rows.polyline([*corners, corners[0]], (number, state))
            else:
                for corner in corners:
                    rows.circle(corner, _LEG_RADIUS_M, (number, state))
    return Shapes(
        np.array(rows.segments, dtype=np.float64).reshape(-1, 4),
        np.array(rows.segment_gates, dtype=np.int32).reshape(-1, 2),
        np.array(rows.returns, dtype=np.float64),
        np.array(rows.circles, dtype=np.float64).reshape(-1, 3),
        np.array(rows.circle_gates, dtype=np.int32).reshape(-1, 2),
    )


def rectangle(pose: tuple[float, float, float], size_m: tuple[float, float]) -> list[Point]:
    """Four corners of a rectangle, counter-clockwise; pose is its centre, yaw in radians."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    half, side = size_m[0] / 2.0, size_m[1] / 2.0
    return [
        (pose[0] + cos * u - sin * v, pose[1] + sin * u + cos * v)
        for u, v in ((half, side), (-half, side), (-half, -side), (half, -side))
    ]


def object_centers(world: World) -> F64:
    """(n_objects, 2) rough place of each object: middle of a doorway, mean of the places of a box."""
    centers = [
        ((door.hinge[0] + door.latch[0]) / 2, (door.hinge[1] + door.latch[1]) / 2) for door in world.doors
    ]
    for box in world.boxes:
        places = list(box.places.values())
        centers.append(
            (sum(place[0] for place in places) / len(places), sum(place[1] for place in places) / len(places))
        )
    return np.array(centers, dtype=np.float64).reshape(-1, 2)


def _closed(wall: Wall) -> tuple[Point, ...]:
    """Corners of a wall, the first repeated where it is closed."""
    return (*wall.points, wall.points[0]) if wall.closed else wall.points


def _arc_points(arc: Arc) -> list[Point]:
    """Points on an arc, at most 10 cm apart."""
    span = math.radians(arc.to_deg - arc.from_deg)
    pieces = max(math.ceil(abs(span) * arc.radius_m / _ARC_PIECE_M), 2)
    angles = [math.radians(arc.from_deg) + span * number / pieces for number in range(pieces + 1)]
    return [
        (arc.center[0] + arc.radius_m * math.cos(a), arc.center[1] + arc.radius_m * math.sin(a))
        for a in angles
    ]


def _leaf(door: Door, position: float) -> list[Point]:
    """Outline of a door leaf in a state."""
    across = (door.latch[0] - door.hinge[0], door.latch[1] - door.hinge[1])
    width, heading = math.hypot(*across), math.atan2(across[1], across[0])
    if door.kind == "hinged":
        heading += math.radians(position)
    else:
        width *= max(1.0 - position / 100.0, 0.0)
    center = (
        door.hinge[0] + 0.5 * width * math.cos(heading),
        door.hinge[1] + 0.5 * width * math.sin(heading),
        heading,
    )
    corners = rectangle(center, (width, LEAF_THICKNESS_M))
    return [*corners, corners[0]]
