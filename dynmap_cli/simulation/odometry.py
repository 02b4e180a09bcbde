"""What the wheels report: true increments, distorted and summed up."""

from __future__ import annotations

import numpy as np

from dynmap_cli.arrays import B1, F64
from dynmap_cli.domain.poses import wrap_angle
from dynmap_cli.simulation.driving import Drive
from dynmap_cli.simulation.randomness import stream
from dynmap_cli.simulation.robot import Odometry


def count_wheels(drive: Drive, settings: Odometry, times_s: F64, seed: int) -> F64:
    """Odometry poses at some times.

    Parameters
    ----------
    drive : Drive
        The true motion.
    settings : Odometry
    times_s : (n,) float64
        Ascending.
    seed : int

    Returns
    -------
    (n, 3) float64
        odom_from_robot; the first is the origin.
    """
    draw = stream(seed, "odometry")
    true = drive.rolled_at(times_s - settings.lag_s)
    steps = np.diff(true, axis=0)
    middle = true[:-1, 2] + 0.5 * steps[:, 2]
    ahead = np.cos(middle) * steps[:, 0] + np.sin(middle) * steps[:, 1]
    aside = -np.sin(middle) * steps[:, 0] + np.cos(middle) * steps[:, 1]
    length, turn = np.hypot(ahead, aside), steps[:, 2]
    if not settings.signed:
        ahead = np.abs(ahead)
    ahead = settings.translation_scale * ahead + draw.normal(size=ahead.size) * (
        settings.sigma_m_per_sqrt_m * np.sqrt(length)
    )
    spread_deg = np.hypot(
        settings.sigma_deg_per_sqrt_m * np.sqrt(length),
        settings.sigma_deg_per_sqrt_turn * np.sqrt(np.abs(turn) / (2.0 * np.pi)),
    )
    turn = settings.rotation_scale * turn + np.radians(
        settings.bias_degpm * length + draw.normal(size=turn.size) * spread_deg
    )
    slips = draw.random(turn.size) < settings.slips_per_100m * length / 100.0
    turn = turn + np.where(slips, np.radians(settings.slip_deg) * draw.normal(size=turn.size), 0.0)
    stuck = _frozen(settings, times_s, draw)[1:]
    return _summed_up(np.where(stuck, 0.0, ahead), np.where(stuck, 0.0, aside), np.where(stuck, 0.0, turn))


def _summed_up(ahead: F64, aside: F64, turn: F64) -> F64:
    """Chain increments, given along and across the mean heading of each."""
    yaw = np.concatenate([[0.0], np.cumsum(turn)])
    middle = yaw[:-1] + 0.5 * turn
    x = np.concatenate([[0.0], np.cumsum(np.cos(middle) * ahead - np.sin(middle) * aside)])
    y = np.concatenate([[0.0], np.cumsum(np.sin(middle) * ahead + np.cos(middle) * aside)])
    return np.column_stack([x, y, wrap_angle(yaw)])


def _frozen(settings: Odometry, times_s: F64, draw: np.random.Generator) -> B1:
    """(n,) whether the counters stand still."""
    frozen = np.zeros(times_s.size, dtype=bool)
    if settings.freezes_per_hour == 0.0:
        return frozen
    begin = float(times_s[0]) + float(draw.exponential(3600.0 / settings.freezes_per_hour))
    while begin < times_s[-1]:
        frozen |= (times_s >= begin) & (times_s < begin + settings.freeze_s)
        begin += settings.freeze_s + float(draw.exponential(3600.0 / settings.freezes_per_hour))
    return frozen
