"""The state of the world: a belief for every sub-map, kept between looks, and shown in the map."""

from __future__ import annotations

import numpy as np

from dynmap_cli.arrays import F64
from dynmap_cli.localization.beliefs.priors import prior_at
from dynmap_cli.localization.beliefs.transitions import predict_belief
from dynmap_cli.localization.sensing.map_pool import MapPool

REPAINT_ABOVE = 0.01
"""Smaller changes of a probability are not worth painting."""


class World:
    """What is believed, and when it was last looked at; the map of the pool shows it."""

    def __init__(self, pool: MapPool) -> None:
        self._pool = pool
        self._beliefs = [self.alike(number) for number in range(len(pool.submaps))]
        self._painted = list(self._beliefs)
        self._rectangles_m = [submap.rectangle_m for submap in pool.submaps]
        self._stamps_ns: list[int | None] = [None] * len(pool.submaps)

    def belief(self, number: int, stamp_ns: int) -> F64:
        """Belief (n_states,) at some time, without looking."""
        last = self._stamps_ns[number]
        if last is None:
            return prior_at(self._pool.submaps[number].prior, stamp_ns)
        seconds = max(stamp_ns - last, 0) * 1e-9
        return predict_belief(self._beliefs[number], self._pool.submaps[number], seconds)

    def alike(self, number: int) -> F64:
        """All states (n_states,) alike: what somebody believes who has never been here."""
        n_states = self._pool.submaps[number].n_states
        return np.full(n_states, 1.0 / n_states)

    def learn(self, number: int, stamp_ns: int, belief: F64) -> None:
        """Note the belief after looking."""
        self._beliefs[number], self._stamps_ns[number] = belief, stamp_ns

    def show(self, numbers: list[int], stamp_ns: int) -> None:
        """Paint what is believed of some sub-maps into the map."""
        for number in numbers:
            belief = self.belief(number, stamp_ns)
            if np.abs(belief - self._painted[number]).max() > REPAINT_ABOVE:
                self._pool.paint(number, belief)
                self._painted[number] = belief

    def likeliest(self, numbers: list[int], stamp_ns: int) -> dict[int, int]:
        """Index of the likeliest state of some sub-maps."""
        return {number: int(np.argmax(self.belief(number, stamp_ns))) for number in numbers}

    def near(self, point_m: F64, within_m: float) -> list[int]:
        """Indices of the sub-maps whose rectangle is within reach of a point."""
        found = []
        x, y = point_m.tolist()
        for number, (x0, y0, x1, y1) in enumerate(self._rectangles_m):
            dx = max(x0 - x, x - x1, 0.0)
            dy = max(y0 - y, y - y1, 0.0)
            if dx * dx + dy * dy <= within_m * within_m:
                found.append(number)
        return found
