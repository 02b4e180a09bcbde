"""A car park: rows of slots with cars that come and go, trees, a building with a curved front, far walls."""

from __future__ import annotations

import numpy as np

from dynmap_cli.simulation.quantities import Point
from dynmap_cli.simulation.robot import Step
from dynmap_cli.simulation.scenario import Arc, Leg
from dynmap_cli.simulation.worlds.plan import Lap, Placing, Plan

SIZE_M = (80.0, 50.0)
LEAST_M = (60.0, 40.0)
_CAR_M = (4.3, 1.8)
_SLOT_M, _LANE_M, _ROW_M = 2.6, 7.0, 5.2


def car_park(plan: Plan, size_m: tuple[float, float]) -> Lap:
    """Draw a car park; a visit drives along all lanes."""
    length, width = size_m
    plan.wall((0.0, 0.0), (length * 0.4, -1.5), (length * 0.42, -6.0), (length * 0.5, -6.0))
    plan.wall((length * 0.5, -6.0), (length * 0.52, 0.0), (length, 0.0))
    plan.arcs.append(
        Arc(center=(length, width * 0.5), radius_m=width * 0.25, from_deg=90.0, to_deg=270.0, returns=0.7)
    )
    plan.wall((length, 0.0), (length, width * 0.25))
    plan.wall((length, width * 0.75), (length, width))
    for x in np.arange(3.0, length, 6.5).tolist():
        plan.legs.append(Leg(at=(x + plan.number(-1.0, 1.0), width + 1.0), radius_m=plan.number(0.1, 0.3)))
        plan.legs.append(
            Leg(at=(plan.number(-1.5, -0.5), x * width / length), radius_m=plan.number(0.1, 0.3))
        )
    lanes, slots = _lanes_and_slots(plan, length, width)
    order = plan.draw.permutation(len(slots)).tolist()
    for number in order[: plan.wanted.boxes]:
        plan.box([slots[number]], _CAR_M)
    for number in order[plan.wanted.boxes :]:
        if plan.draw.random() < 0.4:
            plan.block(slots[number], (plan.number(3.9, 4.8), plan.number(1.65, 1.9)))
    west, east = 6.0, length * 0.62
    ends: list[list[Point]] = [[(x, y) for y in lanes] for x in (west, east)]
    plan.routes += [tuple(ends[0]), tuple(ends[1]), *(((west, y), (east, y)) for y in lanes)]
    plan.meeting_points += [(west - 2.0, y + 2.0) for y in lanes]

    def lap(draw: np.random.Generator) -> list[Step]:
        points: list[Point] = []
        for number, y in enumerate(lanes):
            points += [(x, y) for x in ((west, east) if number % 2 == 0 else (east, west))]
        points += [(west, points[-1][1]), (west, lanes[0])]
        if draw.random() < 0.5:
            points.reverse()
            points.insert(0, (west, lanes[0]))
        return [Step(to=point) for point in points]

    return lap


def _lanes_and_slots(plan: Plan, length: float, width: float) -> tuple[list[float], list[Placing]]:
    """Heights of the lanes, and where cars may stand on both sides of each."""
    pitch = _LANE_M + 2.0 * _ROW_M + 1.0
    lanes = np.arange(_LANE_M / 2.0 + _ROW_M + 1.0, width - _ROW_M - 2.0, pitch).tolist()
    slots = []
    for y in lanes:
        for side in (-1.0, 1.0):
            for x in np.arange(10.0, length * 0.58, _SLOT_M).tolist():
                yaw = 90.0 + plan.number(-3.0, 3.0)
                slots.append((x, y + side * (_LANE_M + _ROW_M) / 2.0, yaw))
    return lanes, slots
