"""The grid that holds what scans saw."""

from __future__ import annotations

import numpy as np

from dynmap_cli.arrays import F64
from dynmap_cli.counting.counts import SCANS_PER_CHUNK, rays_of
from dynmap_cli.domain.grid import GridFrame, frame_around
from dynmap_cli.domain.mapped import copied_rows
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.errors import LogError
from dynmap_cli.kernels.beams import widen_bounds

_JUMP_M, _JUMP_MPS = 100.0, 100.0


def frame_of_scans(log: ScanLog, poses: F64, usable_range_m: float, resolution_m: float) -> GridFrame:
    """Frame that holds every pose and every end point, and beams without return up to the farthest hit.

    Raises
    ------
    LogError
        If the path jumps, or they lie too far apart for a grid.
    """
    _refuse_jumps(log, poses)
    rays = rays_of(log, usable_range_m)
    known = poses[np.isfinite(poses).all(axis=1), :2]
    bounds = np.concatenate([known.min(axis=0, initial=np.inf), known.max(axis=0, initial=-np.inf)])
    for first in range(0, log.n_scans, SCANS_PER_CHUNK):
        part = slice(first, first + SCANS_PER_CHUNK)
        widen_bounds(
            copied_rows(log.ranges_m, part),
            np.array(log.geometry_index[part]),
            rays,
            np.array(poses[part], dtype=np.float64),
            bounds,
        )
    corners = bounds.reshape(2, 2) if known.size else known
    try:
        return frame_around(corners, resolution_m, 2 * resolution_m)
    except ValueError as err:
        msg = (
            f"{', '.join(log.recordings)}: {err}. Check odometry, tf and --laser-pose with `dynmap check`, "
            "or choose a larger map.resolution_m."
        )
        raise LogError(msg) from err


def _refuse_jumps(log: ScanLog, poses: F64) -> None:
    """Refuse a path that no robot drives; a grid around both ends of a jump would be nearly empty, and huge."""
    order = np.argsort(log.arrival_index, kind="stable")
    known = order[np.isfinite(poses[order]).all(axis=1)]
    steps_m = np.hypot(*np.diff(poses[known, :2], axis=0).T)
    gaps_s = np.abs(np.diff(log.stamps_ns[known])) * 1e-9
    jumps = np.flatnonzero(steps_m > _JUMP_M + _JUMP_MPS * gaps_s)
    if jumps.size:
        first = jumps[0]
        msg = (
            f"{', '.join(log.recordings)}: the path jumps by {steps_m[first]:.4g} m between two scans that are "
            f"{gaps_s[first]:.3g} s apart, at most {_JUMP_M:g} m and {_JUMP_MPS:g} m/s are taken for a drive. "
            "Check the odometry with `dynmap check`; pass --odom to choose another one, or none."
        )
        raise LogError(msg)
