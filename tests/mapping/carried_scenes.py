"""Robots that are carried inside one recording: their odometry goes on as if nothing had happened."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dynmap_cli.arrays import F64
from dynmap_cli.simulation.driving import plan_drive
from dynmap_cli.simulation.robot import Step
from dynmap_cli.simulation.run import SimulatedRun, simulate
from dynmap_cli.simulation.scenario import Scenario, parse_scenario
from dynmap_cli.simulation.worlds.expand import expand

WORLDS = ("office", "corridor")
HOW = ("at once", "in hands", "switched off")
BEFORE_M, AFTER_M = 60.0, 60.0
_LASER = {"beams": 181, "fov_deg": 180, "max_range_m": 25, "rate_hz": 5, "noise_m": 0.015}
_CORRIDOR = [
    {"points": [[0, 0], [40, 0], [40, 12], [0, 12]], "closed": True},
    {"points": [[2.2, 2.2], [37.8, 2.2], [37.8, 9.8], [2.2, 9.8]], "closed": True},
    *([[x, 2.2], [x, 1.95]] for x in (5.0, 9.5, 11.0, 17.0, 20.5, 27.0, 29.0, 34.5)),
    *([[x, 9.8], [x, 10.1]] for x in (4.0, 8.0, 14.5, 16.0, 24.0, 30.5, 33.0)),
    [[0, 5.0], [0.3, 5.0]],
    [[40, 7.0], [39.6, 7.0]],
]
_AROUND = [[1.1, 1.1], [38.9, 1.1], [38.9, 10.9], [1.1, 10.9]]


@dataclass(frozen=True)
class CarriedRun:
    """A recording in which the robot is carried once.

    Attributes
    ----------
    run : SimulatedRun
    begin_s, end_s : float
        When it is lifted and set down, seconds since the first sweep.
    """

    run: SimulatedRun
    begin_s: float
    end_s: float


def make_carried(world: str, far_m: float, how: str, seed: int) -> CarriedRun:
    """A robot that is carried about so far to another place of its way, turned anyhow, and drives on from there."""
    draw = np.random.default_rng([seed, WORLDS.index(world), round(far_m * 10), HOW.index(how)])
    base = _office(seed, draw) if world == "office" else _corridor(seed, draw)
    path = _with_carry([step.to for step in base.robot.path if step.to is not None], far_m, how, draw)
    scenario = base.model_copy(update={"robot": base.robot.model_copy(update={"path": tuple(path)})})
    drive = plan_drive(scenario.robot)
    held = np.flatnonzero(drive.carried)
    begin_s, end_s = float(drive.times_s[held[0]]), float(drive.times_s[held[-1] + 1])
    return CarriedRun(simulate(scenario), begin_s, end_s)


def _office(seed: int, draw: np.random.Generator) -> Scenario:
    size = [round(30.0 * draw.uniform(0.8, 1.1), 1), round(20.0 * draw.uniform(0.8, 1.1), 1)]
    content = {
        "seed": seed,
        "generate": {"kind": "office", "size_m": size, "people": 2, "door_share": 0},
        "robot": {"speed_mps": 0.8},
        "lasers": [_LASER],
    }
    return expand(parse_scenario(content))


def _corridor(seed: int, draw: np.random.Generator) -> Scenario:
    around = _AROUND if draw.random() < 0.5 else _AROUND[::-1]
    content = {
        "seed": seed,
        "world": {"walls": _CORRIDOR},
        "robot": {"path": around * 3, "speed_mps": 0.8},
        "lasers": [{**_LASER, "max_range_m": 12}],
    }
    return parse_scenario(content)


def _with_carry(
    places: list[tuple[float, float]], far_m: float, how: str, draw: np.random.Generator
) -> list[Step]:
    """A way along these places with one jump from a point on it to another so far away."""
    places = places + places
    points, legs = _points_along(np.array(places))
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    lifted = int(np.searchsorted(way, BEFORE_M + draw.uniform(-5.0, 5.0)))
    apart = np.abs(np.hypot(*(points - points[lifted]).T) - far_m)
    near = np.flatnonzero((apart < 0.3) & (way < way[-1] - AFTER_M))
    put = int(draw.choice(near))
    steps = [Step(to=tuple(place)) for place in places[: legs[lifted] + 1]]
    turn_deg = float(draw.uniform(-180.0, 180.0))
    to = (*(points[put] + draw.uniform(-0.2, 0.2, 2)).round(3).tolist(), round(turn_deg, 1))
    extra = {"carried_s": 4.0} if how == "in hands" else {"off_s": 30.0} if how == "switched off" else {}
    steps.append(Step(to=tuple(points[lifted].tolist()), carried_to=to, **extra))
    end = int(np.searchsorted(way, way[put] + AFTER_M))
    return [*steps, *(Step(to=tuple(place)) for place in places[legs[put] + 1 : legs[end] + 2])]


def _points_along(places: F64) -> tuple[F64, np.ndarray]:
    """Points every 20 cm along a way, and the leg each is on."""
    points, legs = [], []
    for leg, (begin, end) in enumerate(pairwise(places)):
        count = max(math.ceil(math.dist(begin, end) / 0.2), 1)
        points.append(begin + np.arange(count)[:, None] / count * (end - begin))
        legs.append(np.full(count, leg))
    return np.concatenate(points), np.concatenate(legs)
