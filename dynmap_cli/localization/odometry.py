"""The odometry of a recording as far as its scans bear it out: calibrated, and led by the scans where it fails.

The filter takes odometry for what its settings say: unbiased, in time, and never wrong by much. Wheels that lag behind,
freeze or slip take its particles away from the robot for good, and without odometry nothing links the scans of a global
start. So the scans of each drive are matched once against those before them, loosely led by the odometry, as `map` does
on a recording that is mapped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynmap_cli.arrays import B1, F64, I64
from dynmap_cli.counting.counts import rays_of
from dynmap_cli.domain.poses import between, compose, interpolate
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.domain.sweep_motion import sweep_durations_s
from dynmap_cli.kernels.beams import Rays
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.scan_matching.calibration import Calibration
from dynmap_cli.scan_matching.front_end import Registered, register
from dynmap_cli.scan_matching.matcher import FrontEndParams
from dynmap_cli.scan_matching.odometry import calibrate, corrected_motion, lacks_sign
from dynmap_cli.scan_matching.sweep_order import find_sweep_order, path_twists, sweep_orders
from dynmap_cli.scan_matching.sweeps import Sweeps, sweeps_of
from dynmap_cli.scan_matching.wheel_faults import WheelFault, find_wheel_faults, stops, without_steps

PERIOD_S = 0.1
"""Scans closer together than this say the same thing twice."""
LOOSE = Calibration(turn_noise_rad=0.01, turn_noise_share=0.3, shift_noise_m=0.03, shift_noise_share=0.3)
"""Of odometry that nobody has calibrated."""
PARAMS = FrontEndParams(wide_turn_rad=0.15)
"""The wide search is for scans that do not fit."""
GOOD_SHARE = 0.7
"""Matched share of a scan to calibrate by."""
JUDGED_BEFORE, JUDGED_AFTER = 10, 40
"""Scans around the beginning of a fault that tell whether it is one."""

TRIED = 100
"""Scans that tell in which order the beams of a sweep are made."""
END_SHARES = 0.75, 1.5
"""Of the time of a sweep: sweeps are stamped at their end if the odometry runs ahead of them by that."""
MIDDLE = -0.5
"""When the first beam is made, in times of a sweep after its stamp, where no odometry tells and the driver says times
between beams that the scans contradict: it does not follow the definition of the message, which has the stamp at the
first beam (sensor_msgs/LaserScan), so the stamp may as well be that of the end. This is off by half a sweep at most."""
LEAST_STEP_S = 1e-3
"""Stamps may be equal."""
LED_BY = 10
"""Steps that tell with which velocity a recording begins."""


@dataclass(frozen=True, slots=True)
class Drive:
    """The odometry of one drive.

    Attributes
    ----------
    poses : (n_scans, 3) float64
        odom_from_robot at each scan in the order of its stamps; NaN where neither wheels nor scans tell the position.
    calibration : Calibration
    beam_interval_s : (n_geometries,) float64
        As the scans fit best, see `find_sweep_order`.
    first_beam_s : (n_geometries,) float64
        Minus the time of a sweep where sweeps are stamped at their end, minus half of it where nobody knows.
    faults : tuple of WheelFault
        Where the scans led instead of the wheels.
    has_wheels : bool
        Whether there is any odometry.
    """

    poses: F64
    calibration: Calibration
    beam_interval_s: F64
    first_beam_s: F64
    faults: tuple[WheelFault, ...]
    has_wheels: bool


def with_sound_odometry(log: ScanLog, settings: LocalizationSettings) -> tuple[ScanLog, list[str]]:
    """The same recording with the odometry that its scans bear out, and what was wrong with it, one sentence each."""
    odometry, sentences = log.odometry.copy(), []
    intervals_s, first_s = log.beam_interval_s.copy(), log.first_beam_s.copy()
    for drive in range(log.n_drives):
        rows = np.flatnonzero(log.drive_index == drive)
        if rows.size < 2:
            continue
        found = sound_odometry(log.select(slice(int(rows[0]), int(rows[-1]) + 1)), settings)
        odometry[rows] = found.poses
        own = np.unique(log.geometry_index[rows])
        intervals_s[own], first_s[own] = found.beam_interval_s[own], found.first_beam_s[own]
        if found.faults:
            sentences.append(_fault_words(found.faults, log.recordings_of(drive)))
    sound = replace(log, odometry=odometry, beam_interval_s=intervals_s, first_beam_s=first_s)
    return sound, sentences


def sound_odometry(log: ScanLog, settings: LocalizationSettings) -> Drive:
    """Match the scans of one drive (two or more), calibrate, and take the steps of the scans where wheels fail."""
    every = sweeps_of(log, None)
    rows = _spaced(every.times_s)
    sweeps = every.chosen(rows)
    said = rays_of(log, settings.laser_max_range)
    rays = said._replace(beam_interval_s=np.zeros_like(said.beam_interval_s))
    raw = corrected_motion(sweeps.odometry, sweeps.times_s, Calibration())
    still = stops(raw, sweeps.times_s)
    led = without_steps(raw, still)
    found = _from_the_beginning(register(sweeps, rays, led, LOOSE, PARAMS), sweeps, rays, led)
    intervals_s = _beam_intervals(said, log.bearings_rad, every, sweeps.times_s, found.poses)
    if intervals_s.any():
        rays = said._replace(beam_interval_s=intervals_s)
        twists = path_twists(rays, log.bearings_rad, sweeps, found.poses)
        found = register(sweeps, rays, led, LOOSE, PARAMS, twists=twists)
    durations_s = sweep_durations_s(intervals_s, log.bearings_rad)
    calibration, stamped_s = _with_stamps(_calibration(sweeps, rays, found), sweeps, durations_s)
    motion = corrected_motion(sweeps.odometry, sweeps.times_s, calibration)
    has_wheels = bool(np.isfinite(motion[1:]).all(axis=1).any())
    if not has_wheels:
        stamped_s = np.where(intervals_s == said.beam_interval_s, stamped_s, MIDDLE * durations_s)
    faults: list[WheelFault] = []
    if has_wheels and not calibration.reversible:
        found_faults = find_wheel_faults(motion, sweeps.times_s, found.poses, found.is_lost, reversible=False)
        faults = [fault for fault in found_faults if _is_wrong(fault, sweeps, rays, motion)]
    by_scans: B1 = np.asarray(~np.isfinite(motion).all(axis=1) | calibration.reversible)
    for fault in faults:
        by_scans[list(fault.steps)] = True
    poses = _joined(motion, found, by_scans)
    at_scans = np.empty((log.n_scans, 3))
    at_scans[every.rows] = interpolate(rows, poses, np.arange(log.n_scans))
    return Drive(at_scans, calibration, intervals_s, stamped_s, tuple(faults), has_wheels)


def _with_stamps(calibration: Calibration, sweeps: Sweeps, durations_s: F64) -> tuple[Calibration, F64]:
    """Which part of a lag is that sweeps are stamped at their end, and when their first beams are made (n_geometries,).

    Messages are stamped late, not early: odometry that runs ahead of the scans by the time of a sweep shows the scans
    to be late by that. It is the rest that the odometry is shifted by.

    Parameters
    ----------
    calibration : Calibration
    sweeps : Sweeps
    durations_s : (n_geometries,) float64
        Of each sweep; 0 = all beams at once.
    """
    usual_s = float(np.median(durations_s[sweeps.geometry_index]))
    lag_s = calibration.lag_s + calibration.lag_scans * float(np.median(np.diff(sweeps.times_s)))
    if usual_s == 0.0 or not END_SHARES[0] * usual_s <= -lag_s <= END_SHARES[1] * usual_s:
        return calibration, np.zeros_like(durations_s)
    return replace(calibration, lag_scans=0.0, lag_s=lag_s + usual_s), -durations_s


def _beam_intervals(said: Rays, bearings_rad: F64, every: Sweeps, times_s: F64, poses: F64) -> F64:
    """(n_geometries,) time between beams with which the scans fit best where the robot turns most.

    Parameters
    ----------
    said : Rays
        As the recording says it.
    bearings_rad : (n_geometries, n_beams) float64
    every : Sweeps
    times_s, poses : (n,) and (n, 3) float64
        The path as if all beams of a sweep were made at once.
    """
    if len(sweep_orders(said, bearings_rad, every)) == 1:
        return said.beam_interval_s
    turned = np.interp(every.times_s, times_s, np.unwrap(poses[:, 2]))
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(turned)))])
    first = int(np.argmax(way[TRIED - 1 :] - way[: way.size - TRIED + 1])) if way.size > TRIED else 0
    few = every.part(first, first + TRIED)
    at_ns, few_ns = (np.round(each * 1e9).astype(np.int64) for each in (times_s, few.times_s))
    motion = corrected_motion(few.odometry, few.times_s, Calibration())
    motion = without_steps(motion, stops(motion, few.times_s))

    def fit(rays: Rays, twists: F64) -> float:
        return float(register(few, rays, motion, LOOSE, PARAMS, twists=twists).shares.mean())

    return find_sweep_order(said, bearings_rad, few, interpolate(at_ns, poses, few_ns), fit).beam_interval_s


def _spaced(times_s: F64) -> I64:
    """Every k-th row, of which about as many are `PERIOD_S` apart as are closer, and the last one.

    Stamps may jitter by more than the time between scans, so rows are counted.
    """
    every = max(int(PERIOD_S / max(float(np.median(np.diff(times_s))), LEAST_STEP_S) + 1e-6), 1)
    return np.union1d(np.arange(0, times_s.size, every), times_s.size - 1)


def _from_the_beginning(found: Registered, sweeps: Sweeps, rays: Rays, motion: F64) -> Registered:
    """The path with its first scans matched again, if nothing led them, by the velocity that it has afterwards.

    A robot that is on its way when the recording begins seems to stand until its scans fit nowhere near any more.
    """
    says_nothing = (found.is_lost | ~found.fixes_position)[1:]
    lead = 1 + int(np.argmin(says_nothing))
    last = min(lead + LED_BY, sweeps.n_scans - 1)
    if not says_nothing[0] or says_nothing.all() or lead == last or np.isfinite(motion[1 : lead + 1]).any():
        return found
    seconds = np.maximum(np.diff(sweeps.times_s), LEAST_STEP_S)[:, None]
    velocity = np.median(
        between(found.poses[lead:last], found.poses[lead + 1 : last + 1]) / seconds[lead:last], axis=0
    )
    steps = np.concatenate([np.zeros((1, 3)), velocity * seconds[:last]])
    again = register(sweeps.part(0, last + 1), rays, steps, LOOSE, PARAMS)
    if again.shares[:lead].mean() <= found.shares[:lead].mean():
        return found
    later = compose(again.poses[lead], between(found.poses[lead], found.poses[lead:]))
    return replace(
        found,
        poses=np.concatenate([again.poses[:lead], later]),
        shares=np.concatenate([again.shares[:lead], found.shares[lead:]]),
        information=np.concatenate([again.information[:lead], found.information[lead:]]),
        is_lost=np.concatenate([again.is_lost[:lead], found.is_lost[lead:]]),
    )


def _calibration(sweeps: Sweeps, rays: Rays, found: Registered) -> Calibration:
    """What is wrong with the odometry all along."""
    if not np.isfinite(sweeps.odometry).all(axis=1).any():
        return Calibration()
    is_good, is_sure = np.asarray(found.shares > GOOD_SHARE), found.fixes_position
    reversible = lacks_sign(sweeps.odometry, found.poses, is_good & is_sure)
    # Steps from one laser to another show how well their poses agree, not how the robot moved.
    laser = rays.laser_index[sweeps.geometry_index]
    main = laser == np.bincount(laser).argmax()
    return calibrate(
        sweeps.odometry[main],
        sweeps.times_s[main],
        found.poses[main],
        is_good[main],
        is_sure[main],
        reversible=reversible,
        in_seconds=not main.all(),
    )


def _is_wrong(fault: WheelFault, sweeps: Sweeps, rays: Rays, motion: F64) -> bool:
    """Whether scans that are led by the wheels around the beginning of a fault contradict them still.

    Scans that nothing leads go along with a crowd that streams past.
    """
    begin = int(np.searchsorted(sweeps.times_s, fault.start_s))
    first, last = max(begin - JUDGED_BEFORE, 0), min(begin + JUDGED_AFTER, sweeps.n_scans)
    part, steps = sweeps.part(first, last), motion[first:last]
    led = register(part, rays, steps, LOOSE, PARAMS)
    return bool(find_wheel_faults(steps, part.times_s, led.poses, led.is_lost, reversible=False))


def _joined(motion: F64, found: Registered, by_scans: B1) -> F64:
    """(n, 3) path by the steps of wheels or scans; NaN where only scans could tell the position, and do not."""
    steps = np.where(by_scans[1:, None], between(found.poses[:-1], found.poses[1:]), motion[1:])
    poses = np.zeros_like(motion)
    for row, step in enumerate(steps, 1):
        poses[row] = compose(poses[row - 1], step)
    says_nothing = found.is_lost | ~found.fixes_position
    poses[1:][by_scans[1:] & says_nothing[1:]] = np.nan
    return poses


def _fault_words(faults: Sequence[WheelFault], recordings: Sequence[str]) -> str:
    """One sentence for people."""
    first = faults[0]
    how = "stood still" if first.is_frozen else "slipped"
    more = f", and {len(faults) - 1} times more" if len(faults) > 1 else ""
    return (
        f"{', '.join(recordings)}: the odometry {how} from t = {first.start_s:.1f} to {first.end_s:.1f} s while the "
        f"scans show {first.scans_m:.2f} m and {np.degrees(first.scans_rad):.0f} deg instead of "
        f"{first.odometry_m:.2f} m and {np.degrees(first.odometry_rad):.0f} deg{more}: the scans led there"
    )
