r"""Odometry whose positions go another way than its headings say: axes exchanged, a sign, a driver a quarter turn off.

A robot mostly drives along its x axis. Where its odometry says otherwise, the sweeps tell which way it went, for some
drive sideways. From one sweep to a next one ranges r at bearing b, u = (cos b, sin b), v = (-sin b, cos b), change by

.. math::
    \Delta r = -d \cdot u + \frac{r'}{r} d \cdot v + r' \varphi

where the laser moves by d and turns by phi (the range flow of Gonzalez and Gutierrez, 1999): three unknowns of as many
equations as there are beams.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynmap_cli.arrays import B1, F32, F64, I64
from dynmap_cli.domain.mapped import give_back
from dynmap_cli.domain.poses import wrap_angle
from dynmap_cli.ingest.choices.frames import Mounting
from dynmap_cli.ingest.choices.merging import Columns
from dynmap_cli.ingest.choices.odometry_sources import Odometry
from dynmap_cli.ingest.choices.turns import ScanTurns, agreement_at
from dynmap_cli.ingest.raw.columns import counts_of
from dynmap_cli.ingest.raw.laser import ScanShape
from dynmap_cli.ingest.raw.recording import RawRecording

_SPAN_S, _LEAST_PERIOD_S = 0.2, 1e-3
_MOST_LOOKED_AT, _MOST_PAIRS, _LEAST_PAIRS = 1000, 200, 25
_STEPS_M, _MOST_TURN_RAD = (0.03, 0.5), 0.1
_ALONG, _ALONG_RAD = 0.8, np.radians(30.0)
_OFF_RAD, _FITS_RAD, _CLEARLY = np.radians(30.0), np.radians(15.0), 0.4
_QUARTER_RAD, _SNAP_RAD = np.pi / 2.0, np.radians(5.0)
_MOST_SLOPE_M, _MOST_CHANGE_M, _OUTLIERS, _LEAST_KNOWN = 0.3, 0.6, 3.0, 0.03
_LEAST_BEAMS, _ROUNDS = 20, 3
_OTHER_Y, _OTHER_YAW = np.array([1.0, -1.0, 1.0]), np.array([1.0, 1.0, -1.0])
C128 = NDArray[np.complex128]


def mend_heading(
    odometry: Odometry, columns: Columns, turns: ScanTurns, mounting: Mounting, recording: RawRecording
) -> Odometry:
    """Bring positions and headings of an odometry together where the sweeps clearly tell how; says so.

    Parameters
    ----------
    odometry : Odometry
    columns : Columns
        Its first laser is the one that is looked at.
    turns : ScanTurns
        Of that laser, as the robot turned.
    mounting : Mounting
        Of that laser.
    recording : RawRecording
        Gets the warning.
    """
    counts = counts_of(columns.geometry_index, len(columns.geometries))
    counts[[laser != 0 for laser, _ in columns.geometries]] = 0
    usual = int(np.argmax(counts))
    if columns.geometries[usual][1].n_beams < _LEAST_BEAMS:
        return odometry
    rows, others = _pairs(columns, usual, odometry.poses)
    if rows.size < _LEAST_PAIRS or _drives_along(odometry.poses[rows], odometry.poses[others]):
        return odometry
    few = np.unique(np.linspace(0, rows.size - 1, min(_MOST_PAIRS, rows.size)).astype(np.int64))
    rows, others = rows[few], others[few]
    moved, is_known = _moved_by_sweeps(columns, rows, others, mounting)
    rows, others, moved = rows[is_known], others[is_known], moved[is_known]
    if rows.size < _LEAST_PAIRS:
        return odometry
    first, second = odometry.poses[rows], odometry.poses[others]
    off_rad = _off_rad(moved, first, second)
    as_is_rad = float(np.median(np.abs(off_rad)))
    if as_is_rad < _OFF_RAD:
        return odometry
    turned = agreement_at(turns, columns.stamps_ns, odometry.poses)
    signs, told = (_OTHER_YAW if turned.opposite_rad < turned.same_rad else _OTHER_Y), []
    mirrored_rad = _off_rad(moved, first * signs, second * signs)
    poses = odometry.poses.copy()
    if _left_rad(mirrored_rad) < _CLEARLY * _left_rad(off_rad):
        off_rad, poses = mirrored_rad, poses * signs
        told.append("the sign of its headings" if signs is _OTHER_YAW else "the sign of its y")
    left_rad, turn_rad = _left_rad(off_rad), _snapped(_middle_rad(off_rad))
    what = (
        f"odometry {odometry.source}: its positions go {np.degrees(as_is_rad):.0f} deg off the way that its headings "
        f"and the scans show, in the median of {rows.size} steps"
    )
    if left_rad > min(_FITS_RAD, _CLEARLY * as_is_rad):
        recording.warnings.append(
            f"{what}, and nothing simple mends that; if the map comes out bent, pass --odom none"
        )
        return odometry
    poses[:, 2] = wrap_angle(poses[:, 2] - turn_rad)
    if turn_rad:
        told.append(f"its headings by {np.degrees(float(wrap_angle(np.array(-turn_rad)))):+.0f} deg")
    recording.warnings.append(
        f"{what}, as where a driver exchanges axes; mended, {np.degrees(left_rad):.0f} deg are left: changed are "
        f"{' and '.join(told)}"
    )
    return replace(odometry, poses=poses)


def _off_rad(moved: C128, first: F64, second: F64) -> F64:
    """Angles (m,) from the steps between poses (m, 3), in the frame of the robot, to those that the sweeps show."""
    steps = (second[:, 0] - first[:, 0]) + 1j * (second[:, 1] - first[:, 1])
    return np.asarray(np.angle(moved * np.conj(steps * np.exp(-1j * first[:, 2]))))


def _pairs(columns: Columns, geometry: int, poses: F64) -> tuple[I64, I64]:
    """Numbers (m,) of sweeps of one geometry, and of later ones, a short and straight step apart."""
    own = np.flatnonzero(columns.geometry_index == geometry)
    if own.size <= _LEAST_PAIRS:
        return own[:0], own[:0]
    looks = np.linspace(0, own.size - 2, min(_MOST_LOOKED_AT, own.size - 1)).astype(np.int64)
    stamps_ns = columns.stamps_ns
    period_s = max(
        float(np.median(stamps_ns[own[looks + 1]] - stamps_ns[own[looks]])) * 1e-9, _LEAST_PERIOD_S
    )
    apart = min(max(1, round(_SPAN_S / period_s)), own.size - 1)
    looks = np.minimum(looks, own.size - 1 - apart)
    rows, others = own[looks], own[looks + apart]
    steps = poses[others] - poses[rows]
    step_m = np.hypot(steps[:, 0], steps[:, 1])
    is_straight = np.abs(wrap_angle(steps[:, 2])) < _MOST_TURN_RAD
    is_good = (step_m > _STEPS_M[0]) & (step_m < _STEPS_M[1]) & is_straight
    return rows[is_good], others[is_good]


def _drives_along(first: F64, second: F64) -> bool:
    """Whether a robot drives along its x axis, more forward than back, by poses (m, 3) before and after steps."""
    steps = (second[:, 0] - first[:, 0]) + 1j * (second[:, 1] - first[:, 1])
    return _is_ahead(steps * np.exp(-1j * (first[:, 2] + wrap_angle(second[:, 2] - first[:, 2]) / 2.0)))


def _is_ahead(steps: C128) -> bool:
    """Whether steps (m,) in the frame of the robot lie along its x axis, more of them forward than back."""
    axis = np.sum(np.abs(steps) * np.exp(2j * np.angle(steps))) / np.sum(np.abs(steps))
    is_along = np.abs(axis) > _ALONG and abs(np.angle(axis)) / 2.0 < _ALONG_RAD
    return bool(is_along and steps.real.sum() > 0.0)


def _middle_rad(angles_rad: F64) -> float:
    """The angle from which angles (m,) differ least: the median around their mean direction."""
    mean_rad = float(np.angle(np.exp(1j * angles_rad).sum()))
    return mean_rad + float(np.median(wrap_angle(angles_rad - mean_rad)))


def _left_rad(angles_rad: F64) -> float:
    """Median difference of angles (m,) from their middle."""
    return float(np.median(np.abs(wrap_angle(angles_rad - _middle_rad(angles_rad)))))


def _snapped(angle_rad: float) -> float:
    """A quarter turn or none where an angle is nearly that: axes are exchanged, hardly ever turned a little."""
    quarter_rad = round(angle_rad / _QUARTER_RAD) * _QUARTER_RAD
    return quarter_rad if abs(angle_rad - quarter_rad) < _SNAP_RAD else angle_rad


def _moved_by_sweeps(columns: Columns, rows: I64, others: I64, mounting: Mounting) -> tuple[C128, B1]:
    """How the robot moved between sweeps, x + iy (m,) in its frame before, and where (m,) that is known."""
    _, shape = columns.geometries[int(columns.geometry_index[rows[0]])]
    before, after = (_returns(columns.ranges_m[picked, : shape.n_beams], shape) for picked in (rows, others))
    give_back(columns.ranges_m)
    bearings_rad = shape.bearings_rad * (-1.0 if mounting.is_upside_down else 1.0)
    moved, turned_rad, is_known = range_flow(before, after, bearings_rad)
    x, y, yaw_rad = mounting.robot_from_sensor
    lever = complex(x, y)
    return moved * np.exp(1j * yaw_rad) - (np.exp(1j * turned_rad) - 1.0) * lever, is_known


def _returns(ranges_m: F32, shape: ScanShape) -> F64:
    """Ranges (m, n_beams), NaN where they are no returns."""
    values = np.asarray(ranges_m, dtype=np.float64)
    values[~((values > shape.range_min_m) & (values > 0.0) & (values < shape.range_max_m))] = np.nan
    return values


def range_flow(before: F64, after: F64, bearings_rad: F64) -> tuple[C128, F64, B1]:
    """How a laser moved between pairs of its sweeps, by the changes of its ranges.

    Parameters
    ----------
    before, after : (m, n_beams) float64
        Ranges in metres; NaN = no return.
    bearings_rad : (n_beams,) float64

    Returns
    -------
    moved : (m,) complex128
        x + iy in metres, in the frame of the laser before.
    turned_rad : (m,) float64
    is_known : (m,) bool
        Whether the beams say how far it moved in both directions.
    """
    middle = (before + after) / 2.0
    rise = middle[:, 2:] - middle[:, :-2]
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = rise / (bearings_rad[2:] - bearings_rad[:-2])
    along = np.exp(1j * bearings_rad[1:-1])
    change, range_m = (after - before)[:, 1:-1], middle[:, 1:-1]
    factor = -along + slope / range_m * (1j * along)
    columns = np.stack([factor.real, factor.imag, slope], axis=2)
    is_used = np.isfinite(columns).all(axis=2) & np.isfinite(change)
    is_used &= (np.abs(rise) < _MOST_SLOPE_M) & (np.abs(change) < _MOST_CHANGE_M)
    # A code for no return stays exactly the same.
    is_used &= (rise != 0.0) | (change != 0.0)
    columns[~is_used], change = 0.0, np.where(is_used, change, 0.0)
    weights = is_used.astype(np.float64)
    found = np.zeros((before.shape[0], 3))
    for _ in range(_ROUNDS):
        normal = np.einsum("mb,mbi,mbj->mij", weights, columns, columns) + 1e-9 * np.eye(3)
        found = np.linalg.solve(normal, np.einsum("mb,mbi,mb->mi", weights, columns, change)[..., None])[
            ..., 0
        ]
        off_m = np.abs(change - np.einsum("mbi,mi->mb", columns, found))
        off_m[~is_used] = np.nan
        with np.errstate(invalid="ignore"):
            usual_m = np.nanmedian(np.where(is_used.any(axis=1, keepdims=True), off_m, 0.0), axis=1)
            weights = (is_used & (off_m <= _OUTLIERS * usual_m[:, None])).astype(np.float64)
    # What is known of the way where the turn is not: the turn is eliminated from the equations.
    schur = normal[:, :2, :2] - normal[:, :2, 2:] * normal[:, 2:, :2] / normal[:, 2:, 2:]
    n_used = np.count_nonzero(is_used, axis=1)
    is_known = (n_used >= _LEAST_BEAMS) & (
        np.linalg.eigvalsh(schur)[:, 0] > _LEAST_KNOWN * np.maximum(n_used, 1)
    )
    return found[:, 0] + 1j * found[:, 1], found[:, 2], is_known
