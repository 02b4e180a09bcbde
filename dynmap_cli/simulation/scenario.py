"""Scenarios: what a YAML file says about world, movers, robot and sensors. Checked once, frozen."""

from __future__ import annotations

import difflib
import math
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AwareDatetime,
    BeforeValidator,
    Field,
    ValidationError,
    model_validator,
)

from dynmap_cli.errors import ConfigError
from dynmap_cli.files.damage import reason
from dynmap_cli.files.documents import parse_yaml, read_text
from dynmap_cli.simulation.quantities import (
    Coordinate,
    Degrees,
    Length,
    Mean,
    Part,
    Point,
    Seconds,
    Share,
    Speed,
)
from dynmap_cli.simulation.robot import Laser, Odometry, Robot

_LEAST_WAY_M = 0.1
WorldSize = Annotated[float, Field(gt=0.0, le=300.0)]
_FIRST_START, _LAST_START = datetime(1970, 1, 1, tzinfo=UTC), datetime(2200, 1, 1, tzinfo=UTC)


def _wall_from_points(value: Any) -> Any:
    """Let a plain list of points stand for an opaque wall."""
    return {"points": value} if isinstance(value, list) else value


class Wall(Part):
    """A polyline of walls."""

    points: tuple[Point, ...] = Field(min_length=2, description="Corners, metres.")
    closed: bool = Field(False, description="Whether the last corner is joined to the first.")
    returns: Share = Field(1.0, description="Share of beams it reflects; glass about 0.3.")


class Arc(Part):
    """A curved wall, made of short pieces."""

    center: Point
    radius_m: float = Field(ge=0.001, le=1000.0)
    from_deg: float = Field(0.0, ge=-720.0, le=720.0)
    to_deg: float = Field(360.0, ge=-720.0, le=720.0)
    returns: Share = 1.0


class Leg(Part):
    """A thin upright: leg of a table or chair, pillar, tree."""

    at: Point
    radius_m: Length = 0.02


class Process(Part):
    """Seeded changes of state: exponential waiting times, each change to another state at random."""

    mean_s: Mean = Field(description="Mean time from one change to the next.")
    when: Literal["always", "away", "near"] = Field(
        "always",
        description="Changes wait until the robot is further than near_m, or nearer, or for nothing.",
    )
    near_m: Length = 8.0


class Changing(Part):
    """A thing with several states: when it takes which."""

    name: str = Field(min_length=1)
    schedule: tuple[tuple[Seconds, str], ...] = Field(
        (), description="[seconds since the start, state]; the first state holds until the first entry."
    )
    process: Process | None = Field(None, description="Seeded changes instead of a schedule.")

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states, in order."""
        raise NotImplementedError

    @model_validator(mode="after")
    def _check_changes(self) -> Changing:
        """Refuse unknown states and two sources of changes."""
        if self.schedule and self.process:
            msg = f"'{self.name}' has both a schedule and a process; keep one"
            raise ValueError(msg)
        for _, state in self.schedule:
            if state not in self.state_names:
                msg = f"'{self.name}' has no state '{state}', only {', '.join(self.state_names)}"
                raise ValueError(msg)
        return self


class Door(Changing):
    """A door leaf, 4 cm thick, between hinge and latch when closed."""

    kind: Literal["hinged", "sliding"] = "hinged"
    hinge: Point
    latch: Point
    states: dict[str, Degrees] = Field(
        {"closed": 0.0, "open": 90.0},
        min_length=2,
        description="Hinged: degrees, counter-clockwise; sliding: percent of the width inside the wall at the hinge.",
    )

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states, in order."""
        return tuple(self.states)


