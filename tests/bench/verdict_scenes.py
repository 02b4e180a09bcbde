"""Offices in which a robot is well, among people, in changed surroundings, or lost; what is true at each scan."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dynmap_cli.arrays import B1, F64
from dynmap_cli.domain.grid import FREE, OCCUPIED, OccupancyGrid
from dynmap_cli.domain.poses import compose, wrap_angle
from dynmap_cli.simulation.driving import plan_drive
from dynmap_cli.simulation.run import SimulatedRun, simulate
from dynmap_cli.simulation.scenario import (
    Accompany,
    Box,
    Door,
    Scenario,
    Wall,
    Wander,
    World,
    parse_scenario,
)
from dynmap_cli.simulation.sensing import FIRST_OBJECT
from dynmap_cli.simulation.shapes import shapes_of
from dynmap_cli.simulation.worlds.expand import expand

WELL = ("fine", "crowd", "new objects", "removed walls")
LOST = ("lost near", "lost far", "lost in a crowd")
KINDS = (*WELL, *LOST)
PATH_M = 45.0
PEOPLE, WANDERERS = 6, 25
STAYS_S = 5.0
OFFICE_M = (36.0, 25.0)
LEAST_BEAMS, LEAST_SINE = 3, math.sin(math.radians(20.0))
"""A thing is in view that three beams meet; a gap in a wall that three pass at 20 degrees or more."""


@dataclass(frozen=True)
class Scene:
    """One recording and the map it is localized in.

    Attributes
    ----------
    run : SimulatedRun
    grid : OccupancyGrid
        The map; it may hold walls and shut doors that are not there any more.
    start : (3,) float64
        Where the robot is said to be at the first scan.
    shifted_share : (n_scans,) float64
        Share of the returns of each scan that end on something that the map has not, or came through a wall
        that only the map has, and of which the robot has seen something for five seconds.
    """

    run: SimulatedRun
    grid: OccupancyGrid
    start: F64
    shifted_share: F64


def make_scene(kind: str, seed: int) -> Scene:
    """Draw an office and what is different from its map."""
    draw = np.random.default_rng([seed, KINDS.index(kind)])
    base = _office(seed, draw)
    path = plan_drive(base.robot)
    way = path.at(np.arange(0.0, path.duration_s, 0.2))[:, :2]
    gone: list[F64] = []
    world = base.world
    shut = {door.name for door in world.doors if draw.random() < 0.5}
    if kind == "removed walls":
        shut = {door.name for door in world.doors}
        walls, gone = _without_pieces(list(world.walls), way, int(draw.integers(1, 4)), draw)
        world = world.model_copy(update={"walls": tuple(walls)})
    is_open = kind == "removed walls"
    doors = tuple(_fixed(door, door.name in shut and not is_open) for door in world.doors)
    boxes: tuple[Box, ...] = ()
    if kind == "new objects":
        boxes = tuple(_new_boxes(base.world, way, int(draw.integers(1, 9)), draw))
    world = world.model_copy(update={"doors": doors, "boxes": boxes})
    movers: tuple[Wander | Accompany, ...] = (Wander(count=2, pause_share=0.0),)
    if kind in ("crowd", "lost in a crowd"):
        movers = (Wander(count=WANDERERS, pause_share=0.0), Accompany(count=PEOPLE))
    run = simulate(base.model_copy(update={"world": world, "movers": movers}))
    leaves = [leaf for door in base.world.doors if (leaf := _leaf(door, door.name in shut)) is not None]
    grid = _with_walls(run.true_map, [*gone, *leaves])
    opened = [*gone, *leaves] if is_open else []
    is_new = np.array([is_open] * len(doors) + [True] * len(boxes), dtype=bool)
    return Scene(run, grid, _start(kind, run, grid, draw), _shifted(run, is_new, opened))


def pose_is(found: F64, true: F64, within_m: float, within_deg: float) -> B1:
    """(n,) which poses are that close to the true ones."""
    apart = np.hypot(*(found - true)[:, :2].T)
    turned = np.degrees(np.abs(wrap_angle(found[:, 2] - true[:, 2])))
    return np.asarray((apart <= within_m) & (turned <= within_deg))


def _office(seed: int, draw: np.random.Generator) -> Scenario:
    """An office of its own, and some way along its corridors and into its rooms."""
    length, width = OFFICE_M
    size = [round(length * draw.uniform(0.8, 1.1), 1), round(width * draw.uniform(0.8, 1.1), 1)]
    content = {
        "seed": seed,
        "generate": {"kind": "office", "size_m": size, "boxes": 0, "people": 0},
        "robot": {"speed_mps": 0.8},
        "lasers": [{"beams": 181, "fov_deg": 180, "max_range_m": 25, "rate_hz": 5, "noise_m": 0.015}],
    }
    base = expand(parse_scenario(content))
    steps = [step for step in base.robot.path if step.to is not None]
    steps = steps[int(draw.integers(len(steps))) :] + steps
    kept, length_m = [steps[0]], 0.0
    for before, after in pairwise(steps):
        if length_m >= PATH_M:
            break
        apart = math.dist(before.to, after.to)
        if apart > 0.1:
            kept.append(after)
            length_m += apart
    return base.model_copy(update={"robot": base.robot.model_copy(update={"path": tuple(kept)})})


def _fixed(door: Door, is_shut: bool) -> Door:
    """The door in one state for good."""
    name = door.state_names[0 if is_shut else -1]
    return door.model_copy(update={"process": None, "schedule": ((0.0, name),)})


def _without_pieces(
    walls: list[Wall], way: F64, count: int, draw: np.random.Generator
) -> tuple[list[Wall], list[F64]]:
    """Tear pieces of one to three metres out of straight walls near the way; returns walls and pieces."""
    gone: list[F64] = []
    for _ in range(200):
        if len(gone) == count:
            break
        number = int(draw.integers(len(walls)))
        wall = walls[number]
        if wall.closed or len(wall.points) != 2:
            continue
        start, end = np.array(wall.points)
        length = float(np.hypot(*(end - start)))
        piece = draw.uniform(1.0, 3.0)
        at = draw.uniform(0.3, max(length - piece - 0.3, 0.31))
        along = (end - start) / length
        cut = np.stack([start + at * along, start + (at + piece) * along])
        if length < piece + 0.8 or np.hypot(*(way - cut.mean(axis=0)).T).min() > 3.0:
            continue
        parts = [(start, cut[0]), (cut[1], end)]
        walls[number : number + 1] = [
            Wall(points=tuple(map(tuple, np.round(part, 3).tolist()))) for part in parts
        ]
        gone.append(cut)
    return walls, gone


def _leaf(door: Door, is_shut: bool) -> F64 | None:
    """Both ends of the leaf of a door; none where it slid into the wall."""
    hinge, latch = np.array(door.hinge), np.array(door.latch)
    if not is_shut and door.kind == "sliding":
        return None
    angle = 0.0 if is_shut else math.radians(door.states[door.state_names[-1]])
    cos, sin = math.cos(angle), math.sin(angle)
    return np.stack([hinge, hinge + np.array([[cos, -sin], [sin, cos]]) @ (latch - hinge)])


def _new_boxes(world: World, way: F64, count: int, draw: np.random.Generator) -> list[Box]:
    """Boxes beside the way, clear of the walls."""
    boxes: list[Box] = []
    corners = shapes_of(world).segments
    along = np.linspace(0.0, 1.0, 50)[:, None, None]
    walls = (corners[:, :2] + along * (corners[:, 2:] - corners[:, :2])).reshape(-1, 2)
    for _ in range(400):
        if len(boxes) == count:
            break
        size = draw.uniform(0.4, 1.2, 2)
        center = way[int(draw.integers(len(way)))] + draw.uniform(-2.5, 2.5, 2)
        reach_m = 0.5 * float(np.hypot(*size))
        if min(np.hypot(*(way - center).T).min() - 0.4, np.hypot(*(walls - center).T).min()) < reach_m:
            continue
        place = (*np.round(center, 2).tolist(), round(float(draw.uniform(0, 180)), 1))
        name = f"new_{len(boxes)}"
        boxes.append(Box(name=name, size_m=tuple(size.round(2).tolist()), places={"a": place}, absent=False))
    return boxes


def _with_walls(grid: OccupancyGrid, pieces: list[F64]) -> OccupancyGrid:
    """The map with further walls, each from one point to another."""
    cells = np.array(grid.cells)
    for start, end in pieces:
        count = int(np.ceil(np.hypot(*(end - start)) / grid.frame.resolution_m * 10)) + 2
        rows, cols = grid.frame.to_cells(start + np.linspace(0, 1, count)[:, None] * (end - start)).T
        cells[rows, cols] = OCCUPIED
    return OccupancyGrid(grid.frame, cells)


def _start(kind: str, run: SimulatedRun, grid: OccupancyGrid, draw: np.random.Generator) -> F64:
    """The true pose, or a wrong one where a robot can stand."""
    true = run.true_poses[0]
    if kind in WELL:
        return true
    for _ in range(1000):
        if kind == "lost near":
            away, towards = draw.uniform(1.0, 3.0), draw.uniform(-math.pi, math.pi)
            turn = math.radians(draw.uniform(-40.0, 40.0))
            pose = true + np.array([away * math.cos(towards), away * math.sin(towards), turn])
        else:
            free = np.argwhere(grid.cells == FREE)
            point = grid.frame.to_points(free[int(draw.integers(len(free)))])
            pose = np.array([*point, draw.uniform(-math.pi, math.pi)])
            if np.hypot(*(pose - true)[:2]) < 5.0:
                continue
        cell = grid.frame.to_cells(pose[:2])
        window = grid.cells[max(cell[0] - 4, 0) : cell[0] + 5, max(cell[1] - 4, 0) : cell[1] + 5]
        if window.size == 81 and (window == FREE).all():
            return np.array([*pose[:2], float(wrap_angle(np.asarray(pose[2])))])
    return np.asarray(true)


def _shifted(run: SimulatedRun, is_new: B1, opened: list[F64]) -> F64:
    """Share of the returns of each scan that show what is not on the map, once it was in view for five seconds."""
    log = run.log
    hits = np.isfinite(log.ranges_m)
    causes = np.full(log.ranges_m.shape, -1)
    thing = run.beam_class.astype(np.int64) - FIRST_OBJECT
    known = (thing >= 0) & hits
    causes[known] = np.where(is_new[thing[known]], thing[known], -1) if is_new.size else -1
    sensors = compose(run.true_poses, log.sensor_poses[0])
    angles = sensors[:, 2:] + log.bearings_rad[0]
    ends = np.where(hits, log.ranges_m, 0.0)[..., None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    for number, (start, end) in enumerate(opened):
        crossed = _crosses(sensors[:, None, :2], ends, start, end) & hits
        along = math.atan2(*(end - start)[::-1])
        crossed &= np.abs(np.sin(angles - along)) >= LEAST_SINE
        causes[crossed] = is_new.size + number
    shares = np.zeros(log.n_scans)
    n_hits = np.maximum(hits.sum(axis=1), 1)
    seconds = (log.stamps_ns - log.stamps_ns[0]) * 1e-9
    for cause in range(is_new.size + len(opened)):
        seen = (causes == cause).sum(axis=1)
        since, last = math.inf, -math.inf
        for scan in range(log.n_scans):
            if seen[scan] < LEAST_BEAMS:
                continue
            if seconds[scan] - last > 2.0:
                since = seconds[scan]
            last = seconds[scan]
            if last - since >= STAYS_S:
                shares[scan] += seen[scan] / n_hits[scan]
    return shares


def _crosses(origins: F64, rays: F64, start: F64, end: F64) -> B1:
    """Which rays (n, m, 2) from (n, 1, 2) end more than 30 cm behind the segment that they cross."""
    along = end - start
    cross = rays[..., 0] * along[1] - rays[..., 1] * along[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = start - origins
        t = (offset[..., 0] * along[1] - offset[..., 1] * along[0]) / cross
        u = (offset[..., 0] * rays[..., 1] - offset[..., 1] * rays[..., 0]) / cross
    length = np.hypot(rays[..., 0], rays[..., 1])
    return np.asarray((t > 0) & ((1.0 - t) * length > 0.3) & (u >= 0) & (u <= 1))
