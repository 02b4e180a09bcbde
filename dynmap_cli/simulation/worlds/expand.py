"""From what a scenario wants generated to one in which everything is written out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynmap_cli.errors import ConfigError
from dynmap_cli.simulation.randomness import stream
from dynmap_cli.simulation.robot import Robot, Step
from dynmap_cli.simulation.scenario import Mover, Scenario, Stand, Wander, World
from dynmap_cli.simulation.worlds import car_park, crowd, home, office, warehouse
from dynmap_cli.simulation.worlds.plan import Lap, Plan

_KINDS = {
    "office": (office.office, office.SIZE_M, office.LEAST_M),
    "warehouse": (warehouse.warehouse, warehouse.SIZE_M, warehouse.LEAST_M),
    "home": (home.home, home.SIZE_M, home.LEAST_M),
    "crowd": (crowd.crowd, crowd.SIZE_M, crowd.LEAST_M),
    "car_park": (car_park.car_park, car_park.SIZE_M, car_park.LEAST_M),
}
_CAR_M, _CART_M = (4.3, 1.8), (1.0, 0.6)


def expand(scenario: Scenario) -> Scenario:
    """Write out the generated world, its people, and every visit of the robot.

    What the scenario lists itself is kept and added to what is generated; its own path wins.
    """
    draw = stream(scenario.seed, "patrol")
    if scenario.generate is None:
        path = _visits(scenario.robot, lambda _: list(scenario.robot.path), draw)
        return scenario.model_copy(update={"robot": _with_path(scenario.robot, path)})
    wanted = scenario.generate
    seed = scenario.seed if wanted.seed is None else wanted.seed
    plan = Plan(wanted, stream(seed, f"world {wanted.kind}"))
    make, usual_m, least_m = _KINDS[wanted.kind]
    size_m = wanted.size_m or usual_m
    if size_m[0] < least_m[0] or size_m[1] < least_m[1]:
        msg = f"generate.size_m = {list(size_m)} is too small for '{wanted.kind}': at least {list(least_m)} m"
        raise ConfigError(msg)
    lap = make(plan, size_m)
    if scenario.robot.path:
        own = list(scenario.robot.path)
        path = _visits(scenario.robot, lambda _: own, draw)
    else:
        path = _visits(scenario.robot, lap, draw)
    return scenario.model_copy(
        update={
            "generate": None,
            "world": _joined(scenario.world, plan),
            "movers": (*scenario.movers, *_people(plan)),
            "robot": _with_path(scenario.robot, path),
        }
    )


def _joined(world: World, plan: Plan) -> World:
    """What the scenario lists, then what was generated."""
    taken = {thing.name for thing in (*world.doors, *world.boxes)}
    for thing in (*plan.doors, *plan.boxes):
        if thing.name in taken:
            msg = f"'{thing.name}' is the name of a generated object; rename the one in world.doors or world.boxes"
            raise ConfigError(msg)
    return World(
        walls=(*world.walls, *plan.walls),
        arcs=(*world.arcs, *plan.arcs),
        legs=(*world.legs, *plan.legs),
        doors=(*world.doors, *plan.doors),
        boxes=(*world.boxes, *plan.boxes),
        routes=(*world.routes, *plan.routes),
    )


def _people(plan: Plan) -> list[Mover]:
    """Wanderers, talking groups and vehicles, as many as wanted."""
    wanted = plan.wanted
    movers: list[Mover] = []
    if wanted.people:
        movers.append(Wander(count=wanted.people))
    if wanted.carts:
        outside = wanted.kind == "car_park"
        movers.append(
            Wander(
                count=wanted.carts,
                shape="cart",
                size_m=_CAR_M if outside else _CART_M,
                speed_mps=4.0 if outside else 1.0,
            )
        )
    for _ in range(wanted.talking):
        at = plan.meeting_points[int(plan.draw.integers(len(plan.meeting_points)))]
        begin = plan.number(0.0, 600.0)
        count = int(plan.draw.integers(2, 4))
        movers.append(Stand(at=at, count=count, from_s=begin, to_s=begin + plan.number(60.0, 600.0)))
    return movers


def _visits(robot: Robot, lap: Lap, draw: np.random.Generator) -> list[Step]:
    """All visits of all days, with the robot switched off in between."""
    steps: list[Step] = []
    for visit in range(robot.days * robot.repeat):
        if steps:
            steps.append(Step(off_s=robot.pause_s if visit % robot.repeat else robot.night_s))
        steps += lap(draw)
    return steps


def _with_path(robot: Robot, path: Sequence[Step]) -> Robot:
    """The same robot with every visit in its path."""
    return robot.model_copy(update={"path": tuple(path), "repeat": 1, "days": 1})