class Box(Changing):
    """A box, pallet, car, table or chair that stands at one of several places, or is gone."""

    size_m: tuple[Length, Length]
    places: dict[str, tuple[Coordinate, Coordinate, Degrees]] = Field(
        min_length=1, description="Centre x, y in metres and yaw in degrees."
    )
    absent: bool = Field(True, description="Whether 'absent' is a state too.")
    shape: Literal["solid", "legs"] = Field("solid", description="legs: only four thin legs at the corners.")

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states, in order."""
        return (*self.places, "absent") if self.absent else tuple(self.places)


class World(Part):
    """What stands around."""

    walls: tuple[Annotated[Wall, BeforeValidator(_wall_from_points)], ...] = ()
    arcs: tuple[Arc, ...] = ()
    legs: tuple[Leg, ...] = ()
    doors: tuple[Door, ...] = ()
    boxes: tuple[Box, ...] = ()
    routes: tuple[tuple[Point, ...], ...] = Field(
        (), description="Polylines along which wanderers go; shared points are crossings."
    )

    @model_validator(mode="after")
    def _check_names(self) -> World:
        """Refuse two objects of one name."""
        names = [thing.name for thing in (*self.doors, *self.boxes)]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            msg = f"two objects are called '{twice[0]}'; give each its own name"
            raise ValueError(msg)
        return self


class Generate(Part):
    """A world drawn from a seed, added to what is listed."""

    kind: Literal["office", "warehouse", "home", "crowd", "car_park"]
    size_m: tuple[WorldSize, WorldSize] | None = Field(
        None, description="Length and width; null = as usual for its kind."
    )
    seed: int | None = Field(
        None, ge=0, lt=2**63, description="Seed of the building; null = that of the scenario."
    )
    door_share: Share = Field(0.6, description="Share of the doorways that have a door.")
    boxes: int = Field(
        4, ge=0, le=1000, description="How many boxes, pallets, chairs or cars come, go or move."
    )
    changes: Process = Field(Process(mean_s=300.0), description="When doors and boxes change.")
    people: int = Field(3, ge=0, le=1000, description="How many people wander about.")
    talking: int = Field(0, ge=0, le=1000, description="How many groups stand and talk for a while.")
    carts: int = Field(0, ge=0, le=1000, description="How many carts (in the car park: cars) drive about.")


class Moving(Part):
    """What all movers have in common."""

    shape: Literal["person", "cart", "robot"] = "person"
    size_m: tuple[Length, Length] = Field((0.8, 0.5), description="Length and width of a cart.")
    from_s: Seconds = Field(0.0, description="Seconds since the start from which it is there.")
    to_s: Mean | None = Field(None, description="Seconds since the start until which it is there.")


def _check_way(path: Sequence[Point], whose: str) -> None:
    """Refuse a path on which nobody gets anywhere."""
    if sum(map(math.dist, path, path[1:])) < _LEAST_WAY_M:
        msg = f"the path of {whose} is shorter than {_LEAST_WAY_M:g} m; let it stand instead"
        raise ValueError(msg)


class Walk(Moving):
    """Goes along a path, to and fro or round and round."""

    does: Literal["walk"] = "walk"
    path: tuple[Point, ...] = Field(min_length=2)
    speed_mps: Speed = 1.2
    pause_s: Seconds = Field(0.0, description="Pause at each corner.")
    closed: bool = Field(False, description="Round and round instead of to and fro.")

    @model_validator(mode="after")
    def _check_length(self) -> Walk:
        """Somebody who walks gets somewhere."""
        _check_way(self.path, "a walker")
        return self


class Wander(Moving):
    """Goes along the routes of the world, turns at random at crossings and stands still now and then."""

    does: Literal["wander"] = "wander"
    count: int = Field(1, ge=1, le=1000)
    speed_mps: Speed = 1.2
    pause_share: Share = Field(0.2, description="Share of the crossings at which it stops.")
    pause_s: Mean = Field(8.0, description="Mean length of a stop.")


class Stand(Moving):
    """Stands at a place, alone or talking in a ring, shifting the feet now and then."""

    does: Literal["stand"] = "stand"
    at: Point
    count: int = Field(1, ge=1, le=1000)


class Stream(Moving):
    """Many who go along a path, all one way; at its end each begins again at its start, as another one would."""

    does: Literal["stream"] = "stream"
    path: tuple[Point, ...] = Field(min_length=2)
    count: int = Field(20, ge=1, le=1000)
    width_m: Length = Field(4.0, description="How wide the stream is.")
    speed_mps: Speed = Field(1.0, description="Mean; everybody goes up to 15 % faster or slower.")

    @model_validator(mode="after")
    def _check_length(self) -> Stream:
        """Somebody who walks gets somewhere."""
        _check_way(self.path, "a stream")
        return self


class Accompany(Moving):
    """A group that goes with the robot, all around it, each at a place of their own."""

    does: Literal["accompany"] = "accompany"
    count: int = Field(8, ge=1, le=1000)
    reach_m: Length = Field(2.5, description="How far from the robot the outermost go.")


class Follow(Moving):
    """Goes behind the robot, on its path."""

    does: Literal["follow"] = "follow"
    distance_m: Length = 1.0


class Block(Moving):
    """Goes in front of the robot, in its way."""

    does: Literal["block"] = "block"
    distance_m: Length = 1.2


Mover = Annotated[Walk | Wander | Stream | Stand | Accompany | Follow | Block, Field(discriminator="does")]


class Scenario(Part):
    """A world, a robot in it, and what is recorded."""

    about: str = Field("", description="One line: what it tests.")
    seed: int = Field(0, ge=0, lt=2**63)
    start: AwareDatetime = Field(
        datetime(2026, 3, 2, 8, 0, tzinfo=UTC),
        ge=_FIRST_START,
        lt=_LAST_START,
        description="Time of the first scan.",
    )
    turn_deg: Degrees = Field(0.0, description="Turn of the whole world against the axes of the map.")
    world: World = World()
    generate: Generate | None = Field(
        None, description="A world to be drawn from the seed, and visits in it."
    )
    movers: tuple[Mover, ...] = ()
    robot: Robot = Robot()
    lasers: tuple[Laser, ...] = Field((Laser(),), min_length=1, max_length=16)
    odometry: Odometry | None = Field(Odometry(), description="null = none.")
    map_resolution_m: float = Field(0.05, ge=0.005, le=10.0, description="Cell of the true map.")

    @model_validator(mode="after")
    def _check_parts(self) -> Scenario:
        """Laser names differ; there are a path, and routes for wanderers, unless they are generated."""
        if len({laser.name for laser in self.lasers}) < len(self.lasers):
            msg = "two lasers have the same name; give each its own"
            raise ValueError(msg)
        for route in self.world.routes:
            if len(route) < 2 or min(map(math.dist, route, route[1:])) < _LEAST_WAY_M:
                msg = f"a route needs at least two points, each {_LEAST_WAY_M:g} m or more from the next"
                raise ValueError(msg)
        if self.generate is not None:
            return self
        if not self.robot.path:
            msg = "robot.path is missing: list places [x, y], or let a world be generated"
            raise ValueError(msg)
        if any(isinstance(mover, Wander) for mover in self.movers) and not self.world.routes:
            msg = "wanderers need world.routes to go along"
            raise ValueError(msg)
        return self


def load_scenario(path: Path, seed: int | None = None) -> Scenario:
    """Read a scenario file; *seed* replaces its own.

    Raises
    ------
    ConfigError
        One line with file and key, and the nearest known key where one is unknown.
    """
    try:
        content = parse_yaml(read_text(path))
    except (OSError, ValueError) as err:
        msg = f"{path}: scenario cannot be read ({reason(err)})"
        raise ConfigError(msg) from err
    return parse_scenario(content, str(path), seed)


def parse_scenario(content: object, where: str = "scenario", seed: int | None = None) -> Scenario:
    """Check the content of a scenario file; *where* is named in errors."""
    if not isinstance(content, dict):
        msg = f"{where}: expected 'key: value' lines, found {type(content).__name__}"
        raise ConfigError(msg)
    if seed is not None:
        content = {**content, "seed": seed}
    try:
        return Scenario.model_validate(content)
    except ValidationError as err:
        msg = f"{where}: {_explain(err)}"
        raise ConfigError(msg) from err


def _explain(err: ValidationError) -> str:
    """One line for the first value that is not allowed."""
    first = err.errors()[0]
    key = ".".join(str(part) for part in first["loc"]) or "scenario"
    if first["type"] == "extra_forbidden":
        nearest = difflib.get_close_matches(str(first["loc"][-1]), _all_keys(Part), n=1, cutoff=0.5)
        hint = f", did you mean '{nearest[0]}'?" if nearest else ""
        return f"unknown key '{key}'{hint}"
    if first["type"] == "missing":
        return f"'{key}' is missing"
    found = repr(first.get("input"))
    return f"{key} = {found if len(found) <= 60 else found[:57] + '...'} is not allowed: {first['msg']}"


def _all_keys(part: type[Part]) -> list[str]:
    """Every key that any part of a scenario knows."""
    keys = {name for child in part.__subclasses__() for name in (*child.model_fields, *_all_keys(child))}
    return sorted(keys)
