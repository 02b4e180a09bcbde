"""Poses, map and moving beams together: registration and beam filter in turn (paper, Fig. 1.2)."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dynmap_cli.arrays import B1, F32, F64
from dynmap_cli.counting.counts import Rays, frame_of_scans, rays_of
from dynmap_cli.counting.em import FilteredMap, FilterParams, filter_beams
from dynmap_cli.domain.poses import Trajectory
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.mapping.back_end import Graph, close_loops, spread_to_scans
from dynmap_cli.mapping.front_end import FrontEndParams, Registered, Sweeps, register, sweeps_of
from dynmap_cli.mapping.loops import LoopParams
from dynmap_cli.mapping.odometry import Calibration, calibrate, corrected_motion, lacks_sign
from dynmap_cli.progress import Tick, progress

if TYPE_CHECKING:
    from dynmap_cli.mapping.settings import MapSettings

_log = logging.getLogger(__name__)
_CALIBRATION_SCANS = 4000
_FIRST_PASS = Calibration(
    turn_noise_rad=0.05, turn_noise_share=0.5, shift_noise_m=0.03, shift_noise_share=0.3
)
_GOOD_SHARE = 0.7


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
    """

    log_likelihood: float
    dynamic_share: float
    changed_labels: float
    pose_shift_m: float


@dataclass(frozen=True, slots=True)
class FilterMap:
    """Result of the room, in the order of the scan log.

    Attributes
    ----------
    trajectory : Trajectory
    filtered : FilteredMap
    rounds : tuple of Round
    calibration : Calibration
        Of the odometry.
    graph : Graph or None
        None where the recorded poses were taken as they are.
    lost_scans : int
        Scans that fitted nowhere in the last registration.
    """

    trajectory: Trajectory
    filtered: FilteredMap
    rounds: tuple[Round, ...]
    calibration: Calibration
    graph: Graph | None
    lost_scans: int


def build_filter_map(log: ScanLog, settings: MapSettings, *, threads: int) -> FilterMap:
    """Find poses, map and moving beams together (EM).

    Parameters
    ----------
    log : ScanLog
    settings : MapSettings
    threads : int
    """
    params = FilterParams(settings.static_prior, settings.support_cells, settings.usable_range_m, settings.em)
    registrar = Registrar(log, settings)
    weights: F32 | None = None
    poses: F64 | None = None
    rounds: list[Round] = []
    for number in range(settings.max_rounds):
        before, poses = poses, registrar.poses(weights, f"round {number + 1} of {settings.max_rounds}")
        frame = frame_of_scans(log, poses, settings.usable_range_m, settings.resolution_m)
        filtered = filter_beams(log, poses, frame, params, threads=threads)
        rounds.append(_round(filtered, weights, poses, before))
        _log.info("round %d: %.1f %% of the beams dynamic", number + 1, 100 * filtered.dynamic_share)
        weights = filtered.static_probability
        if rounds[-1].changed_labels < settings.stop_label_share:
            break
    trajectory = Trajectory(log.stamps_ns, poses if poses is not None else log.odometry)
    return FilterMap(
        trajectory, filtered, tuple(rounds), registrar.calibration, registrar.graph, registrar.lost_scans
    )


class Registrar:
    """Registers the scans of one recording, again in every round, with the odometry calibrated once."""

    def __init__(self, log: ScanLog, settings: MapSettings) -> None:
        self._log_of_scans, self._settings = log, settings
        self._rays: Rays = rays_of(log, settings.usable_range_m)
        self._params = FrontEndParams()
        self.calibration = Calibration()
        self.graph: Graph | None = None
        self.lost_scans = 0
        self._is_calibrated = False

    def poses(self, weights: F32 | None, label: str) -> F64:
        """(n_scans, 3) poses in the order of the log, with the beams weighted by e (Eq. 1.11)."""
        if self._settings.poses == "recorded":
            return np.array(self._log_of_scans.odometry)
        sweeps = sweeps_of(self._log_of_scans, weights)
        if not self._is_calibrated:
            self.calibration = self._calibrate(sweeps)
            self._is_calibrated = True
        motion = corrected_motion(sweeps.odometry, sweeps.times_s, self.calibration)
        with progress(f"registering, {label}", sweeps.n_scans, "scans") as tick:
            front = self._register(sweeps, motion, self.calibration, tick)
        self.lost_scans = int(front.is_lost.sum())
        self.graph = close_loops(sweeps, self._rays, front, LoopParams(), _note)
        poses = np.empty_like(front.poses)
        poses[np.argsort(self._log_of_scans.arrival_index, kind="stable")] = spread_to_scans(
            front, self.graph
        )
        return poses

    def _calibrate(self, sweeps: Sweeps) -> Calibration:
        """Match a first part of the recording with loose odometry and compare."""
        part = sweeps.first(_CALIBRATION_SCANS)
        if not np.isfinite(part.odometry).all(axis=1).any():
            return Calibration()
        motion = corrected_motion(part.odometry, part.times_s, Calibration())
        first_pass = self._register(part, motion, _FIRST_PASS)
        is_good = np.asarray(first_pass.shares > _GOOD_SHARE)
        return calibrate(
            part.odometry,
            part.times_s,
            first_pass.poses,
            is_good,
            reversible=lacks_sign(part.odometry, first_pass.poses, is_good & _fixes_position(first_pass)),
        )

    def _register(
        self, sweeps: Sweeps, motion: F64, calibration: Calibration, tick: Tick | None = None
    ) -> Registered:
        arguments = (sweeps, self._rays, motion, calibration, self._params)
        return register(*arguments) if tick is None else register(*arguments, tick)


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
    return Round(filtered.log_likelihood, filtered.dynamic_share, changed, shift)
