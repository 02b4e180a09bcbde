"""A home: small rooms on both sides of a hall, chairs that are moved, a glass front."""

from __future__ import annotations

import numpy as np

from dynmap_cli.simulation.robot import Step
from dynmap_cli.simulation.worlds.plan import Lap, Plan
from dynmap_cli.simulation.worlds.rooms import Row, add_row

SIZE_M = (12.0, 9.0)
LEAST_M = (9.0, 7.0)
_HALL_M = 1.6
_GLASS_RETURNS = 0.3


def home(plan: Plan, size_m: tuple[float, float]) -> Lap:
    """Draw a home; a visit goes through the hall and into all rooms without doors, in any order."""
    length, width = size_m
    depth = (width - _HALL_M) / 2.0
    aisle = width / 2.0
    south = Row(0.0, length, depth, -depth, aisle)
    north = Row(0.0, length, width - depth, depth, aisle)
    doorways = add_row(plan, south, (3.0, 5.0), ("hinged", "ajar"), back_wall=False)
    doorways += add_row(plan, north, (3.0, 6.0), ("hinged", "sliding"))
    plan.wall((0.0, depth), (0.0, width - depth))
    plan.wall((length, depth), (length, width - depth))
    plan.wall((0.0, 0.0), (1.0, 0.0))
    plan.wall((1.0, 0.0), (length - 1.0, 0.0), returns=_GLASS_RETURNS)
    plan.wall((length - 1.0, 0.0), (length, 0.0))
    plan.wall((-1.0, -2.5), (length + 1.0, -2.5))
    for number in range(plan.wanted.boxes):
        _place_chair(plan, number, doorways[number % len(doorways)].inside, depth)
    doorways.sort(key=lambda doorway: doorway.outside)
    plan.routes.append(((0.8, aisle), *(doorway.outside for doorway in doorways), (length - 0.8, aisle)))
    plan.routes += [(doorway.outside, doorway.inside) for doorway in doorways if not doorway.has_door]
    plan.meeting_points += [doorway.inside for doorway in doorways]
    start = (0.8, aisle)

    def lap(draw: np.random.Generator) -> list[Step]:
        steps = [Step(to=start)]
        for number in draw.permutation(len(doorways)).tolist():
            doorway = doorways[number]
            if doorway.has_door:
                steps.append(Step(to=doorway.outside, wait_s=1.0))
            else:
                steps += [Step(to=point) for point in (doorway.outside, doorway.inside, doorway.outside)]
        return [*steps, Step(to=(length - 0.8, aisle)), Step(to=start)]

    return lap


def _place_chair(plan: Plan, number: int, inside: tuple[float, float], depth: float) -> None:
    """Put a chair (four legs) or a stool (solid) somewhere in a room, at one of two or three places."""
    side = 1.0 if number % 2 == 0 else -1.0
    places = [
        (inside[0] + side * plan.number(0.6, 0.8), inside[1] + 0.2 * depth, plan.number(-20.0, 20.0)),
        (inside[0] - side * plan.number(0.6, 0.8), inside[1] - 0.2 * depth, plan.number(-20.0, 20.0)),
        (inside[0] + side * 0.75, inside[1] - 0.25 * depth, plan.number(20.0, 70.0)),
    ]
    plan.box(places[: 2 + number % 2], (0.42, 0.42), absent=number % 3 == 0, legs=number % 2 == 0)
