"""In which order, and in what time, the beams of a sweep are made: as the scans fit best."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import F64
from dynmap_cli.domain.sweep_motion import series_of, sweep_durations_s, sweep_twists
from dynmap_cli.kernels.beams import Rays
from dynmap_cli.scan_matching.sweeps import Sweeps

FORWARD, BACKWARD, AT_ONCE = "first to last", "last to first", "at once"
_CLEAR_GAIN = 0.003
_FULL_CIRCLE = 0.97
_TOO_SHORT, _NEGLIGIBLE = 0.8, 0.02


@dataclass(frozen=True, slots=True)
class SweepOrder:
    """How the beams of a sweep follow on one another.

    Attributes
    ----------
    name : str
        FORWARD, BACKWARD or AT_ONCE.
    beam_interval_s : (n_geometries,) float64
        Negative from the last beam to the first.
    is_revolution : bool
        A sweep lasts as long as the laser turns, whatever the recording says of the time between beams.
    """

    name: str
    beam_interval_s: F64
    is_revolution: bool = False


def sweep_orders(rays: Rays, bearings_rad: F64, sweeps: Sweeps) -> list[SweepOrder]:
    """What may be true of the sweeps; the first is what the recording says.

    A laser that looks all round makes its beams while it turns. Some drivers write a time between beams that is a
    small part of that, or none; then the time from sweep to sweep is one more thing that may be true.

    Parameters
    ----------
    rays : Rays
        With the times between beams that the recording says.
    bearings_rad : (n_geometries, n_beams) float64
    sweeps : Sweeps
    """
    said = rays.beam_interval_s
    turning = _turning_interval_s(rays, bearings_rad, sweeps)
    is_said = bool((said > _NEGLIGIBLE * turning).any())
    found = [SweepOrder(FORWARD, said), SweepOrder(BACKWARD, -said)] if is_said else []
    found.append(SweepOrder(AT_ONCE, np.zeros_like(said)))
    if (turning != said).any():
        found += [SweepOrder(FORWARD, turning, True), SweepOrder(BACKWARD, -turning, True)]
    return found


def _turning_interval_s(rays: Rays, bearings_rad: F64, sweeps: Sweeps) -> F64:
    """(n_geometries,) time between beams; that of a laser that turns once per sweep where it is said to be shorter."""
    found = rays.beam_interval_s.copy()
    laser = rays.laser_index[sweeps.geometry_index]
    for geometry in np.unique(sweeps.geometry_index).tolist():
        bearings = bearings_rad[geometry][np.isfinite(bearings_rad[geometry])]
        steps = np.diff(sweeps.times_s[laser == rays.laser_index[geometry]])
        steps = steps[steps > 0.0]
        if bearings.size < 2 or steps.size == 0:
            continue
        spacing = (bearings[-1] - bearings[0]) / (bearings.size - 1)
        interval_s = float(np.median(steps)) * spacing / (2.0 * np.pi)
        looks_round = spacing * bearings.size > 2.0 * np.pi * _FULL_CIRCLE
        if looks_round and found[geometry] < _TOO_SHORT * interval_s:
            found[geometry] = interval_s
    return found


def path_twists(rays: Rays, bearings_rad: F64, sweeps: Sweeps, poses: F64) -> F64:
    """(n_scans, 3) velocity during each sweep by the path (n_scans, 3); see `sweep_twists`."""
    durations_s = sweep_durations_s(rays.beam_interval_s, bearings_rad)[sweeps.geometry_index]
    series = series_of(rays.sensor_poses, sweeps.geometry_index, sweeps.drive_index)
    return sweep_twists(sweeps.times_s, poses, durations_s, series)


def find_sweep_order(
    rays: Rays, bearings_rad: F64, sweeps: Sweeps, poses: F64, fit: Callable[[Rays, F64], float]
) -> SweepOrder:
    """The order with which the scans fit best; what the recording says, unless another one fits clearly better.

    Parameters
    ----------
    rays, bearings_rad, sweeps
        As for `sweep_orders`.
    poses : (n_scans, 3) float64
        The path as it is without correction for the motion during sweeps. It is off by what the robot moves in half
        a sweep at most, and its velocities by what they change meanwhile; those of the odometry may lag.
    fit : callable
        Told rays, and the velocity (n_scans, 3) during each sweep: the matched share of the scans.
    """
    orders = sweep_orders(rays, bearings_rad, sweeps)
    if len(orders) == 1:
        return orders[0]
    shares = []
    for order in orders:
        tried = rays._replace(beam_interval_s=order.beam_interval_s)
        shares.append(fit(tried, path_twists(tried, bearings_rad, sweeps, poses)))
    best = int(np.argmax(shares))
    return orders[best] if shares[best] > shares[0] + _CLEAR_GAIN else orders[0]
