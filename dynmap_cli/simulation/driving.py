"""The robot's path: waypoints joined by pieces of constant speed and turn rate."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dynmap_cli.arrays import B1, F64
from dynmap_cli.simulation.robot import Robot, Step

_HELD_S, _SHORTEST_S = 0.1, 1e-6


@dataclass(frozen=True, slots=True)
class Drive:
    """Where the robot is at any time, in pieces of constant twist.

    Attributes
    ----------
    times_s : (n + 1,) float64
        Begin of each piece and end of the last, seconds since the start.
    poses : (n, 3) float64
        world_from_robot at the begin of each piece; yaw grows without wrapping.
    twists : (n, 2) float64
        Speed in m/s, negative = in reverse, and turn rate in rad/s.
    recorded : (n,) bool
        False while the robot is switched off.
    carried : (n,) bool
        While the robot is in somebody's hands; such a piece begins elsewhere than the one before ends.
    rolled : (n, 3) float64
        Where the wheels alone would have led at the begin of each piece.
    """

    times_s: F64
    poses: F64
    twists: F64
    recorded: B1
    carried: B1
    rolled: F64

    @property
    def duration_s(self) -> float:
        """Length of the whole drive."""
        return float(self.times_s[-1])

    def at(self, times_s: F64) -> F64:
        """(m,) times -> (m, 3) world_from_robot, yaw not wrapped; the first and last pose hold outside."""
        return self._along(self.poses, times_s)

    def rolled_at(self, times_s: F64) -> F64:
        """(m,) times -> (m, 3) where the wheels alone would have led, without being carried."""
        return self._along(self.rolled, times_s)

    def is_carried(self, times_s: F64) -> B1:
        """(m,) whether the robot is in somebody's hands."""
        return np.asarray(self.carried[self._piece(times_s)])

    def is_recorded(self, times_s: F64) -> B1:
        """(m,) whether the robot is switched on."""
        return np.asarray(self.recorded[self._piece(times_s)])

    def recorded_spans(self) -> list[tuple[float, float]]:
        """Begin and end of each time in which the robot is switched on without a break."""
        steps = np.diff(np.concatenate([[0], self.recorded.astype(np.int8), [0]]))
        begins, ends = self.times_s[np.flatnonzero(steps == 1)], self.times_s[np.flatnonzero(steps == -1)]
        return list(zip(begins.tolist(), ends.tolist(), strict=True))

    def ticks(self, first_s: float, period_s: float, needed_s: float = 0.0) -> F64:
        """Multiples of a period after the first, at which the robot is switched on and stays so for a while."""
        ticks = [np.empty(0)]
        for begin, end in self.recorded_spans():
            low = max(math.ceil((begin - first_s) / period_s - 1e-9), 0)
            high = math.floor((end - needed_s - first_s) / period_s + 1e-9)
            ticks.append(first_s + period_s * np.arange(low, high + 1, dtype=np.float64))
        return np.concatenate(ticks)

    def distance_m(self, times_s: F64) -> F64:
        """(m,) length of the path driven until each time."""
        knots = np.concatenate([[0.0], np.cumsum(np.abs(self.twists[:, 0]) * np.diff(self.times_s))])
        return np.asarray(np.interp(times_s, self.times_s, knots))

    def time_at_distance_s(self, distance_m: F64) -> F64:
        """(m,) time at which a length was driven."""
        knots = np.concatenate([[0.0], np.cumsum(np.abs(self.twists[:, 0]) * np.diff(self.times_s))])
        return np.asarray(np.interp(distance_m, knots, self.times_s))

    def _along(self, begins: F64, times_s: F64) -> F64:
        """Poses at some times on pieces that begin there."""
        times = np.clip(times_s, self.times_s[0], self.times_s[-1])
        piece = self._piece(times)
        return _advance(begins[piece], self.twists[piece], times - self.times_s[piece])

    def _piece(self, times_s: F64) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
        """Which piece each time falls into."""
        found = np.searchsorted(self.times_s, times_s, side="right") - 1
        return np.clip(found, 0, len(self.twists) - 1).astype(np.int64)


def plan_drive(robot: Robot) -> Drive:
    """Turn the steps of a robot's path into pieces of constant twist."""
    pieces = [piece for piece in _pieces(robot) if piece.seconds > 0.0] or [Piece(0.0, 0.0, 1e-3)]
    twists = np.array([(piece.speed_mps, piece.turn_rate) for piece in pieces])
    durations = np.array([piece.seconds for piece in pieces])
    poses, rolled = np.empty((len(pieces), 3)), np.empty((len(pieces), 3))
    poses[0] = rolled[0] = _first_pose(robot)
    for number in range(1, len(pieces)):
        for begins in (poses, rolled):
            begins[number] = _advance(begins[number - 1], twists[number - 1], durations[number - 1])
        put = pieces[number].put
        if put is not None:
            poses[number] = put
    return Drive(
        np.concatenate([[0.0], np.cumsum(durations)]),
        poses,
        twists,
        np.array([piece.is_recorded for piece in pieces], dtype=bool),
        np.array([piece.put is not None for piece in pieces], dtype=bool),
        rolled,
    )


