"""Once the whole recording is known: poses and states with what came later taken into account."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dynmap_cli.arrays import B1, F64, I64
from dynmap_cli.domain.poses import Trajectory, between, compose, inverse, transform_points, wrap_angle
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.kernels.scan_fits import scan_normal_equations
from dynmap_cli.localization.afterwards.bridges import Way, bridged
from dynmap_cli.localization.afterwards.pose_chain import Link, ScanFit, likeliest_chain
from dynmap_cli.localization.afterwards.smoothed_states import StateHistory, smooth_states
from dynmap_cli.localization.found import Localization, StateRow
from dynmap_cli.localization.particles.motion import Motion, sample_motion
from dynmap_cli.localization.sensing.map_pool import MapPool
from dynmap_cli.localization.sensing.sensor import least_log_likelihood, pose_ends, sweep_of, temper
from dynmap_cli.localization.settings import LocalizationSettings

BEAMS = 180
"""Beams of a scan at most; together they weigh no more than those of the filter."""
JUMP_M, JUMP_RAD = 0.5, 0.35
"""The filter was elsewhere before, when its step differs from that of the odometry by more."""
CLEARLY_BETTER = 3.0
"""Log-likelihood by which the path led back from later poses must beat that of the filter."""
HOPELESS = 50.0
"""A path led back that has lost so much log-likelihood since it was at its best is not led further."""
SAME_M = 0.1
"""It has come back to that of the filter where the two are so near."""
MOVED_M = 0.5
"""States that were learned from a pose further away than this from the smoothed one are forgotten."""
_SAMPLES = 400
_LEAST_VARIANCE = 1e-8


@dataclass(frozen=True, slots=True)
class Smoothed:
    """What the whole recording says.

    Attributes
    ----------
    trajectory : Trajectory
        One pose per scan.
    states : list of StateRow
        Where and when the filter had them, but for those it learned from a wrong place.
    """

    trajectory: Trajectory
    states: list[StateRow]


def smooth(log: ScanLog, pool: MapPool, found: Localization, settings: LocalizationSettings) -> Smoothed:
    """Go back over what the filter found.

    Where it jumped (it was lost, or had started elsewhere), the later pose is led back by odometry as far as
    that explains the scans better. Then the poses of each drive are made likeliest as a chain: every scan in the map
    with the sub-maps in their smoothed states, every motion as odometry has it.
    """
    nodes = np.array([row.scan for row in found.poses], dtype=np.int64)
    poses = np.array([row.pose for row in found.poses]).reshape(-1, 3)
    rows = smooth_states(found.states, pool)
    smoothed = poses.copy()
    for part in _drives(log, nodes):
        chain = _Chain(log, pool, settings, nodes[part], rows, found.laser_motions)
        smoothed[part] = chain.likeliest(poses[part])
    moved = np.hypot(*(smoothed - poses)[:, :2].T) > MOVED_M
    wrong = {found.poses[k].stamp_ns for k in np.flatnonzero(moved)}
    if wrong:
        rows = smooth_states([row for row in found.states if row.stamp_ns not in wrong], pool)
    every = _between_nodes(log, found.trajectory.poses, nodes, smoothed)
    return Smoothed(Trajectory(log.stamps_ns, every), rows)


class _Chain:
    """The updates of one drive."""

    def __init__(
        self,
        log: ScanLog,
        pool: MapPool,
        settings: LocalizationSettings,
        scans: I64,
        states: Sequence[StateRow],
        laser_motions: Mapping[int, Motion],
    ) -> None:
        self._pool, self._settings = pool, settings
        self._stamps = log.stamps_ns[scans]
        self._states = StateHistory(states, pool)
        ends = [pose_ends(sweep_of(log, int(scan), settings.laser_max_range), BEAMS) for scan in scans]
        self._tempers = [temper(own.shape[0], settings) for own in ends]
        self._ends = [np.ascontiguousarray(own.T / pool.frame.resolution_m) for own in ends]
        self._floor = float(np.exp(least_log_likelihood(settings)))
        self._sigma_cells = settings.sigma_hit / pool.frame.resolution_m
        self._scratch = np.empty((2, 2, 4))
        self._usual: float | None = None
        self._filtered = np.empty((0, 3))
        self._measured: B1 = np.asarray(np.isfinite(log.odometry[scans]).all(axis=1))
        self._odometry = log.odometry[scans]
        self._laser_motions = [laser_motions.get(int(scan)) for scan in scans[1:]]

    def likeliest(self, poses: F64) -> F64:
        """The path: first the right place throughout, then the likeliest poses there."""
        self._filtered = poses
        steps, measured = self._steps(poses)
        jumps = np.flatnonzero(_is_jump(between(steps, between(poses[:-1], poses[1:])))).tolist()
        way = Way(self._odometry, measured)
        poses = bridged(poses, jumps, way, self._cost_of_known, self._jump_cost())
        steps, measured = self._steps(poses)
        poses = self._led_back(poses, steps, measured)
        steps, measured = self._steps(poses)
        motions = [
            Motion(step, measured=bool(is_measured)) if by_laser is None else by_laser
            for step, is_measured, by_laser in zip(steps, measured, self._laser_motions, strict=True)
        ]
        links = [Link(motion.step, _information(motion, self._settings)) for motion in motions]
        result = poses.copy()
        cuts = np.flatnonzero(_is_jump(between(steps, between(poses[:-1], poses[1:])))) + 1
        for part in np.split(np.arange(poses.shape[0]), cuts):
            first, last = int(part[0]), int(part[-1])
            result[part] = likeliest_chain(poses[part], links[first:last], self._fit_from(first))
        return result

    def _steps(self, poses: F64) -> tuple[F64, B1]:
        """Motions (n - 1, 3) between the nodes and whether they were measured; else those of the filter."""
        measured: B1 = np.logical_and(self._measured[:-1], self._measured[1:])
        steps = between(poses[:-1], poses[1:])
        steps[measured] = between(self._odometry[:-1], self._odometry[1:])[measured]
        for k, motion in enumerate(self._laser_motions):
            if motion is not None:
                steps[k], measured[k] = motion.step, True
        return steps, measured

    def _led_back(self, poses: F64, steps: F64, measured: B1) -> F64:
        """Before each jump, take the later pose back by odometry as far as the scans agree better with that."""
        poses = poses.copy()
        is_jump = _is_jump(between(steps, between(poses[:-1], poses[1:])))
        jumps = np.flatnonzero(measured & is_jump)
        for jump in jumps[::-1].tolist():
            led, gains, total, best = [], [], 0.0, 0.0
            pose = poses[jump + 1]
            for node in range(jump, -1, -1):
                if not measured[node]:
                    break
                pose = self._refined(node, pose, Motion(inverse(steps[node]), measured=True))
                led.append(pose)
                gains.append(float(self._fit(node, poses[node])[0] - self._fit(node, pose)[0]))
                total += gains[-1]
                best = max(best, total)
                if total < best - HOPELESS or np.hypot(*(pose - poses[node])[:2]) < SAME_M:
                    break
            if best > CLEARLY_BETTER:
                for back_by in range(int(np.argmax(np.cumsum(gains))) + 1):
                    poses[jump - back_by] = led[back_by]
        return poses

    def _refined(self, node: int, later: F64, back: Motion) -> F64:
        """The pose of a node that fits its scan and the way back from the pose after it."""
        reached = compose(later, back.step)
        turn = np.eye(3)
        turn[:2, :2] = _rotation(float(reached[2]))
        tie = turn @ _information(back, self._settings) @ turn.T

        def fit(_: int, pose: F64) -> F64:
            away = pose - reached
            away[2] = wrap_angle(away[2])
            pull = tie @ away
            by_way = np.array([0.5 * float(away @ pull), *pull, *tie[np.triu_indices(3)]])
            return np.asarray(self._fit(node, pose) + by_way)

        return np.asarray(likeliest_chain(reached[None, :], [], fit)[0])

    def _cost_of_known(self, node: int, pose: F64) -> float:
        """Negative log-likelihood of a scan, in which ends where the map knows nothing cost as much as is usual."""
        if self._usual is None:
            self._usual = float(np.median([self._mean_cost(k, at) for k, at in enumerate(self._filtered)]))
        cost, is_known = self._costs(node, pose)
        return self._tempers[node] * float(np.where(is_known, cost, self._usual).sum())

    def _mean_cost(self, node: int, pose: F64) -> float:
        cost, is_known = self._costs(node, pose)
        return float(cost[is_known].mean()) if bool(is_known.any()) else 0.0

    def _costs(self, node: int, pose: F64) -> tuple[F64, B1]:
        """Of each end, and whether it lies where the map knows something."""
        frame = self._pool.frame
        self._states.show(int(self._stamps[node]))
        cells = frame.to_cells(transform_points(pose, self._ends[node].T * frame.resolution_m))
        rows, cols = np.clip(cells, 0, np.array(frame.shape) - 1).T
        is_known = self._pool.free[rows, cols] | self._pool.explained[rows, cols]
        return -np.log(self._states.field[rows, cols].astype(np.float64)), is_known

    def _jump_cost(self) -> float:
        """Logarithm of the number of places where a robot that was carried may be, as a global start counts them."""
        settings, cell_m = self._settings, self._pool.frame.resolution_m
        places = float(self._pool.free.sum()) * (cell_m / settings.start_pitch_m) ** 2
        return float(np.log(max(places * 360.0 / settings.start_pitch_deg, 1.0)))

    def _fit_from(self, first: int) -> ScanFit:
        """The same as `_fit`, with nodes counted from some node."""
        return lambda node, pose: self._fit(first + node, pose)

    def _fit(self, node: int, pose: F64) -> F64:
        """How a scan fits the map in the states of its time."""
        frame = self._pool.frame
        self._states.show(int(self._stamps[node]))
        size = frame.resolution_m
        cells = np.array([(pose[0] - frame.origin_x_m) / size, (pose[1] - frame.origin_y_m) / size, pose[2]])
        out = np.empty(10)
        scan_normal_equations(
            self._states.field, self._floor, self._sigma_cells, cells, self._ends[node], self._scratch, out
        )
        out *= self._tempers[node]
        out[[1, 2, 6, 8]] /= size
        out[[4, 5, 7]] /= size * size
        return out


def _information(motion: Motion, settings: LocalizationSettings) -> F64:
    """(3, 3) inverse covariance of a step under the motion model of the filter, from samples of it."""
    random = np.random.default_rng(0)
    moved = sample_motion(np.zeros((_SAMPLES, 3)), motion, settings, random)
    away = between(motion.step, moved)
    covariance = away.T @ away / _SAMPLES + _LEAST_VARIANCE * np.eye(3)
    return np.asarray(np.linalg.inv(covariance))


def _rotation(yaw: float) -> F64:
    return np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])


def _is_jump(error: F64) -> B1:
    """Which steps (n, 3) of the filter are no motion of the robot."""
    far = np.hypot(error[:, 0], error[:, 1]) > JUMP_M
    return np.asarray(far | (np.abs(error[:, 2]) > JUMP_RAD), dtype=np.bool_)


def _drives(log: ScanLog, nodes: I64) -> list[slice]:
    """Which nodes belong to each drive."""
    if nodes.size == 0:
        return []
    cuts = [0, *(np.flatnonzero(np.diff(log.drive_index[nodes])) + 1).tolist(), nodes.size]
    return [slice(first, last) for first, last in pairwise(cuts)]


def _between_nodes(log: ScanLog, filtered: F64, nodes: I64, smoothed: F64) -> F64:
    """A pose for every scan: along the motion from the node before it, which is bent to reach the node after it."""
    every = filtered.copy()
    if nodes.size == 0:
        return every
    before = np.clip(np.searchsorted(nodes, np.arange(every.shape[0]), side="right") - 1, 0, None)
    same_drive = log.drive_index[nodes[before]] == log.drive_index
    first_of = {int(log.drive_index[node]): k for k, node in reversed(list(enumerate(nodes.tolist())))}
    before = np.where(same_drive, before, [first_of.get(int(drive), 0) for drive in log.drive_index.tolist()])
    known = np.isin(log.drive_index, log.drive_index[nodes])
    every[known] = compose(smoothed[before], between(filtered[nodes[before]], filtered))[known]
    for k in range(nodes.size - 1):
        start, end = int(nodes[k]), int(nodes[k + 1])
        if end - start < 2 or log.drive_index[start] != log.drive_index[end]:
            continue
        odometry = log.odometry[[start, end]]
        if not bool(np.isfinite(odometry).all()):
            continue
        missed = between(compose(smoothed[k], between(odometry[0], odometry[1])), smoothed[k + 1])
        if bool(_is_jump(missed[None, :])[0]):
            continue
        inner = np.arange(start + 1, end)
        share = (log.stamps_ns[inner] - log.stamps_ns[start]) / max(
            int(log.stamps_ns[end] - log.stamps_ns[start]), 1
        )
        every[inner] = compose(every[inner], share[:, None] * missed)
    return every
