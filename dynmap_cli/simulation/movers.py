"""Where people, carts and other robots are at any time, and what the laser sees of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dynmap_cli.arrays import F64
from dynmap_cli.simulation.driving import Drive
from dynmap_cli.simulation.quantities import Point
from dynmap_cli.simulation.randomness import stream
from dynmap_cli.simulation.scenario import (
    Accompany,
    Block,
    Follow,
    Moving,
    Scenario,
    Stand,
    Stream,
    Walk,
    Wander,
)

_LEG_RADIUS_M, _TRUNK_RADIUS_M = 0.06, 0.18
_LEG_SIDE_M = 0.1
_HALF_STEP_M = 0.32
_ROBOT_RADIUS_M = 0.25
_CLEAR_M = 0.5
_SECONDS_PER_SAMPLE = 0.2
_NEAREST_COMPANION_M = 0.7
_SLOW_TO_TURN_S = np.array([0.0, 1.0, 2.0, 3.0])


@dataclass(frozen=True, slots=True)
class Track:
    """The way of one mover, straight between knots.

    Attributes
    ----------
    shape : str
        "person", "cart" or "robot".
    size_m : tuple of float
        Length and width of a cart.
    times_s : (n,) float64
        Ascending, seconds since the start.
    points : (n, 2) float64
        Where it is at each time, world frame, metres; NaN = away from the knot before to the one after.
    present_s : tuple of float
        From when until when it is there.
    clear_m : float
        How near its middle may come to the robot; it steps aside.
    """

    shape: str
    size_m: tuple[float, float]
    times_s: F64
    points: F64
    present_s: tuple[float, float]
    clear_m: float

    def at(self, times_s: F64, robot: F64) -> tuple[F64, F64]:
        """(m,) times and (m, 3) robot poses -> (m, 3) poses, NaN where it is not there, and (m,) length walked."""
        steps = np.diff(self.points, axis=0)
        lengths = np.nan_to_num(np.linalg.norm(steps, axis=1))
        walked = np.interp(times_s, self.times_s, np.concatenate([[0.0], np.cumsum(lengths)]))
        place = np.column_stack([np.interp(times_s, self.times_s, self.points[:, axis]) for axis in (0, 1)])
        moving = np.flatnonzero(lengths > 1e-6)
        yaw = np.zeros(times_s.size)
        if moving.size:
            leg = np.clip(
                np.searchsorted(self.times_s[moving], times_s, side="right") - 1, 0, moving.size - 1
            )
            chosen = steps[moving[leg]]
            yaw = np.arctan2(chosen[:, 1], chosen[:, 0])
        place = _pushed_away(place, robot, self.clear_m)
        poses = np.column_stack([place, yaw])
        poses[(times_s < self.present_s[0]) | (times_s >= self.present_s[1])] = np.nan
        return poses, walked


@dataclass(frozen=True, slots=True)
class MovingShapes:
    """What movers look like at some times.

    Attributes
    ----------
    segments : (n_times, n_segments, 4) float64
        x, y of both ends; NaN = not there.
    circles : (n_times, n_circles, 3) float64
        x, y, radius; NaN = not there.
    """

    segments: F64
    circles: F64


def tracks(scenario: Scenario, drive: Drive) -> list[Track]:
    """Ways of all movers through the whole drive."""
    result = []
    for number, mover in enumerate(scenario.movers):
        draw = stream(scenario.seed, f"mover {number}")
        present_s = (mover.from_s, mover.to_s if mover.to_s is not None else math.inf)
        clear_m = _clearance_m(mover)
        for times, points in _ways(mover, scenario.world.routes, drive, draw):
            result.append(Track(mover.shape, mover.size_m, times, points, present_s, clear_m))
    return result


def shapes_at(all_tracks: Sequence[Track], times_s: F64, robot: F64, sees: str) -> MovingShapes:
    """What a laser at the height of legs or trunks can see of all movers at some times."""
    segments: list[F64] = [np.empty((times_s.size, 0, 4))]
    circles: list[F64] = [np.empty((times_s.size, 0, 3))]
    for track in all_tracks:
        poses, walked = track.at(times_s, robot)
        if track.shape == "cart":
            segments.append(_rectangles(poses, track.size_m))
        elif track.shape == "robot":
            circles.append(_discs(poses[:, None, :2], _ROBOT_RADIUS_M))
        elif sees == "torso":
            circles.append(_discs(poses[:, None, :2], _TRUNK_RADIUS_M))
        else:
            circles.append(_discs(_feet(poses, walked), _LEG_RADIUS_M))
    return MovingShapes(np.concatenate(segments, axis=1), np.concatenate(circles, axis=1))


def _clearance_m(mover: Moving) -> float:
    """How near to the robot a mover may come; who goes with the robot keeps its own distance."""
    if isinstance(mover, Accompany | Follow | Block):
        return 0.0
    return _CLEAR_M if mover.shape == "person" else math.hypot(*mover.size_m) / 2.0 + _CLEAR_M


def _ways(
    mover: Moving, routes: Sequence[Sequence[Point]], drive: Drive, draw: np.random.Generator
) -> list[tuple[F64, F64]]:
    """Times and points of each of the movers that one entry of a scenario stands for."""
    if isinstance(mover, Walk):
        return [_walk(mover, drive)]
    if isinstance(mover, Wander):
        return [_wander(mover, routes, drive, draw) for _ in range(mover.count)]
    if isinstance(mover, Stand):
        return [_stand(mover, number, drive, draw) for number in range(mover.count)]
    if isinstance(mover, Stream):
        return [_stream(mover, drive, draw) for _ in range(mover.count)]
    if isinstance(mover, Accompany):
        return [_accompany(mover, drive, draw) for _ in range(mover.count)]
    assert isinstance(mover, Follow | Block)
    return [_with_robot(mover, drive, draw)]


@dataclass(slots=True)
class _Way:
    """Knots of a way while it is laid; nobody moves while the robot is switched off."""

    times: list[float]
    points: list[Point]
    off: list[tuple[float, float]]

    def go(self, there: Point, seconds: float) -> None:
        """Be at a place after some seconds, and stay there through any time that nobody sees."""
        self.times.append(self.times[-1] + max(seconds, 1e-3))
        self.points.append(there)
        while self.off and self.off[0][1] <= self.times[-1]:
            self.off.pop(0)
        if self.off and self.off[0][0] <= self.times[-1]:
            self.times.append(self.off[0][1])
            self.points.append(there)

    def arrays(self) -> tuple[F64, F64]:
        """Times and points as arrays."""
        return np.array(self.times), np.array(self.points, dtype=np.float64)


def _new_way(begin_s: float, start: Point, drive: Drive) -> _Way:
    """A way that begins somewhere."""
    spans = drive.recorded_spans()
    off = [(before[1], after[0]) for before, after in pairwise(spans)]
    return _Way([begin_s], [start], off)


def _walk(mover: Walk, drive: Drive) -> tuple[F64, F64]:
    """Along the path, to and fro or round and round."""
    lap = [*mover.path, mover.path[0]] if mover.closed else [*mover.path, *mover.path[-2::-1]]
    way = _new_way(mover.from_s, lap[0], drive)
    while way.times[-1] <= drive.duration_s:
        for here, there in pairwise(lap):
            way.go(there, math.dist(here, there) / mover.speed_mps)
            if mover.pause_s > 0.0:
                way.go(there, mover.pause_s)
    return way.arrays()


def _wander(
    mover: Wander, routes: Sequence[Sequence[Point]], drive: Drive, draw: np.random.Generator
) -> tuple[F64, F64]:
    """A random walk over the crossings of the routes, turning back only at dead ends."""
    neighbours: dict[Point, list[Point]] = {}
    for route in routes:
        for here, there in pairwise(route):
            neighbours.setdefault(here, []).append(there)
            neighbours.setdefault(there, []).append(here)
    crossings = sorted(neighbours)
    here = before = crossings[int(draw.integers(len(crossings)))]
    side = _lane(mover, draw)
    speed = mover.speed_mps * float(draw.uniform(0.8, 1.2))
    way = _new_way(mover.from_s, here, drive)
    while way.times[-1] <= drive.duration_s:
        choices = [there for there in neighbours[here] if there != before] or neighbours[here]
        before, here = here, choices[int(draw.integers(len(choices)))]
        way.go(here, math.dist(before, here) / speed)
        if draw.random() < mover.pause_share:
            way.go(here, float(draw.exponential(mover.pause_s)))
    times, points = way.arrays()
    return times, points + side


def _lane(mover: Wander, draw: np.random.Generator) -> F64:
    """How far from the routes it keeps: people a little, carts so that the robot has room beside them."""
    if mover.shape == "person":
        return draw.uniform(-0.25, 0.25, size=2)
    return draw.choice([-1.0, 1.0], size=2) * (mover.size_m[1] / 2.0 + 0.6)


def _stand(mover: Stand, number: int, drive: Drive, draw: np.random.Generator) -> tuple[F64, F64]:
    """In a ring around a place, shifting the feet every ten seconds or so."""
    angle = 2.0 * math.pi * number / mover.count + float(draw.uniform(0.0, 0.5))
    radius = 0.0 if mover.count == 1 else 0.45
    home = (mover.at[0] + radius * math.cos(angle), mover.at[1] + radius * math.sin(angle))
    way = _new_way(mover.from_s, home, drive)
    while way.times[-1] <= drive.duration_s:
        way.go(way.points[-1], float(draw.exponential(10.0)) + 1.0)
        shift = draw.normal(0.0, 0.08, size=2).tolist()
        way.go((home[0] + shift[0], home[1] + shift[1]), 0.5)
    return way.arrays()


def _stream(mover: Stream, drive: Drive, draw: np.random.Generator) -> tuple[F64, F64]:
    """Along the path over and over, each time on another lane, after a moment away."""
    length_m = sum(map(math.dist, mover.path, mover.path[1:]))
    speed = mover.speed_mps * float(draw.uniform(0.85, 1.15))
    way = _new_way(
        mover.from_s - float(draw.uniform(0.0, 1.0)) * length_m / speed, (math.nan, math.nan), drive
    )
    while way.times[-1] <= drive.duration_s:
        lane = _beside(mover.path, mover.width_m * float(draw.uniform(-0.5, 0.5)))
        way.go(lane[0], float(draw.uniform(0.5, 2.0)))
        for here, there in pairwise(lane):
            way.go(there, math.dist(here, there) / speed)
        way.go((math.nan, math.nan), float(draw.uniform(0.5, 2.0)))
    return way.arrays()


def _beside(path: Sequence[Point], left_m: float) -> list[Point]:
    """The same path, shifted to the left; corners along the mean normal of both legs."""
    points = np.array(path)
    along = np.diff(points, axis=0)
    along = along / np.maximum(np.linalg.norm(along, axis=1), 1e-9)[:, None]
    at_points = np.concatenate([along[:1], along[:-1] + along[1:], along[-1:]])
    at_points /= np.maximum(np.linalg.norm(at_points, axis=1), 1e-9)[:, None]
    shifted = points + left_m * np.column_stack([-at_points[:, 1], at_points[:, 0]])
    return [(float(x), float(y)) for x, y in shifted]


def _accompany(mover: Accompany, drive: Drive, draw: np.random.Generator) -> tuple[F64, F64]:
    """At a place beside the robot, swaying a little; where the robot turns, the group follows more slowly."""
    times = drive.ticks(0.0, _SECONDS_PER_SAMPLE)
    bearing = float(draw.uniform(0.0, 2.0 * np.pi))
    distance = math.sqrt(float(draw.uniform(_NEAREST_COMPANION_M**2, max(mover.reach_m, 1.0) ** 2)))
    yaw = np.mean([drive.at(times - ago)[:, 2] for ago in _SLOW_TO_TURN_S], axis=0) + bearing
    phases = draw.uniform(0.0, 2.0 * np.pi, size=2)
    sway = 0.12 * np.column_stack([np.sin(times * 2.0 * np.pi / 7.0 + phase) for phase in phases])
    beside = distance * np.column_stack([np.cos(yaw), np.sin(yaw)])
    return times, drive.at(times)[:, :2] + beside + sway


def _with_robot(mover: Follow | Block, drive: Drive, draw: np.random.Generator) -> tuple[F64, F64]:
    """On the robot's own path, behind or before it, swaying a little."""
    times = drive.ticks(0.0, _SECONDS_PER_SAMPLE)
    driven = drive.distance_m(times)
    distance = -mover.distance_m if isinstance(mover, Follow) else mover.distance_m
    there = driven + distance
    poses = drive.at(drive.time_at_distance_s(there))
    beyond = there - np.clip(there, 0.0, driven[-1])
    sway = 0.12 * np.sin(times * 2.0 * np.pi / 7.0 + draw.uniform(0.0, 6.0))
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    points = np.column_stack(
        [poses[:, 0] + beyond * cos - sway * sin, poses[:, 1] + beyond * sin + sway * cos]
    )
    return times, points


