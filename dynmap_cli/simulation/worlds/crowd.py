"""A hall full of people: curved walls, pillars, counters."""

from __future__ import annotations

import numpy as np

from dynmap_cli.simulation.quantities import Point
from dynmap_cli.simulation.robot import Step
from dynmap_cli.simulation.scenario import Arc, Leg
from dynmap_cli.simulation.worlds.plan import Lap, Plan

SIZE_M = (26.0, 16.0)
LEAST_M = (22.0, 12.0)
_CROSSING_M = 4.0


def crowd(plan: Plan, size_m: tuple[float, float]) -> Lap:
    """Draw a hall with a round end; a visit goes around it and across."""
    length, width = size_m
    radius = width / 2.0
    plan.wall((radius, 0.0), (length, 0.0), (length, width * 0.7), (length - 2.0, width), (radius, width))
    plan.arcs.append(Arc(center=(radius, radius), radius_m=radius, from_deg=90.0, to_deg=270.0))
    columns = np.arange(_CROSSING_M, length - 1.0, _CROSSING_M).tolist()
    rows = np.arange(3.0, width - 2.0, (width - 6.0) / 3.0).tolist()
    for x in columns[1:]:
        plan.legs += [Leg(at=(x - 2.0, y), radius_m=0.25) for y in (width * 0.32, width * 0.68)]
    plan.block((length - 5.0, width * 0.5 + 0.2, 12.0), (2.4, 1.0))
    plan.block((length * 0.45, width - 0.4, 0.0), (3.0, 0.8))
    for number in range(plan.wanted.boxes):
        x, y = plan.number(radius, length - 3.0), 0.5 if number % 2 else width - 0.5
        plan.box([(x, y, 0.0), (x + 1.6, y, 0.0)], (0.9, 0.5))
    grid: list[list[Point]] = [[(x, y) for x in columns] for y in rows]
    plan.routes += [tuple(row) for row in grid]
    plan.routes += [tuple(row[number] for row in grid) for number in range(len(columns))]
    plan.meeting_points += [
        (row[number][0] + 1.0, row[number][1] + 1.0) for row in grid[:-1] for number in (1, 3)
    ]

    def lap(draw: np.random.Generator) -> list[Step]:
        low, high = rows[0] + 0.6, rows[-1] - 0.6
        around = [
            (columns[0], low),
            (columns[-1], low),
            (columns[-1], high),
            (columns[0], high),
            (columns[0], low),
        ]
        if draw.random() < 0.5:
            around.reverse()
        return [Step(to=point) for point in around]

    return lap
