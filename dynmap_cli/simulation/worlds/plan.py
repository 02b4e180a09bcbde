"""What a generated world consists of, and pieces that several kinds share."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from dynmap_cli.simulation.quantities import Point
from dynmap_cli.simulation.robot import Step
from dynmap_cli.simulation.scenario import Arc, Box, Door, Generate, Leg, Process, Wall
from dynmap_cli.simulation.shapes import rectangle

Lap = Callable[[np.random.Generator], list[Step]]
Placing = tuple[float, float, float]
"""x, y in metres and yaw in degrees."""


@dataclass(slots=True)
class Plan:
    """A world while it is drawn.

    Attributes
    ----------
    wanted : Generate
        What the scenario asks for.
    draw : Generator
    walls, arcs, legs, doors, boxes, routes : list
        As in `World`.
    meeting_points : list of (x, y)
        Where people may stand and talk.
    """

    wanted: Generate
    draw: np.random.Generator
    walls: list[Wall] = field(default_factory=list)
    arcs: list[Arc] = field(default_factory=list)
    legs: list[Leg] = field(default_factory=list)
    doors: list[Door] = field(default_factory=list)
    boxes: list[Box] = field(default_factory=list)
    routes: list[tuple[Point, ...]] = field(default_factory=list)
    meeting_points: list[Point] = field(default_factory=list)

    def wall(self, *points: Point, closed: bool = False, returns: float = 1.0) -> None:
        """Add a polyline of walls."""
        self.walls.append(Wall(points=points, closed=closed, returns=returns))

    def wall_with_gaps(self, start: Point, end: Point, gaps: Sequence[tuple[float, float]]) -> None:
        """Add a straight wall that leaves out the given spans, metres from its start."""
        length = math.dist(start, end)
        along = ((end[0] - start[0]) / length, (end[1] - start[1]) / length)
        at = 0.0
        for begin, finish in [*sorted(gaps), (length, length)]:
            if begin - at > 1e-6:
                first = (start[0] + along[0] * at, start[1] + along[1] * at)
                last = (start[0] + along[0] * begin, start[1] + along[1] * begin)
                self.wall(first, last)
            at = finish

    def block(self, placing: Placing, size_m: tuple[float, float]) -> None:
        """Add a solid thing that never moves: cupboard, pier, rack."""
        corners = rectangle((placing[0], placing[1], math.radians(placing[2])), size_m)
        self.wall(*corners, closed=True)

    def table(self, placing: Placing, size_m: tuple[float, float]) -> None:
        """Add a table that never moves: four thin legs."""
        corners = rectangle((placing[0], placing[1], math.radians(placing[2])), size_m)
        self.legs += [Leg(at=corner, radius_m=0.025) for corner in corners]

    def door(self, hinge: Point, latch: Point, open_deg: float, kinds: Sequence[str]) -> None:
        """Add a door of one of some kinds: hinged, ajar (hinged with a third state) or sliding."""
        kind = kinds[int(self.draw.integers(len(kinds)))]
        if kind == "sliding":
            states = {"closed": 0.0, "open": 95.0}
        elif kind == "ajar":
            states = {"closed": 0.0, "ajar": 0.45 * open_deg, "open": open_deg}
        else:
            states = {"closed": 0.0, "open": open_deg}
        self.doors.append(
            Door(
                name=f"door_{len(self.doors) + 1}",
                kind="sliding" if kind == "sliding" else "hinged",
                hinge=hinge,
                latch=latch,
                states=states,
                process=self.changes(),
            )
        )

    def box(
        self,
        places: Sequence[Placing],
        size_m: tuple[float, float],
        *,
        absent: bool = True,
        legs: bool = False,
    ) -> None:
        """Add a thing that stands at one of some places, or is gone."""
        self.boxes.append(
            Box(
                name=f"box_{len(self.boxes) + 1}",
                size_m=size_m,
                places={chr(ord("a") + number): place for number, place in enumerate(places)},
                absent=absent,
                shape="legs" if legs else "solid",
                process=self.changes(),
            )
        )

    def changes(self) -> Process:
        """How things of this world change."""
        return self.wanted.changes

    def number(self, low: float, high: float) -> float:
        """Draw a number, rounded to the centimetre."""
        return round(float(self.draw.uniform(low, high)), 2)


def pieces_of(length_m: float, shortest_m: float, longest_m: float, draw: np.random.Generator) -> list[float]:
    """Cut a length into pieces between two bounds; returns the cuts, ends included."""
    count = max(math.ceil(length_m / longest_m), min(math.floor(length_m / shortest_m), 1), 1)
    if math.floor(length_m / shortest_m) > count:
        count = int(draw.integers(count, math.floor(length_m / shortest_m)))
    spare = length_m - count * shortest_m
    shares = draw.dirichlet(np.full(count, 4.0)) if spare > 0.0 else np.full(count, 1.0 / count)
    cuts = np.concatenate([[0.0], np.cumsum(shortest_m + shares * spare)])
    return [round(float(cut), 2) for cut in cuts]
