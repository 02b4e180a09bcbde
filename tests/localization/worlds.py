"""Small simulated worlds, with the patch maps that a perfect mapper would make of them."""

from __future__ import annotations

import itertools
import math

import numpy as np

from dynmap_cli.domain.grid import OCCUPIED, GridFrame, OccupancyGrid
from dynmap_cli.domain.patches import Patch, PatchSet
from dynmap_cli.domain.poses import compose, inverse
from dynmap_cli.simulation.run import SimulatedRun, simulate
from dynmap_cli.simulation.scenario import Box, Door, parse_scenario

STAY_PROBABILITY = math.exp(-60.0 / 300.0)


def office(seed=0, path=None, door=None, boxes=(), movers=(), **extra):
    """Two rooms and a corridor, joined by a door that is closed at first and open from 40 s on."""
    return parse_scenario(
        {
            "seed": seed,
            "world": {
                "walls": [
                    {"points": [[0, 0], [14, 0], [14, 9], [0, 9]], "closed": True},
                    [[0, 4], [3, 4]],
                    [[4, 4], [9, 4]],
                    [[10, 4], [14, 4]],
                    [[6, 4], [6, 9]],
                    [[1, 6.5], [2.5, 6.5], [2.5, 8]],
                    [[11, 1.2], [11, 2.2]],
                ],
                "doors": [
                    door
                    or {
                        "name": "door",
                        "hinge": [3, 4],
                        "latch": [4, 4],
                        "schedule": [[0, "closed"], [40, "open"]],
                    }
                ],
                "boxes": list(boxes),
            },
            "movers": list(movers),
            "robot": {
                "path": path or [[1.5, 2], [8, 1.5], [12.5, 2.8], [8, 2], [2, 2], [6, 1], [1, 1.5]],
                "speed_mps": 0.6,
            },
            "lasers": [{"fov_deg": 180, "beams": 181, "max_range_m": 30, "noise_m": 0.02, "rate_hz": 5}],
            **extra,
        }
    )


def corridor(state="closed", length_m=20.0, path=((0.7, 1.0), (19.3, 1.0))):
    """A bare corridor that looks the same from both ends while its two doors are shut; the left one is in *state*."""
    walls = [
        [[0, 0], [4, 0]],
        [[5, 0], [12, 0]],
        [[13, 0], [length_m, 0], [length_m, 2], [0, 2], [0, 0]],
        *([[x - 1, 0], [x - 1, -2.5], [x + 2, -2.5], [x + 2, 0]] for x in (4, 12)),
    ]
    closed_open = {"states": {"closed": 0, "open": -85}}
    doors = [
        {"name": "left", "hinge": [4, 0], "latch": [5, 0], **closed_open, "schedule": [[0, state]]},
        {"name": "right", "hinge": [12, 0], "latch": [13, 0], **closed_open, "schedule": [[0, "closed"]]},
    ]
    return parse_scenario(
        {
            "world": {"walls": walls, "doors": doors},
            "robot": {"path": [list(point) for point in path], "speed_mps": 0.8},
            "lasers": [{"beams": 181, "fov_deg": 270, "max_range_m": 8, "rate_hz": 5}],
        }
    )


def simulated(scenario) -> SimulatedRun:
    return simulate(scenario)


def map_frame_poses(run: SimulatedRun):
    return run.true_poses


def patch_sets_of(run: SimulatedRun, margin_m=0.2, stay_probability=STAY_PROBABILITY):
    """One sub-map per door or box, one patch per state, drawn from the scenario's own geometry."""
    world, grid = run.scenario.world, run.true_map
    objects = [*world.doors, *world.boxes]
    sets = []
    for number, thing in enumerate(objects):
        outlines = [_outline(thing, name) for name in thing.state_names]
        corners = np.concatenate([outline for outline in outlines if outline.size])
        frame = _aligned(corners, margin_m, grid.frame)
        static = _cut(grid, frame) == OCCUPIED
        patches = []
        for k, outline in enumerate(outlines):
            values = np.where(static, 0.95, 0.02).astype(np.float32)
            if outline.size:
                cells = frame.to_cells(outline)
                values[cells[:, 0], cells[:, 1]] = 0.8
            patches.append(Patch(k, 5, values))
        varying = np.ptp(np.stack([p.reflectance for p in patches]), axis=0) > 0.5
        sets.append(PatchSet(number, frame, varying, tuple(patches), stay_probability))
    return sets


def _outline(thing, name):
    """(n, 2) points every 2 cm along what the object looks like in one state."""
    if isinstance(thing, Door):
        hinge, latch = np.array(thing.hinge, float), np.array(thing.latch, float)
        angle = math.radians(thing.states[name])
        c, s = math.cos(angle), math.sin(angle)
        leaf = np.array([[c, -s], [s, c]]) @ (latch - hinge)
        return hinge + np.linspace(0, 1, 60)[:, None] * leaf
    assert isinstance(thing, Box)
    if name == "absent":
        return np.empty((0, 2))
    w, h = thing.size_m
    x, y, yaw = thing.places[name]
    corners = np.array([[-w, -h], [w, -h], [w, h], [-w, h], [-w, -h]]) / 2
    c, s = math.cos(math.radians(yaw)), math.sin(math.radians(yaw))
    corners = corners @ np.array([[c, s], [-s, c]]) + [x, y]
    t = np.linspace(0, 1, 100)[:, None]
    return np.concatenate([a + t * (b - a) for a, b in itertools.pairwise(corners)])


def _aligned(points, margin_m, frame: GridFrame) -> GridFrame:
    low = frame.to_cells(points.min(axis=0) - margin_m)
    high = frame.to_cells(points.max(axis=0) + margin_m)
    rows, cols = (high - low + 1).tolist()
    return frame.window(int(low[0]), int(low[1]), rows, cols)


def _cut(grid: OccupancyGrid, frame: GridFrame):
    row = round((frame.origin_y_m - grid.frame.origin_y_m) / frame.resolution_m)
    col = round((frame.origin_x_m - grid.frame.origin_x_m) / frame.resolution_m)
    return grid.cells[row : row + frame.rows, col : col + frame.cols]


def pose_errors(poses, true_poses):
    """(n,) metres and (n,) degrees."""
    delta = compose(inverse(true_poses), poses)
    return np.hypot(delta[:, 0], delta[:, 1]), np.degrees(np.abs(delta[:, 2]))
