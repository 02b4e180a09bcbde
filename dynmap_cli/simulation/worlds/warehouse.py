"""A warehouse: racks of uprights with pallets that come and go, dock doors, pillars."""

from __future__ import annotations

import numpy as np

from dynmap_cli.simulation.quantities import Point
from dynmap_cli.simulation.robot import Step
from dynmap_cli.simulation.scenario import Leg
from dynmap_cli.simulation.worlds.plan import Lap, Plan

SIZE_M = (48.0, 28.0)
LEAST_M = (30.0, 18.0)
_RACK_M, _AISLE_M, _BAY_M = 1.2, 3.4, 2.8
_MARGIN_M = 4.0
_DOCK_M = 3.0


def warehouse(plan: Plan, size_m: tuple[float, float]) -> Lap:
    """Draw a warehouse; a visit goes up and down some of the aisles."""
    length, width = size_m
    plan.wall((0.0, 0.0), (length, 0.0), (length, width), (0.0, width))
    _add_docks(plan, width)
    rows = np.arange(_MARGIN_M, width - _MARGIN_M, _RACK_M + _AISLE_M)
    bays = np.arange(_MARGIN_M + 2.0, length - _MARGIN_M - _BAY_M, _BAY_M)
    slots: list[Point] = []
    for y in rows.tolist():
        for x in (*bays.tolist(), float(bays[-1]) + _BAY_M):
            plan.legs += [Leg(at=(x, y + offset), radius_m=0.06) for offset in (0.0, _RACK_M)]
        slots += [(x + _BAY_M / 2.0, y + _RACK_M / 2.0) for x in bays.tolist()]
    _fill_slots(plan, slots)
    for x in np.arange(8.0, length, 10.0).tolist():
        plan.legs.append(Leg(at=(x, width - 1.2), radius_m=0.2))
    aisles = [round(float(y) - _AISLE_M / 2.0, 2) for y in rows[1:]]
    west, east = _MARGIN_M, float(bays[-1]) + _BAY_M + 2.0
    ends = [[(x, y) for y in aisles] for x in (west, east)]
    plan.routes += [tuple(ends[0]), tuple(ends[1]), *(((west, y), (east, y)) for y in aisles)]
    plan.meeting_points += [(west - 1.0, y + 1.5) for y in aisles]

    def lap(draw: np.random.Generator) -> list[Step]:
        chosen = sorted(draw.choice(len(aisles), size=max(len(aisles) // 2, 1), replace=False).tolist())
        points = [(west, aisles[0])]
        at_west = True
        for number in chosen:
            sides = (west, east) if at_west else (east, west)
            points += [(x, aisles[number]) for x in sides]
            at_west = not at_west
        if not at_west:
            points.append((west, points[-1][1]))
        points.append((west, aisles[0]))
        return [Step(to=point) for point in points]

    return lap


def _fill_slots(plan: Plan, slots: list[Point]) -> None:
    """Put pallets into the racks: some for good, as many as wanted that come and go."""
    order = plan.draw.permutation(len(slots)).tolist()
    changing, rest = order[: plan.wanted.boxes], order[plan.wanted.boxes :]
    for number in changing:
        plan.box([(*slots[number], 0.0)], (plan.number(1.0, 1.3), 0.9))
    for number in rest:
        if plan.draw.random() < 0.5:
            x, y = slots[number]
            shift = plan.number(-0.5, 0.5)
            plan.block((x + shift, y, plan.number(-4.0, 4.0)), (plan.number(0.9, 1.3), 0.9))


def _add_docks(plan: Plan, width: float) -> None:
    """Cut dock doors into the west wall, with a yard wall behind."""
    middles = np.arange(4.0, width - 3.0, 7.0).tolist()
    plan.wall_with_gaps((0.0, 0.0), (0.0, width), [(y - _DOCK_M / 2.0, y + _DOCK_M / 2.0) for y in middles])
    for y in middles:
        plan.door((0.0, y - _DOCK_M / 2.0), (0.0, y + _DOCK_M / 2.0), 0.0, ("sliding",))
        plan.wall((0.0, y - 2.0), (-2.5, y - 2.0), (-2.5, y + 2.0), (0.0, y + 2.0))
