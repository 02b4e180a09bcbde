"""From true distances to what a laser reports, and what each beam truly met."""

from __future__ import annotations

import math

import numpy as np

from dynmap_cli.arrays import F32, F64, I32
from dynmap_cli.simulation.robot import Laser

STATIC, MOVING, NO_RETURN, MIXED, FIRST_OBJECT = 0, 1, 2, 3, 10
"""Classes of beams: a wall; something that moves; no end point; an end point between two surfaces;
FIRST_OBJECT + k: door or box k."""
_EDGE_M = 0.15
_FLOOR_M = (0.5, 3.0)


def bearings_of(laser: Laser) -> F64:
    """(n_beams,) direction of each beam; both ends of the field of view belong to it, except in a full circle."""
    gaps = laser.beams if laser.fov_deg >= 360.0 else laser.beams - 1
    step = math.radians(laser.fov_deg) / gaps
    bearings = -math.radians(laser.fov_deg) / 2.0 + step * np.arange(laser.beams, dtype=np.float64)
    return -bearings if laser.clockwise else bearings


def hide_behind_floor(ranges: F64, classes: I32, bearings: F64, draw: np.random.Generator) -> None:
    """What a laser sees that somebody holds: tilted, so that beams of one side meet the floor before anything else.

    Parameters
    ----------
    ranges : (n_scans, n_beams) float64
        Distance to what each beam would meet; changed in place.
    classes : (n_scans, n_beams) int32
        Likewise.
    bearings : (n_beams,) float64
    draw : Generator
    """
    steepest = draw.uniform(-math.pi, math.pi, (ranges.shape[0], 1))
    floor_m = draw.uniform(*_FLOOR_M, (ranges.shape[0], 1))
    away = np.maximum(np.cos(bearings - steepest), 1e-3)
    hidden = floor_m / away < ranges
    ranges[hidden] = (floor_m / away)[hidden]
    classes[hidden] = MOVING


def measure(
    true_ranges: F64, cosines: F64, classes: I32, laser: Laser, draw: np.random.Generator
) -> tuple[F32, I32]:
    """What the laser reports, and the class of each beam.

    Parameters
    ----------
    true_ranges : (n_scans, n_beams) float64
        Distance to what each beam meets first; inf = nothing.
    cosines : (n_scans, n_beams) float64
        Cosine of the angle of incidence.
    classes : (n_scans, n_beams) int32
    laser : Laser
    draw : Generator

    Returns
    -------
    (n_scans, n_beams) float32
        +inf = nothing came back, NaN = too close to be measured.
    (n_scans, n_beams) int32
    """
    ranges, classes = true_ranges.copy(), classes.copy()
    if laser.mixed_share > 0.0:
        _mix_edges(ranges, classes, laser.mixed_share, draw)
    hit = np.isfinite(ranges)
    spread = laser.noise_m + laser.noise_share * np.where(hit, ranges, 0.0)
    ranges += spread * draw.standard_normal(ranges.shape)
    lost = np.zeros(ranges.shape, dtype=bool)
    if laser.dropout_share > 0.0 or laser.grazing_deg > 0.0:
        lost = draw.random(ranges.shape) < _loss(cosines, laser)
    gone = lost | (ranges > laser.max_range_m)
    ranges[gone] = np.inf
    too_close = ranges < laser.min_range_m
    ranges[too_close] = np.nan
    classes[gone | too_close] = NO_RETURN
    return ranges.astype(np.float32), classes


def _mix_edges(ranges: F64, classes: I32, share: float, draw: np.random.Generator) -> None:
    """Let some beams at the edge of a nearer surface end between it and the farther one."""
    ended = np.isfinite(ranges)
    step = np.diff(np.where(ended, ranges, 0.0), axis=1)
    edges = ended[:, :-1] & ended[:, 1:] & (np.abs(step) > _EDGE_M)
    chosen = np.zeros(ranges.shape, dtype=bool)
    chosen[:, :-1] = edges & (draw.random(edges.shape) < share)
    between = draw.random(ranges.shape)
    ranges[chosen] += between[chosen] * step[chosen[:, :-1]]
    classes[chosen] = MIXED


def _loss(cosines: F64, laser: Laser) -> F64:
    """Probability that a return gets lost: everywhere a little, at grazing angles surely."""
    if laser.grazing_deg == 0.0:
        return np.full(cosines.shape, laser.dropout_share)
    angle_deg = np.degrees(np.arcsin(np.clip(cosines, 0.0, 1.0)))
    grazing = np.clip(1.0 - angle_deg / laser.grazing_deg, 0.0, 1.0)
    return np.asarray(1.0 - (1.0 - laser.dropout_share) * (1.0 - grazing))
