"""`simulate`: a scenario becomes a log with its truth."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import F32, F64, I32, I64
from dynmap_cli.domain.grid import OccupancyGrid
from dynmap_cli.domain.poses import compose, wrap_angle
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.kernels.simulation import cast_scans
from dynmap_cli.progress import Tick, no_tick
from dynmap_cli.simulation.changes import History, histories
from dynmap_cli.simulation.driving import Drive, plan_drive
from dynmap_cli.simulation.movers import Track, shapes_at, tracks
from dynmap_cli.simulation.odometry import count_wheels
from dynmap_cli.simulation.randomness import stream
from dynmap_cli.simulation.robot import Laser
from dynmap_cli.simulation.scenario import Scenario
from dynmap_cli.simulation.sensing import (
    FIRST_OBJECT,
    MOVING,
    NO_RETURN,
    STATIC,
    bearings_of,
    hide_behind_floor,
    measure,
)
from dynmap_cli.simulation.shapes import Shapes, shapes_of
from dynmap_cli.simulation.true_map import draw_true_map
from dynmap_cli.simulation.worlds import expand

_SCANS_AT_ONCE = 512
_PATH_STEP_S = 0.5


@dataclass(frozen=True, slots=True)
class OdometrySeries:
    """What the wheels reported between the scans.

    Attributes
    ----------
    stamps_ns : (n,) int64
    poses : (n, 3) float64
        odom_from_robot.
    """

    stamps_ns: I64
    poses: F64


@dataclass(frozen=True, slots=True)
class SimulatedRun:
    """A recording and its truth.

    Attributes
    ----------
    scenario : Scenario
    log : ScanLog
        What was measured.
    odometry : OdometrySeries
        At its own rate; empty where there is none.
    true_poses : (n_scans, 3) float64
        map_from_robot at the header stamp.
    beam_class : (n_scans, n_beams) int16
        STATIC = 0, MOVING = 1, NO_RETURN = 2 (no end point), MIXED = 3 (an end point between two
        surfaces), FIRST_OBJECT + k = 10 + k for door or box k.
    object_states : (n_scans, n_objects) int32
        Index of the state each object is in at the header stamp.
    objects : tuple of History
        All changes of state, doors first, then boxes.
    movers : int
        How many people, carts and robots there are.
    shapes : Shapes
        Walls, and objects in each of their states, in the axes of the world before it is turned.
    true_map : OccupancyGrid
        What never changes.
    """

    scenario: Scenario
    log: ScanLog
    odometry: OdometrySeries
    true_poses: F64
    beam_class: np.ndarray[tuple[int, ...], np.dtype[np.int16]]
    object_states: I32
    objects: tuple[History, ...]
    movers: int
    shapes: Shapes
    true_map: OccupancyGrid


@dataclass(frozen=True, slots=True)
class _Stage:
    """What all sweeps of a run share."""

    scenario: Scenario
    shapes: Shapes
    drive: Drive
    objects: tuple[History, ...]
    tracks: list[Track]


def simulate(scenario: Scenario, tick: Tick = no_tick) -> SimulatedRun:
    """Let the robot of a scenario drive and measure; the same scenario gives the same bytes.

    Parameters
    ----------
    scenario : Scenario
    tick : callable
        Told how many seconds of the recording were done.
    """
    written_out = expand(scenario)
    drive = plan_drive(written_out.robot)
    objects = tuple(histories(written_out.world, drive, scenario.seed))
    stage = _Stage(scenario, shapes_of(written_out.world), drive, objects, tracks(written_out, drive))
    times = [_sweep_times(laser, drive, number, scenario) for number, laser in enumerate(scenario.lasers)]
    geometry = np.concatenate([np.full(t.size, number, np.int32) for number, t in enumerate(times)])
    order = np.argsort(np.concatenate(times), kind="stable")
    all_times, geometry = np.concatenate(times)[order], geometry[order]
    widest = max(laser.beams for laser in scenario.lasers)
    ranges = np.full((order.size, widest), np.nan, dtype=np.float32)
    classes = np.full((order.size, widest), NO_RETURN, dtype=np.int16)
    for number, laser in enumerate(scenario.lasers):
        rows = np.flatnonzero(geometry == number)
        draw = stream(scenario.seed, f"laser {laser.name}")
        for begin in range(0, rows.size, _SCANS_AT_ONCE):
            chosen = rows[begin : begin + _SCANS_AT_ONCE]
            part = _sweep(stage, laser, all_times[chosen], draw)
            ranges[chosen, : laser.beams], classes[chosen, : laser.beams] = part
            tick(chosen.size)
    wheel_times, wheel_poses, at_scans = _wheels(scenario, drive, all_times)
    return SimulatedRun(
        scenario=scenario,
        log=_scan_log(scenario, all_times, geometry, ranges, at_scans),
        odometry=OdometrySeries(_stamps(scenario, wheel_times), wheel_poses),
        true_poses=_in_map(scenario, drive.at(all_times)),
        beam_class=classes,
        object_states=_states(objects, all_times),
        objects=objects,
        movers=len(stage.tracks),
        shapes=stage.shapes,
        true_map=_true_map(stage),
    )


def count_scans(scenario: Scenario) -> int:
    """How many sweeps a scenario will give."""
    drive = plan_drive(expand(scenario).robot)
    return sum(
        _sweep_times(laser, drive, number, scenario).size for number, laser in enumerate(scenario.lasers)
    )


def _sweep_times(laser: Laser, drive: Drive, number: int, scenario: Scenario) -> F64:
    """Times at which sweeps of a laser begin and the robot is switched on; lasers take turns."""
    period_s = 1.0 / laser.rate_hz
    first_s = period_s * number / len(scenario.lasers)
    return drive.ticks(first_s, period_s, laser.beam_interval_s * (laser.beams - 1))


def _sweep(stage: _Stage, laser: Laser, times_s: F64, draw: np.random.Generator) -> tuple[F32, I32]:
    """Cast and measure some sweeps of one laser; returns ranges and classes."""
    swept_s = laser.beam_interval_s * (laser.beams - 1)
    robot_start, robot_end = stage.drive.at(times_s), stage.drive.at(times_s + swept_s)
    seen_start = shapes_at(stage.tracks, times_s, robot_start, laser.sees)
    seen_end = shapes_at(stage.tracks, times_s + swept_s, robot_end, laser.sees)
    bearings = bearings_of(laser)
    shape = (times_s.size, laser.beams)
    ranges, hits, cosines = np.empty(shape), np.empty(shape, dtype=np.int32), np.empty(shape)
    cast_scans(
        _sensor(robot_start, laser),
        _sensor(robot_end, laser),
        float(bearings[0]),
        float(bearings[1] - bearings[0]),
        laser.max_range_m,
        stage.shapes.segments,
        stage.shapes.segment_gates,
        stage.shapes.segment_returns,
        stage.shapes.circles,
        stage.shapes.circle_gates,
        _states(stage.objects, times_s),
        np.concatenate([seen_start.segments, seen_end.segments], axis=2),
        np.concatenate([seen_start.circles[..., :2], seen_end.circles], axis=2),
        draw.random(shape),
        ranges,
        hits,
        cosines,
    )
    classes = _class_of(hits, stage.shapes)
    held = stage.drive.is_carried(times_s)
    if held.any():
        in_hands = ranges[held], classes[held]
        hide_behind_floor(*in_hands, bearings, draw)
        ranges[held], classes[held] = in_hands
    return measure(ranges, cosines, classes, laser, draw)


def _sensor(robot: F64, laser: Laser) -> F64:
    """world_from_sensor with the yaw of the robot not wrapped."""
    mounted = np.array([laser.pose[0], laser.pose[1], math.radians(laser.pose[2])])
    poses = compose(robot, mounted)
    poses[:, 2] = robot[:, 2] + mounted[2]
    return poses


def _class_of(hits: I32, shapes: Shapes) -> I32:
    """Class of each beam from the number of what it met."""
    gates = np.concatenate([shapes.segment_gates[:, 0], shapes.circle_gates[:, 0]])
    table = np.append(np.where(gates < 0, STATIC, FIRST_OBJECT + gates), [MOVING, NO_RETURN]).astype(np.int32)
    return np.asarray(table[np.where(hits < 0, gates.size + 1, np.minimum(hits, gates.size))])


def _states(objects: tuple[History, ...], times_s: F64) -> I32:
    """(n, n_objects) state of each object at some times."""
    columns = [thing.at(times_s) for thing in objects]
    return np.stack(columns, axis=1) if columns else np.empty((times_s.size, 0), dtype=np.int32)


def _wheels(scenario: Scenario, drive: Drive, scan_times_s: F64) -> tuple[F64, F64, F64]:
    """Times and poses of the odometry, and its poses at the scans."""
    if scenario.odometry is None:
        return np.empty(0), np.empty((0, 3)), np.full((scan_times_s.size, 3), np.nan)
    period_s = 1.0 / scenario.odometry.rate_hz
    ticks = drive.ticks(0.0, period_s, -period_s)
    both = np.union1d(ticks, scan_times_s)
    poses = count_wheels(drive, scenario.odometry, both, scenario.seed)
    at_ticks, at_scans = np.searchsorted(both, ticks), np.searchsorted(both, scan_times_s)
    return ticks, poses[at_ticks], poses[at_scans]


def _scan_log(scenario: Scenario, times_s: F64, geometry: I32, ranges: F32, odometry: F64) -> ScanLog:
    """Put the columns together."""
    lasers = scenario.lasers
    bearings = np.full((len(lasers), ranges.shape[1]), np.nan)
    for number, laser in enumerate(lasers):
        bearings[number, : laser.beams] = bearings_of(laser)
    return ScanLog(
        stamps_ns=_stamps(scenario, times_s),
        ranges_m=ranges,
        odometry=odometry,
        geometry_index=geometry,
        bearings_rad=bearings,
        sensor_poses=np.array([(*laser.pose[:2], math.radians(laser.pose[2])) for laser in lasers]),
        range_limits_m=np.array([(laser.min_range_m, laser.max_range_m) for laser in lasers]),
        beam_interval_s=np.array([laser.beam_interval_s for laser in lasers]),
        recording_index=np.zeros(times_s.size, dtype=np.int32),
        recordings=("simulated",),
    )


def _stamps(scenario: Scenario, times_s: F64) -> I64:
    """Header stamps of times since the start, whole microseconds."""
    start_ns = round(scenario.start.timestamp() * 1e6) * 1000
    return start_ns + np.round(times_s * 1e6).astype(np.int64) * 1000


def _in_map(scenario: Scenario, poses: F64) -> F64:
    """Turn poses of the world's own axes into the map frame."""
    turned = compose(np.array([0.0, 0.0, math.radians(scenario.turn_deg)]), poses)
    turned[:, 2] = wrap_angle(turned[:, 2])
    return turned


def _true_map(stage: _Stage) -> OccupancyGrid:
    """The map of what never changes."""
    path = stage.drive.at(np.arange(0.0, stage.drive.duration_s + _PATH_STEP_S, _PATH_STEP_S))[:, :2]
    turn_rad = math.radians(stage.scenario.turn_deg)
    return draw_true_map(stage.shapes, path, turn_rad, stage.scenario.map_resolution_m)
