"""A drive through a room that its sweeps show, for what can only be told from sweeps that agree with one another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.ingest.written import World

_WALLS = np.array(
    [
        *[(-6, -4, 6, -4), (6, -4, 6, 5), (6, 5, -2, 5), (-2, 5, -2, 3), (-2, 3, -6, 3), (-6, 3, -6, -4)],
        *[(2, 2.5, 3, 2.5), (3, 2.5, 3, 3.5), (3, 3.5, 2, 3.5), (2, 3.5, 2, 2.5)],
        *[(-4.5, -3, -4, -3), (-4, -3, -4, -2.2), (4, -3, 5, -2)],
    ],
    dtype=np.float64,
)
"""From x, y to x, y, metres."""


@dataclass
class Room(World):
    """Turns one way and the other on a winding way around the room; beams are those of the laser at its place."""

    n_scans: int = 120
    n_beams: int = 121
    first_rad: float = -2.1
    step_rad: float = 0.035
    range_max_m: float = 20.0

    @property
    def poses(self) -> np.ndarray:
        """As the wheels tell it, (n, 3)."""
        return self.poses_at(np.arange(self.n_scans + self.skipped))[self.skipped :]

    @staticmethod
    def poses_at(numbers: np.ndarray) -> np.ndarray:
        """Poses (n, 3) at numbers of scans."""
        time_s = 0.1 * numbers
        yaw_rad = 1.4 * np.sin(0.9 * time_s) + 0.5 * np.sin(0.23 * time_s)
        steps = 0.03 * np.column_stack([np.cos(yaw_rad), np.sin(yaw_rad)])
        return np.column_stack([np.cumsum(steps, axis=0), yaw_rad])

    @property
    def ranges_m(self) -> np.ndarray:
        """(n, n_beams) with a millimetre or so of noise."""
        x, y, yaw = self.poses.T
        at_x, at_y = self.mounting[:2]
        starts = np.column_stack(
            [x + at_x * np.cos(yaw) - at_y * np.sin(yaw), y + at_x * np.sin(yaw) + at_y * np.cos(yaw)]
        )
        angles = yaw[:, None] + self.first_rad + self.step_rad * np.arange(self.n_beams)
        return seen_from(starts, angles) + np.random.default_rng(5).normal(0.0, 0.003, angles.shape).astype(
            np.float32
        )


def seen_from(starts: np.ndarray, angles: np.ndarray, walls: np.ndarray = _WALLS) -> np.ndarray:
    """Distances (n, n_beams) to the nearest wall from places (n, 2) in directions (n, n_beams)."""
    nearest = np.full(angles.shape, np.inf)
    along = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    for x0, y0, x1, y1 in walls:
        wall = np.array([x1 - x0, y1 - y0])
        to_wall = np.array([x0, y0]) - starts[:, None, :]
        across = along[..., 0] * wall[1] - along[..., 1] * wall[0]
        with np.errstate(all="ignore"):
            range_m = (to_wall[..., 0] * wall[1] - to_wall[..., 1] * wall[0]) / across
            share = (to_wall[..., 0] * along[..., 1] - to_wall[..., 1] * along[..., 0]) / across
        is_hit = (range_m > 0.0) & (share >= 0.0) & (share <= 1.0)
        nearest = np.where(is_hit & (range_m < nearest), range_m, nearest)
    return nearest.astype(np.float32)