def _pushed_away(place: F64, robot: F64, clear_m: float) -> F64:
    """Move points out of the circle that people keep clear of the robot."""
    offset = place - robot[:, :2]
    distance = np.linalg.norm(offset, axis=1)
    close = distance < clear_m
    if not close.any():
        return place
    outwards = np.where(distance[:, None] > 1e-6, offset / np.maximum(distance, 1e-6)[:, None], [1.0, 0.0])
    return np.where(close[:, None], robot[:, :2] + clear_m * outwards, place)


def _feet(poses: F64, walked_m: F64) -> F64:
    """(m, 2, 2) places of both feet: one stands still on the ground while the other swings forward."""
    cycle = walked_m / (4.0 * _HALF_STEP_M)
    left = _HALF_STEP_M * (4.0 * np.abs(cycle - np.floor(cycle + 0.5)) - 1.0)
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    feet = []
    for side, ahead in ((_LEG_SIDE_M, left), (-_LEG_SIDE_M, -left)):
        feet.append(
            np.column_stack([poses[:, 0] + ahead * cos - side * sin, poses[:, 1] + ahead * sin + side * cos])
        )
    return np.stack(feet, axis=1)


def _discs(centers: F64, radius_m: float) -> F64:
    """(m, k, 2) centres -> (m, k, 3) circles."""
    return np.concatenate([centers, np.full((*centers.shape[:2], 1), radius_m)], axis=2)


def _rectangles(poses: F64, size_m: tuple[float, float]) -> F64:
    """(m, 3) poses -> (m, 4, 4) sides of rectangles."""
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    half, side = size_m[0] / 2.0, size_m[1] / 2.0
    corners = np.stack(
        [
            np.column_stack([poses[:, 0] + cos * u - sin * v, poses[:, 1] + sin * u + cos * v])
            for u, v in ((half, side), (-half, side), (-half, -side), (half, -side))
        ],
        axis=1,
    )
    return np.concatenate([corners, np.roll(corners, -1, axis=1)], axis=2)
