"""An office: a ring of corridors between outer rooms and a core, with doors, boxes and bins."""

from __future__ import annotations

import numpy as np

from dynmap_cli.simulation.quantities import Point
from dynmap_cli.simulation.robot import Step
from dynmap_cli.simulation.worlds.plan import Lap, Plan
from dynmap_cli.simulation.worlds.rooms import Doorway, Row, add_row

SIZE_M = (36.0, 19.0)
LEAST_M = (24.0, 16.0)
_CORRIDOR_M, _DEPTH_M = 2.2, 4.8
_WIDTHS_M = (3.0, 5.5)
_CLEAR_M, _TRIES = 1.1, 200
_DOORS = ("hinged", "hinged", "hinged", "ajar", "sliding")


def office(plan: Plan, size_m: tuple[float, float]) -> Lap:
    """Draw an office; a visit goes once around the ring and into some of the rooms without doors."""
    length, width = size_m
    south, north = _DEPTH_M, width - _DEPTH_M
    aisle_south, aisle_north = south + _CORRIDOR_M / 2.0, north - _CORRIDOR_M / 2.0
    inner = (_CORRIDOR_M, length - _CORRIDOR_M)
    core = (north - south) / 2.0 - _CORRIDOR_M
    below = add_row(plan, Row(0.0, length, south, -_DEPTH_M, aisle_south), _WIDTHS_M, _DOORS)
    above = add_row(plan, Row(0.0, length, north, _DEPTH_M, aisle_north), _WIDTHS_M, _DOORS)
    _place_boxes(plan, length, below, above)
    below += add_row(plan, Row(*inner, south + _CORRIDOR_M, core, aisle_south), _WIDTHS_M, _DOORS)
    above += add_row(
        plan, Row(*inner, north - _CORRIDOR_M, -core, aisle_north), _WIDTHS_M, _DOORS, back_wall=False
    )
    for x, side in ((0.0, 1.0), (length, -1.0)):
        plan.wall((x, south), (x, north))
        plan.block(
            (x + side * 0.15, plan.number(south + 2.5, north - 2.5), 0.0), (0.3, plan.number(0.3, 0.9))
        )
    west, east = _CORRIDOR_M / 2.0, length - _CORRIDOR_M / 2.0
    corners = [(west, aisle_south), (east, aisle_south), (east, aisle_north), (west, aisle_north)]
    below.sort(key=lambda doorway: doorway.outside)
    above.sort(key=lambda doorway: doorway.outside, reverse=True)
    ring: list[Point] = [corners[0], *(d.outside for d in below), *corners[1:3], *(d.outside for d in above)]
    ring += [corners[3], corners[0]]
    plan.routes.append(tuple(ring))
    plan.routes += [(d.outside, d.inside) for d in (*below, *above) if not d.has_door]
    plan.meeting_points += [(x, y + 0.5) for x, y in ring[1::3]]
    return _lap_of(corners, below, above)


def _place_boxes(plan: Plan, length: float, below: list[Doorway], above: list[Doorway]) -> None:
    """Put boxes along the outer walls of the corridors, not before doorways: at one of two places, or gone."""
    for number in range(plan.wanted.boxes):
        doorways = below if plan.draw.random() < 0.5 else above
        inwards = -1.0 if doorways is below else 1.0
        y = doorways[0].wall_m - inwards * 0.28
        for _ in range(_TRIES):
            x, step = plan.number(3.0, length - 5.0), plan.number(0.8, 1.6)
            if all(not x - _CLEAR_M < doorway.outside[0] < x + step + _CLEAR_M for doorway in doorways):
                places = [(x, y, 0.0), (x + step, y, 0.0)]
                plan.box(places[: 1 + number % 2], (plan.number(0.4, 0.7), 0.42))
                break


def _lap_of(corners: list[Point], below: list[Doorway], above: list[Doorway]) -> Lap:
    """One way around the ring or the other, with looks into open rooms."""

    def lap(draw: np.random.Generator) -> list[Step]:
        stops: list[list[Point]] = [[corners[0]]]
        for doorways, corner in ((below, corners[1:3]), (above, corners[3:])):
            for doorway in doorways:
                if not doorway.has_door and draw.random() < 0.6:
                    stops.append([doorway.outside, doorway.inside, doorway.outside])
            stops += [[point] for point in corner]
        if draw.random() < 0.5:
            stops[1:] = stops[:0:-1]
        return [Step(to=point) for stop in [*stops, [corners[0]]] for point in stop]

    return lap
