"""When doors and boxes take which state."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import B1, F64, I32
from dynmap_cli.simulation.driving import Drive
from dynmap_cli.simulation.randomness import stream
from dynmap_cli.simulation.scenario import Changing, Process, World
from dynmap_cli.simulation.shapes import object_centers


@dataclass(frozen=True, slots=True)
class History:
    """The states of one object over time.

    Attributes
    ----------
    name : str
    state_names : tuple of str
    times_s : (n,) float64
        When each state begins, seconds since the start; the first is 0.
    states : (n,) int32
        Index into *state_names*.
    """

    name: str
    state_names: tuple[str, ...]
    times_s: F64
    states: I32

    def at(self, times_s: F64) -> I32:
        """(m,) state at each time."""
        return np.asarray(self.states[np.searchsorted(self.times_s, times_s, side="right") - 1])


def histories(world: World, drive: Drive, seed: int) -> list[History]:
    """States over time of all doors and boxes, in the order of their numbers."""
    centers = object_centers(world)
    seconds = np.arange(np.ceil(drive.duration_s) + 1.0)
    robot, awake = drive.at(seconds)[:, :2], drive.is_recorded(seconds)
    result = []
    for number, thing in enumerate((*world.doors, *world.boxes)):
        if thing.process is None:
            events = _scheduled(thing)
        else:
            draw = stream(seed, f"changes of {thing.name}")
            near = awake & (np.linalg.norm(robot - centers[number], axis=1) < thing.process.near_m)
            events = _drawn(thing.process, len(thing.state_names), near, draw)
        times, states = zip(*events, strict=True)
        result.append(
            History(
                thing.name, thing.state_names, np.array(times, dtype=np.float64), np.array(states, np.int32)
            )
        )
    return result


def _scheduled(thing: Changing) -> list[tuple[float, int]]:
    """Events of a schedule, in order of time; the first state holds until the first."""
    events = sorted((time, thing.state_names.index(state)) for time, state in thing.schedule)
    if not events or events[0][0] > 0.0:
        events.insert(0, (0.0, 0))
    return events


def _drawn(process: Process, n_states: int, near: B1, draw: np.random.Generator) -> list[tuple[float, int]]:
    """Events at exponential times, put off to the next second in which the condition holds."""
    allowed = {"always": np.ones_like(near), "near": near, "away": ~near}[process.when]
    seconds = np.flatnonzero(allowed)
    state = int(draw.integers(n_states))
    events, time = [(0.0, state)], 0.0
    while n_states > 1:
        time += float(draw.exponential(process.mean_s))
        state = int((state + 1 + draw.integers(n_states - 1)) % n_states)
        later = np.searchsorted(seconds, np.ceil(max(time, events[-1][0] + 1.0)))
        if later >= seconds.size:
            break
        time = float(seconds[later])
        events.append((time, state))
    return events