def _advance(poses: F64, twists: F64, seconds: F64) -> F64:
    """Move along an arc of constant twist; shapes (..., 3), (..., 2), (...)."""
    turn = twists[..., 1] * seconds
    length = twists[..., 0] * seconds
    middle = poses[..., 2] + 0.5 * turn
    chord = length * np.sinc(turn / (2.0 * np.pi))
    x = poses[..., 0] + chord * np.cos(middle)
    y = poses[..., 1] + chord * np.sin(middle)
    return np.stack([x, y, poses[..., 2] + turn], axis=-1)


def _first_pose(robot: Robot) -> F64:
    """Where the robot stands at first: looking along its first leg."""
    start = robot.path[0].to
    assert start is not None
    for step in robot.path[1:]:
        if step.to is not None and step.to != start:
            heading = math.atan2(step.to[1] - start[1], step.to[0] - start[0])
            return np.array([*start, heading + (math.pi if step.backwards else 0.0)])
    return np.array([*start, 0.0])


class Piece(NamedTuple):
    """What the robot does for a while; *put* is where it is held meanwhile by somebody who carries it."""

    speed_mps: float
    turn_rate: float
    seconds: float
    is_recorded: bool = True
    put: tuple[float, float, float] | None = None


def _pieces(robot: Robot) -> Iterator[Piece]:
    """Yield the pieces of the whole path, in order."""
    x, y, yaw = _first_pose(robot)
    rate = math.radians(robot.turn_rate_degps)
    steps = robot.path
    cut = 0.0
    for number, step in enumerate(steps):
        if step.to is not None and math.hypot(step.to[0] - x, step.to[1] - y) > 1e-9:
            length = math.hypot(step.to[0] - x, step.to[1] - y)
            heading = math.atan2(step.to[1] - y, step.to[0] - x) + (math.pi if step.backwards else 0.0)
            turn = math.remainder(heading - yaw, 2.0 * math.pi)
            if cut == 0.0:
                yield Piece(0.0, math.copysign(rate, turn), abs(turn) / rate)
            sign = -1.0 if step.backwards else 1.0
            following = steps[number + 1] if number + 1 < len(steps) else None
            next_cut = _cut_length(robot, (x, y), step.to, step, following)
            straight = length - cut - next_cut
            yield Piece(sign * robot.speed_mps, 0.0, straight / robot.speed_mps)
            (x, y), yaw = step.to, heading
            if next_cut > 0.0:
                assert following is not None and following.to is not None
                yield _arc(robot, (x, y), yaw, following.to, next_cut)
                yaw = math.atan2(following.to[1] - y, following.to[0] - x)
            cut = next_cut
        yield Piece(0.0, 0.0, step.wait_s)
        yield Piece(0.0, 0.0, step.off_s, is_recorded=False)
        if step.carried_to is not None:
            target = (*step.carried_to[:2], math.radians(step.carried_to[2]))
            yield from _carried((x, y, yaw), target, step.carried_s)
            x, y, yaw = target


def _carried(
    begin: tuple[float, float, float], end: tuple[float, float, float], seconds: float
) -> Iterator[Piece]:
    """From one pose straight to another in somebody's hands, held for a moment at a time."""
    turn = math.remainder(end[2] - begin[2], 2.0 * math.pi)
    count = max(round(seconds / _HELD_S), 1)
    for number in range(1, count + 1):
        share = number / count
        put = (
            begin[0] + share * (end[0] - begin[0]),
            begin[1] + share * (end[1] - begin[1]),
            begin[2] + share * turn,
        )
        yield Piece(0.0, 0.0, max(seconds / count, _SHORTEST_S), put=put)


def _cut_length(
    robot: Robot, here: tuple[float, float], corner: tuple[float, float], step: Step, following: Step | None
) -> float:
    """How much of both legs a rounded corner takes; 0 where the robot stops, reverses or turns back."""
    if (
        following is None
        or following.to is None
        or step.wait_s
        or step.off_s
        or step.carried_to is not None
        or step.backwards
        or following.backwards
    ):
        return 0.0
    before = math.hypot(corner[0] - here[0], corner[1] - here[1])
    after = math.hypot(following.to[0] - corner[0], following.to[1] - corner[1])
    if after <= 1e-9:
        return 0.0
    angle = _corner_angle(here, corner, following.to)
    if not 1e-6 < abs(angle) < math.radians(150.0):
        return 0.0
    return min(robot.corner_m, 0.45 * before, 0.45 * after)


def _corner_angle(
    here: tuple[float, float], corner: tuple[float, float], target: tuple[float, float]
) -> float:
    """Signed turn at a corner."""
    incoming = math.atan2(corner[1] - here[1], corner[0] - here[0])
    outgoing = math.atan2(target[1] - corner[1], target[0] - corner[0])
    return math.remainder(outgoing - incoming, 2.0 * math.pi)


def _arc(
    robot: Robot, corner: tuple[float, float], yaw: float, target: tuple[float, float], cut: float
) -> Piece:
    """The arc that rounds a corner, as slow as the turn rate asks for."""
    outgoing = math.atan2(target[1] - corner[1], target[0] - corner[0])
    angle = math.remainder(outgoing - yaw, 2.0 * math.pi)
    radius = cut / math.tan(abs(angle) / 2.0)
    speed = min(robot.speed_mps, math.radians(robot.turn_rate_degps) * radius)
    return Piece(speed, math.copysign(speed / radius, angle), radius * abs(angle) / speed)
