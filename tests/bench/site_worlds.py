"""Scenarios of large sites, drawn from a seed: blocks between long corridors, and houses on a campus."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dynmap_cli.arrays import F64

Crossings = Sequence[tuple[int, int]]
"""Way from crossing to crossing: column and row in the grid of streets."""

_BLOCK_M, _CORRIDOR_M = (42.0, 32.0), 2.6
_NICHES_M = (0.15, 0.25, 0.4)
_PLOT_M = (55.0, 50.0)
_STREET_M = 2.5
_M2_PER_LEG = 120.0
"""One tree or lamp in so many square metres."""
_EDGE_M = 10.0


def corridors(seed: int, blocks: tuple[int, int], way: Crossings) -> dict[str, Any]:
    """Columns and rows of blocks between corridors of 2.6 m; walls have niches, as of doors, at random places."""
    random = np.random.default_rng(seed)
    pitch = np.add(_BLOCK_M, _CORRIDOR_M)
    walls = []
    for column, row in np.ndindex(*blocks):
        low = pitch * (column, row)
        walls += [_with_niches(wall, random) for wall in _sides(low, low + _BLOCK_M)]
    outside = _sides(np.full(2, -_CORRIDOR_M), pitch * blocks)
    walls += [_with_niches(wall[::-1], random) for wall in outside[::-1]]
    return {
        "seed": seed,
        "turn_deg": 7,
        "world": {"walls": walls, "routes": _streets(pitch, -_CORRIDOR_M / 2 * np.ones(2), blocks)},
        "movers": [{"does": "wander", "count": 20}],
        "robot": {
            "path": [_listed(pitch * crossing - _CORRIDOR_M / 2) for crossing in way],
            "speed_mps": 0.8,
            "corner_m": 1.0,
        },
        "lasers": [
            {
                "beams": 180,
                "fov_deg": 180,
                "max_range_m": 50,
                "rate_hz": 5,
                "grazing_deg": 3,
                "dropout_share": 0.01,
            }
        ],
        "odometry": _odometry(translation_scale=1.02, rotation_scale=0.98, bias_degpm=0.4),
    }


def campus(seed: int, plots: tuple[int, int], way: Crossings) -> dict[str, Any]:
    """Columns and rows of plots, on each a house askew with bays, and trees and lamps beside the streets."""
    random = np.random.default_rng(seed)
    pitch = np.array(_PLOT_M)
    houses = [_house(pitch * plot, random) for plot in np.ndindex(*plots)]
    low, high = -pitch / 2 - _EDGE_M, pitch * (np.array(plots) - 0.5) + _EDGE_M
    legs = []
    for _ in range(int(np.prod(high - low) / _M2_PER_LEG)):
        at = random.uniform(low, high)
        past_street = (at + pitch / 2) % pitch
        if np.minimum(past_street, pitch - past_street).min() > _STREET_M:
            legs.append({"at": _listed(at), "radius_m": round(random.uniform(0.1, 0.3), 3)})
    return {
        "seed": seed,
        "world": {"walls": houses, "legs": legs, "routes": _streets(pitch, -pitch / 2, plots)},
        "movers": [{"does": "wander", "count": 20}],
        "robot": {
            "path": [_listed(pitch * crossing - pitch / 2) for crossing in way],
            "speed_mps": 1.0,
            "corner_m": 1.5,
        },
        "lasers": [
            {
                "beams": 361,
                "fov_deg": 180,
                "max_range_m": 80,
                "rate_hz": 5,
                "grazing_deg": 2,
                "dropout_share": 0.02,
            }
        ],
        "odometry": _odometry(translation_scale=1.03, rotation_scale=0.97, bias_degpm=0.2),
    }


def _odometry(**errors: float) -> Mapping[str, Any]:
    """Wheels that slip in turns, once in 200 m."""
    return {"rate_hz": 20, "slips_per_100m": 0.5, **errors}


def _sides(low: F64, high: F64) -> list[tuple[F64, F64]]:
    """Sides of a rectangle, counter-clockwise."""
    corners = [low, np.array([high[0], low[1]]), high, np.array([low[0], high[1]])]
    return list(zip(corners, [*corners[1:], corners[0]], strict=True))


def _with_niches(ends: tuple[F64, F64], random: np.random.Generator) -> list[list[float]]:
    """A wall with niches of about 1 m to its left."""
    begin, end = ends
    length_m = float(np.linalg.norm(end - begin))
    along = (end - begin) / length_m
    left = np.array([-along[1], along[0]])
    points = [begin]
    at_m = random.uniform(2, 6)
    while at_m < length_m - 2:
        width_m, depth_m = random.uniform(0.9, 1.2), random.choice(_NICHES_M)
        near, far = begin + along * at_m, begin + along * (at_m + width_m)
        points += [near, near + left * depth_m, far + left * depth_m, far]
        at_m += width_m + random.exponential(4) + 1.5
    return [_listed(point) for point in [*points, end]]


def _house(middle: F64, random: np.random.Generator) -> dict[str, Any]:
    """Walls of a house with a bay and a notch."""
    middle = middle + random.uniform(-4, 4, 2)
    x, y = random.uniform(18, 34) / 2, random.uniform(14, 28) / 2
    turn = random.uniform(-0.15, 0.15)
    corners = [
        (-x, -y), (-x / 3, -y), (-x / 3, -y - 2), (x / 3, -y - 2), (x / 3, -y),
        (x, -y), (x, y), (0, y), (0, y - 3), (-x, y - 3),
    ]  # fmt: skip
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return {"points": [_listed(rotation @ corner + middle) for corner in corners], "closed": True}


def _streets(pitch: F64, origin: F64, count: tuple[int, int]) -> list[list[list[float]]]:
    """Every second street, from end to end: where people go."""
    columns, rows = count
    across = [[(0, row), (columns, row)] for row in range(0, rows + 1, 2)]
    along = [[(column, 0), (column, rows)] for column in range(0, columns + 1, 2)]
    return [[_listed(origin + pitch * crossing) for crossing in street] for street in [*across, *along]]


def _listed(point: F64) -> list[float]:
    """A point as it stands in a scenario: to the millimetre."""
    return [round(float(value), 3) for value in point]
