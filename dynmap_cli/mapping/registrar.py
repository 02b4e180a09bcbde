"""Registration of one drive: its odometry calibrated, its scans matched one after another, its loops closed."""

from __future__ import annotations

import logging
from dataclasses import replace
from functools import partial

import numpy as np

from dynmap_cli.arrays import F64
from dynmap_cli.counting.counts import rays_of
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.kernels.beams import Rays
from dynmap_cli.mapping.back_end import Graph, close_loops
from dynmap_cli.mapping.carried import Carry, find_carries
from dynmap_cli.mapping.loops import LoopParams
from dynmap_cli.progress import Tick, no_tick, progress
from dynmap_cli.scan_matching.calibration import Calibration
from dynmap_cli.scan_matching.front_end import Registered, register
from dynmap_cli.scan_matching.matcher import FrontEndParams
from dynmap_cli.scan_matching.odometry import calibrate, corrected_motion, lacks_sign
from dynmap_cli.scan_matching.several_lasers import Mounting, find_mountings
from dynmap_cli.scan_matching.sweep_order import SweepOrder, find_sweep_order, path_twists
from dynmap_cli.scan_matching.sweeps import Sweeps
from dynmap_cli.scan_matching.wheel_faults import (
    WheelFault,
    find_wheel_faults,
    jumps_while_lost,
    suspicious_stops,
    without_steps,
)

_log = logging.getLogger(__name__)
_CALIBRATION_SCANS = 4000
_FIRST_PASS = Calibration(
    turn_noise_rad=0.02, turn_noise_share=0.5, shift_noise_m=0.03, shift_noise_share=0.3
)
_GOOD_SHARE, _BETTER_SHARE = 0.7, 0.05
_SWEEP_SCANS = 1000
_SCANS_BEFORE = 80
_CROWDED_SHARE = 0.2
"""Share of the points that counts as independent in a crowd."""


