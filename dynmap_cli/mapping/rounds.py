"""Poses, map and moving beams together: registration and beam filter in turn (paper, Fig. 1.2)."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from dynmap_cli.arrays import B1, F32, F64
from dynmap_cli.counting.counts import Rays, frame_of_scans, rays_of, twists_of
from dynmap_cli.counting.em import FilteredMap, FilterParams, all_static, filter_beams, occupancy
from dynmap_cli.counting.looks import filter_by_looks
from dynmap_cli.domain.grid import OccupancyGrid
from dynmap_cli.domain.poses import Trajectory
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.mapping.back_end import Graph, close_loops, refine_graph, spread_to_scans
from dynmap_cli.mapping.first_guess import crowd_weights
from dynmap_cli.mapping.front_end import FrontEndParams, Registered, Sweeps, register, sweeps_of
from dynmap_cli.mapping.loops import LoopParams
from dynmap_cli.mapping.odometry import Calibration, calibrate, corrected_motion, lacks_sign
from dynmap_cli.mapping.wheel_faults import WheelFault, find_wheel_faults, suspicious_stops, without_steps
from dynmap_cli.progress import Tick, progress

if TYPE_CHECKING:
    from dynmap_cli.mapping.settings import MapSettings

_log = logging.getLogger(__name__)
_CALIBRATION_SCANS = 4000
_FIRST_PASS = Calibration(
    turn_noise_rad=0.02, turn_noise_share=0.5, shift_noise_m=0.03, shift_noise_share=0.3
)
_GOOD_SHARE, _CLEAR_GAIN, _BETTER_SHARE = 0.7, 0.003, 0.05
_SWEEP_SCANS = 1000
_SCANS_BEFORE = 80
_FEW_DYNAMIC = 0.02
_CROWDED_SHARE = 0.2
"""Share of the points that counts as independent in a crowd."""
_SWEEP_SIGNS = {"first to last": 1.0, "last to first": -1.0, "at once": 0.0}


@dataclass(frozen=True, slots=True)
class Round:
    """What one round of registration and filtering changed.

    Attributes
    ----------
    log_likelihood : float
        Eq. 1.7 at the end of the round, without the prior's constant.
    dynamic_share : float
        Share of the beams with an end point that are called dynamic.
    changed_labels : float
        Share of the beams whose label changed in this round; 1 in the first.
    pose_shift_m : float
        Largest shift of a pose in this round; NaN in the first.
    occupancy : OccupancyGrid
        The map at the end of the round.
    """

    log_likelihood: float
    dynamic_share: float
    changed_labels: float
    pose_shift_m: float
    occupancy: OccupancyGrid


@dataclass(frozen=True, slots=True)
class FilterMap:
    """Result of the room, in the order of the scan log.

    Attributes
    ----------
    trajectory : Trajectory
    filtered : FilteredMap
    rounds : tuple of Round
    unfiltered : OccupancyGrid
        What the first round would have drawn of all beams.
    calibration : Calibration
        Of the odometry.
    graph : Graph or None
        None where the recorded poses were taken as they are.
    front : Registered or None
        The last registration; None where the recorded poses were taken as they are.
    wheel_faults : tuple of WheelFault
        Where the odometry was not believed.
    """

    trajectory: Trajectory
    filtered: FilteredMap
    rounds: tuple[Round, ...]
    unfiltered: OccupancyGrid
    calibration: Calibration
    graph: Graph | None
    front: Registered | None
    wheel_faults: tuple[WheelFault, ...]


def build_filter_map(log: ScanLog, settings: MapSettings, *, threads: int) -> FilterMap:
    """Find poses, map and moving beams together (EM).

    Parameters
    ----------
    log : ScanLog
    settings : MapSettings
    threads : int
    """
    params = FilterParams(
        settings.static_prior,
        settings.support_cells,
        settings.usable_range_m,
        settings.em,
        settings.stop_at_walls,
    )
    crowd: F32 | None = None
    if settings.poses == "estimate":
        crowd = crowd_weights(log, settings.usable_range_m, threads=threads)
    if crowd is not None:
        _log.info("a crowd: the path is found without the beams that move by the odometry of a few seconds")
    registrar = Registrar(log, settings, is_crowded=crowd is not None)
    known: F32 | None = None
    poses: F64 | None = None
    rounds: list[Round] = []
    while True:
        # Where people come by all the time, few of them stand out on the map of the whole recording.
        weights = known if crowd is None else crowd if known is None else np.fmin(known, crowd)
        before, poses = poses, registrar.poses(weights, f"round {len(rounds) + 1} of {settings.max_rounds}")
        frame = frame_of_scans(log, poses, settings.usable_range_m, settings.resolution_m)
        twists = twists_of(registrar.log, poses)
        filtered = filter_beams(registrar.log, poses, frame, params, twists=twists, threads=threads)
        if not rounds:
            unfiltered = occupancy(all_static(filtered.counting_map))
        rounds.append(_round(filtered, known, poses, before))
        _log.info("round %d: %.1f %% of the beams dynamic", len(rounds), 100 * filtered.dynamic_share)
        if rounds[-1].changed_labels < settings.stop_label_share or len(rounds) == settings.max_rounds:
            return FilterMap(
                Trajectory(log.stamps_ns, poses),
                _with_looks(filtered, registrar.log, poses, twists, settings),
                tuple(rounds),
                unfiltered,
                registrar.calibration,
                registrar.graph,
                registrar.front,
                registrar.wheel_faults,
            )
        known = filtered.static_probability
        del filtered  # as large as the map of the next round


def _with_looks(
    filtered: FilteredMap, log: ScanLog, poses: F64, twists: F64 | None, settings: MapSettings
) -> FilteredMap:
    """The result with those taken out that stood longer, where looks are asked for."""
    if settings.look_s == 0.0:
        return filtered
    return filter_by_looks(
        filtered,
        log,
        poses,
        look_s=settings.look_s,
        look_prior=settings.look_prior,
        usable_range_m=settings.usable_range_m,
        twists=twists,
    )


class Registrar:
    """Registers the scans of one recording, again in every round, with the odometry calibrated once."""

    def __init__(self, log: ScanLog, settings: MapSettings, *, is_crowded: bool = False) -> None:
        self.log, self._settings = log, settings
        self._rays: Rays = rays_of(log, settings.usable_range_m)
        # Who is left of a crowd errs together, and the odometry has to hold against them.
        self._params = FrontEndParams()
        if is_crowded:
            self._params = replace(self._params, independent_share=_CROWDED_SHARE)
        self.calibration = Calibration()
        self.graph: Graph | None = None
        self.front: Registered | None = None
        self.wheel_faults: tuple[WheelFault, ...] = ()
        self._is_calibrated = False
        self._wrong_wheels: list[tuple[int, ...]] | None = None

    def poses(self, weights: F32 | None, label: str) -> F64:
        """(n_scans, 3) poses in the order of the log, with the beams weighted by e (Eq. 1.11)."""
        if self._settings.poses == "recorded":
            return np.array(self.log.odometry)
        sweeps = sweeps_of(self.log, weights)
        is_first = self.front is None
        if self.front is not None and self.graph is not None and _few_are_dynamic(weights):
            # Hardly anything was filtered: the registration stands, only the poses are fitted again.
            self.graph = refine_graph(sweeps, self._rays, self.front, self.graph)
            return self._in_log_order(spread_to_scans(self.front, self.graph))
        if not self._is_calibrated:
            self.calibration = self._calibrate(sweeps)
            # The log makes its columns read-only; the kernels keep one signature with a copy.
            self.log = replace(self.log, beam_interval_s=self._rays.beam_interval_s.copy())
            self._is_calibrated = True
        motion = corrected_motion(sweeps.odometry, sweeps.times_s, self.calibration)
        trusted = without_steps(motion, self._wrong_wheels or ())
        with progress(f"registering, {label}", sweeps.n_scans, "scans") as tick:
            front = self._register(sweeps, trusted, self.calibration, tick)
        if self._wrong_wheels is None:
            self._wrong_wheels = self._find_wrong_wheels(sweeps, motion, front)
            if self._wrong_wheels:
                front = self._register(sweeps, without_steps(motion, self._wrong_wheels), self.calibration)
        reversible = self.calibration.reversible
        self.wheel_faults = tuple(
            find_wheel_faults(motion, sweeps.times_s, front.poses, front.is_lost, reversible=reversible)
        )
        self.front = front
        self.graph = close_loops(sweeps, self._rays, front, LoopParams(), _note)
        if not is_first or self._settings.max_rounds == 1:
            # In the first of several rounds the next one fits the poses again.
            self.graph = refine_graph(sweeps, self._rays, front, self.graph)
        return self._in_log_order(spread_to_scans(front, self.graph))

    def _find_wrong_wheels(self, sweeps: Sweeps, motion: F64, front: Registered) -> list[tuple[int, ...]]:
        """Steps whose odometry seems wrong, and without which the scans fit clearly better."""
        reversible = self.calibration.reversible
        faults = find_wheel_faults(motion, sweeps.times_s, front.poses, front.is_lost, reversible=reversible)
        unsure = [fault.steps for fault in faults if fault.steps]
        unsure += suspicious_stops(motion, sweeps.times_s, front.shares)
        return [steps for steps in unsure if self._fits_better_without(steps, sweeps, motion)]

    def _fits_better_without(self, steps: tuple[int, ...], sweeps: Sweeps, motion: F64) -> bool:
        """Whether the scans of some steps fit clearly better without their odometry; tried on the scans around."""
        first, last = max(min(steps) - _SCANS_BEFORE, 0), min(max(steps) + 1, sweeps.n_scans)
        part, rows = sweeps.part(first, last), np.array(steps) - first
        shares = [
            float(self._register(part, each[first:last], self.calibration).shares[rows].mean())
            for each in (motion, without_steps(motion, [steps]))
        ]
        return shares[1] - shares[0] > _BETTER_SHARE

    def _in_log_order(self, poses: F64) -> F64:
        """Sort poses from the order in which the sweeps were made into that of the log."""
        sorted_poses = np.empty_like(poses)
        sorted_poses[np.argsort(self.log.arrival_index, kind="stable")] = poses
        return sorted_poses

    def _calibrate(self, sweeps: Sweeps) -> Calibration:
        """Match a first part of the recording with loose odometry and compare."""
        part = sweeps.part(0, _CALIBRATION_SCANS)
        motion = corrected_motion(part.odometry, part.times_s, Calibration())
        sweep = self._find_sweep(part.part(0, _SWEEP_SCANS), motion[:_SWEEP_SCANS])
        self._rays = replace(self._rays, beam_interval_s=_SWEEP_SIGNS[sweep] * self._rays.beam_interval_s)
        if not np.isfinite(part.odometry).all(axis=1).any():
            return Calibration(sweep=sweep)
        first_pass = self._register(part, motion, _FIRST_PASS)
        is_good = np.asarray(first_pass.shares > _GOOD_SHARE)
        reversible = lacks_sign(part.odometry, first_pass.poses, is_good & _fixes_position(first_pass))
        # Steps from one laser to another show how well their poses agree, not how the robot moved.
        laser = self._rays.laser_index[part.geometry_index]
        main = laser == np.bincount(laser).argmax()
        found = calibrate(
            part.odometry[main],
            part.times_s[main],
            first_pass.poses[main],
            is_good[main],
            _fixes_position(first_pass)[main],
            reversible=reversible,
            in_seconds=not main.all(),
        )
        return replace(found, sweep=sweep)

    def _find_sweep(self, part: Sweeps, motion: F64) -> str:
        """In which order the beams of a sweep are made: the one with which the scans fit best."""
        if not self._rays.beam_interval_s.any():
            return "at once"
        intervals = self._rays.beam_interval_s
        shares = {}
        for sweep, sign in _SWEEP_SIGNS.items():
            self._rays = replace(self._rays, beam_interval_s=sign * intervals)
            shares[sweep] = float(self._register(part, motion, _FIRST_PASS).shares.mean())
        self._rays = replace(self._rays, beam_interval_s=intervals)
        best = max(shares, key=lambda sweep: shares[sweep])
        # Stamps and increments are to be believed unless the scans say otherwise.
        return best if shares[best] > shares["first to last"] + _CLEAR_GAIN else "first to last"

    def _register(
        self, sweeps: Sweeps, motion: F64, calibration: Calibration, tick: Tick | None = None
    ) -> Registered:
        arguments = (sweeps, self._rays, motion, calibration, self._params)
        return register(*arguments) if tick is None else register(*arguments, tick)


def _few_are_dynamic(weights: F32 | None) -> bool:
    """Whether so few beams were taken out that they cannot have misled the registration."""
    if weights is None:
        return False
    ended = np.isfinite(weights)
    return int((weights < 0.5).sum()) < _FEW_DYNAMIC * int(ended.sum())


def _fixes_position(registered: Registered) -> B1:
    """(n_scans,) where the match knows both directions; along a bare corridor it knows one."""
    spread = np.linalg.eigvalsh(registered.information[:, :2, :2])
    return np.asarray(spread[:, 0] > 0.05 * np.maximum(spread[:, 1], 1e-9))


def _note(sentence: str) -> None:
    _log.debug(sentence)


def _round(filtered: FilteredMap, weights: F32 | None, poses: F64, before: F64 | None) -> Round:
    """Compare a round with the one before."""
    changed, shift = 1.0, float("nan")
    if weights is not None and before is not None:
        ended = np.isfinite(filtered.static_probability)
        differs = (filtered.static_probability < 0.5) != (weights < 0.5)
        changed = float((differs & ended).sum() / max(int(ended.sum()), 1))
        shift = float(np.nanmax(np.linalg.norm(poses[:, :2] - before[:, :2], axis=1), initial=0.0))
    drawn = occupancy(filtered.counting_map)
    return Round(filtered.log_likelihood, filtered.dynamic_share, changed, shift, drawn)
