"""Rooms along a corridor, with doors or open doorways and some furniture: the stuff of offices and homes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from dynmap_cli.simulation.quantities import Point
from dynmap_cli.simulation.worlds.plan import Plan, pieces_of

DOORWAY_M = 1.0


@dataclass(frozen=True, slots=True)
class Row:
    """A row of rooms on one side of a corridor that runs along x.

    Attributes
    ----------
    from_m, to_m : float
        x of both ends.
    wall_m : float
        y of the wall with the doorways.
    depth_m : float
        Depth of the rooms; negative = they lie below the wall.
    aisle_m : float
        y of the middle of the corridor.
    """

    from_m: float
    to_m: float
    wall_m: float
    depth_m: float
    aisle_m: float


@dataclass(frozen=True, slots=True)
class Doorway:
    """Where a room opens to the corridor.

    Attributes
    ----------
    outside, inside : (x, y)
        In the corridor before it, and in the room behind it.
    wall_m : float
        y of the wall it is in.
    has_door : bool
    """

    outside: Point
    inside: Point
    wall_m: float
    has_door: bool


def add_row(
    plan: Plan, row: Row, widths_m: tuple[float, float], kinds: Sequence[str], *, back_wall: bool = True
) -> list[Doorway]:
    """Draw a row of rooms; returns their doorways in the order of x."""
    cuts = [row.from_m + cut for cut in pieces_of(row.to_m - row.from_m, *widths_m, plan.draw)]
    back = row.wall_m + row.depth_m
    doorways, gaps = [], []
    for left, right in pairwise(cuts):
        start = plan.number(left + 0.4, right - 0.4 - DOORWAY_M)
        gaps.append((start - row.from_m, start - row.from_m + DOORWAY_M))
        has_door = bool(plan.draw.random() < plan.wanted.door_share)
        if has_door:
            _hang(plan, start, row, kinds)
        middle = start + DOORWAY_M / 2.0
        inside = (middle, row.wall_m + 0.45 * row.depth_m)
        doorways.append(Doorway((middle, row.aisle_m), inside, row.wall_m, has_door))
        _furnish(plan, (left, right), row, middle)
        plan.wall((right, row.wall_m), (right, back))
    plan.wall((row.from_m, row.wall_m), (row.from_m, back))
    plan.wall_with_gaps((row.from_m, row.wall_m), (row.to_m, row.wall_m), gaps)
    if back_wall:
        plan.wall((row.from_m, back), (row.to_m, back))
    return doorways


def _hang(plan: Plan, start: float, row: Row, kinds: Sequence[str]) -> None:
    """Hang a door into a doorway; it opens into the room, its hinge left or right."""
    left, right = (start, row.wall_m), (start + DOORWAY_M, row.wall_m)
    inwards = 90.0 if row.depth_m > 0.0 else -90.0
    if plan.draw.random() < 0.5:
        plan.door(left, right, inwards, kinds)
    else:
        plan.door(right, left, -inwards, kinds)


def _furnish(plan: Plan, sides: tuple[float, float], row: Row, doorway: float) -> None:
    """Put a cupboard and a table at the back wall, away from the way in."""
    left, right = sides
    sign = 1.0 if row.depth_m > 0.0 else -1.0
    back = row.wall_m + row.depth_m
    if plan.draw.random() < 0.8:
        width = plan.number(0.6, min(1.6, right - left - 1.0))
        x = plan.number(left + width / 2.0, right - width / 2.0)
        plan.block((x, back - sign * 0.25, 0.0), (width, 0.5))
    free_left, free_right = doorway - left, right - doorway
    x = left + 0.5 if free_left > free_right else right - 0.5
    if max(free_left, free_right) > 1.6:
        plan.table((x, row.wall_m + sign * 0.4 * abs(row.depth_m), 0.0), (0.7, 1.2))