class Registrar:
    """Registers the scans of one drive, again in every round, with the odometry calibrated once.

    Attributes
    ----------
    log : ScanLog
        The sweeps of the drive; its sensor poses are corrected where several lasers contradict one another.
    mountings : tuple of Mounting
        The lasers whose sensor poses were corrected.
    believed_share : float
        Factor on what the matches of single scans know, 1 unless several lasers disagree by far more than they say.
    calibration : Calibration
        Of the odometry.
    front : Registered or None
        None before the first registration.
    wheel_faults : tuple of WheelFault
        Where the odometry was not believed.
    carries : tuple of Carry
        Where the robot seems to have been carried, by the first matching.
    """

    def __init__(self, log: ScanLog, usable_range_m: float, *, is_crowded: bool = False) -> None:
        self.log = log
        self.rays: Rays = rays_of(log, usable_range_m)
        # Who is left of a crowd errs together, and the odometry has to hold against them.
        self._params = FrontEndParams()
        if is_crowded:
            self._params = replace(self._params, independent_share=_CROWDED_SHARE)
        self.calibration = Calibration()
        self.mountings: tuple[Mounting, ...] = ()
        self.believed_share = 1.0
        self.front: Registered | None = None
        self.wheel_faults: tuple[WheelFault, ...] = ()
        self.carries: tuple[Carry, ...] = ()
        self._is_calibrated = False
        self._wrong_wheels: list[tuple[int, ...]] | None = None

    def register(self, sweeps: Sweeps, label: str) -> tuple[Registered, Graph]:
        """Register all scans, with the beams weighted by e (Eq. 1.11), and close loops.

        Parameters
        ----------
        sweeps : Sweeps
            Of this drive.
        label : str
            For the progress bar.
        """
        # What the round before found is as large as what this one finds.
        self.front = None
        if not self._is_calibrated:
            self.calibration = self._calibrate(sweeps)
            self._is_calibrated = True
        motion = corrected_motion(sweeps.odometry, sweeps.times_s, self.calibration)
        twists = self._twists_without_odometry(sweeps, motion)
        with progress(f"registering, {label}", sweeps.n_scans, "scans") as tick:
            front = self._register(
                sweeps, without_steps(motion, self._wrong_wheels or ()), self.calibration, tick, twists
            )
        if self._wrong_wheels is None:
            self._wrong_wheels = self._find_wrong_wheels(sweeps, motion, front)
            if self._wrong_wheels:
                del front
                front = self._register(sweeps, without_steps(motion, self._wrong_wheels), self.calibration)
            self.carries = tuple(
                find_carries(sweeps, self.rays, front, motion, partial(self._match, sweeps, motion))
            )
        reversible = self.calibration.reversible
        self.wheel_faults = tuple(
            find_wheel_faults(motion, sweeps.times_s, front.poses, front.is_lost, reversible=reversible)
        )
        self.front = front
        return front, close_loops(sweeps, self.rays, front, LoopParams(), _log.debug)

    def _twists_without_odometry(self, sweeps: Sweeps, motion: F64) -> F64 | None:
        """Velocity during each sweep by a path without correction for it; None with odometry, which says it better.

        That of the step before is too poor a guess: its error bends the sweep, and so the next step.
        """
        if not self.rays.beam_interval_s.any() or np.isfinite(sweeps.odometry).any():
            return None
        found = self._register_at_once(sweeps, motion, self.calibration)
        return path_twists(self.rays, self.log.bearings_rad, sweeps, found.poses)

    def _match(self, sweeps: Sweeps, motion: F64, first: int, last: int) -> Registered:
        """The scans first..last - 1 without those before."""
        return self._register(sweeps.part(first, last), motion[first:last], self.calibration)

    def _find_wrong_wheels(self, sweeps: Sweeps, motion: F64, front: Registered) -> list[tuple[int, ...]]:
        """Steps whose odometry seems wrong, and without which the scans fit clearly better."""
        reversible = self.calibration.reversible
        faults = find_wheel_faults(motion, sweeps.times_s, front.poses, front.is_lost, reversible=reversible)
        unsure = [fault.steps for fault in faults if fault.steps]
        unsure += suspicious_stops(motion, sweeps.times_s, front.shares)
        unsure += jumps_while_lost(motion, front.is_lost)
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

    def _calibrate(self, sweeps: Sweeps) -> Calibration:
        """Match a first part of the recording with loose odometry and compare."""
        part = sweeps.part(0, _CALIBRATION_SCANS)
        motion = corrected_motion(part.odometry, part.times_s, Calibration())
        first_pass, order = self._first_pass(part, motion)
        if self.rays.laser_index.max() > 0:
            first_pass = self._with_agreeing_lasers(part, motion, first_pass)
        known = Calibration(sweep=order.name, is_revolution=order.is_revolution)
        if not np.isfinite(part.odometry).all(axis=1).any():
            return known
        is_good = np.asarray(first_pass.shares > _GOOD_SHARE)
        reversible = lacks_sign(part.odometry, first_pass.poses, is_good & first_pass.fixes_position)
        # Steps from one laser to another show how well their poses agree, not how the robot moved.
        laser = self.rays.laser_index[part.geometry_index]
        main = laser == np.bincount(laser).argmax()
        found = calibrate(
            part.odometry[main],
            part.times_s[main],
            first_pass.poses[main],
            is_good[main],
            first_pass.fixes_position[main],
            reversible=reversible,
            in_seconds=not main.all(),
        )
        return replace(found, sweep=known.sweep, is_revolution=known.is_revolution)

    def _with_agreeing_lasers(self, part: Sweeps, motion: F64, first_pass: Registered) -> Registered:
        """Correct where the lasers are mounted, and match again, believing the matches no more than they agree."""
        twists = path_twists(self.rays, self.log.bearings_rad, part, first_pass.poses)
        stated, laser_index = self.rays.sensor_poses.copy(), self.rays.laser_index
        seen = laser_index[part.geometry_index]

        def match(sensor_poses: F64) -> Registered:
            self._mount(sensor_poses)
            return self._register(part, motion, _FIRST_PASS, twists=twists)

        mounted, left = find_mountings(stated, laser_index, seen, match, part.times_s)
        self._mount(mounted)
        first = stated[np.flatnonzero(laser_index == np.bincount(seen).argmax())[0]]
        moved = np.flatnonzero((mounted != stated).any(axis=1))
        _, once = np.unique(laser_index[moved], return_index=True)
        self.mountings = tuple(Mounting(stated[k], mounted[k], first) for k in moved[once])
        self.believed_share = left.believed_share
        if not self.mountings and self.believed_share == 1.0:
            return first_pass
        share = self._params.independent_share * self.believed_share
        self._params = replace(self._params, independent_share=share)
        return match(mounted)

    def _mount(self, sensor_poses: F64) -> None:
        """Take the lasers to be at these poses (n_geometries, 3) on the robot."""
        self.log = replace(self.log, sensor_poses=sensor_poses.copy())
        usable_m, beam_interval_s = self.rays.usable_m, self.rays.beam_interval_s
        self.rays = rays_of(self.log, np.inf)._replace(usable_m=usable_m, beam_interval_s=beam_interval_s)

    def _first_pass(self, part: Sweeps, motion: F64) -> tuple[Registered, SweepOrder]:
        """Match with loose odometry, find out how the beams of a sweep follow on one another, and match so.

        What is corrected is the motion that the scans show, for nobody knows yet how far the odometry lags.
        """
        said, bearings = self.rays, self.log.bearings_rad
        found = self._register_at_once(part, motion, _FIRST_PASS)
        few, steps = part.part(0, _SWEEP_SCANS), motion[:_SWEEP_SCANS]

        def fit(rays: Rays, twists: F64) -> float:
            self.rays = rays
            return float(self._register(few, steps, _FIRST_PASS, twists=twists).shares.mean())

        order = find_sweep_order(said, bearings, few, found.poses[:_SWEEP_SCANS], fit)
        self.rays = said._replace(beam_interval_s=order.beam_interval_s)
        if order.beam_interval_s.any():
            twists = path_twists(self.rays, bearings, part, found.poses)
            found = self._register(part, motion, _FIRST_PASS, twists=twists)
        return found, order

    def _register(
        self,
        sweeps: Sweeps,
        motion: F64,
        calibration: Calibration,
        tick: Tick = no_tick,
        twists: F64 | None = None,
    ) -> Registered:
        return register(sweeps, self.rays, motion, calibration, self._params, tick, twists)

    def _register_at_once(self, sweeps: Sweeps, motion: F64, calibration: Calibration) -> Registered:
        """Match as if all beams of a sweep were made at its stamp."""
        still = np.zeros((sweeps.n_scans, 3))
        return self._register(sweeps, motion, calibration, twists=still)
