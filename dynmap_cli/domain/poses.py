"""Poses in the plane: (x, y, yaw) in metres and radians, as the last axis of float64 arrays.

`map_from_robot` reads from right to left: it takes a point in the robot frame into the map frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import F64, I64

_ROWS_AT_ONCE = 1 << 16
"""What is computed on the way takes many times the memory of the poses."""


def wrap_angle(angle_rad: F64) -> F64:
    """Bring angles into [-pi, pi)."""
    return np.asarray((angle_rad + np.pi) % (2.0 * np.pi) - np.pi)


def compose(a_from_b: F64, b_from_c: F64) -> F64:
    """Chain two poses, a_from_c; shapes (..., 3) broadcast."""
    a, b = np.asarray(a_from_b, dtype=np.float64), np.asarray(b_from_c, dtype=np.float64)
    cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack(
        [
            a[..., 0] + cos * b[..., 0] - sin * b[..., 1],
            a[..., 1] + sin * b[..., 0] + cos * b[..., 1],
            wrap_angle(a[..., 2] + b[..., 2]),
        ],
        axis=-1,
    )


def inverse(a_from_b: F64) -> F64:
    """Turn a_from_b into b_from_a."""
    a = np.asarray(a_from_b, dtype=np.float64)
    cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack(
        [
            -cos * a[..., 0] - sin * a[..., 1],
            sin * a[..., 0] - cos * a[..., 1],
            wrap_angle(-a[..., 2]),
        ],
        axis=-1,
    )


def between(w_from_a: F64, w_from_b: F64) -> F64:
    """Pose of b seen from a; shapes (..., 3) broadcast."""
    a, b = np.asarray(w_from_a, dtype=np.float64), np.asarray(w_from_b, dtype=np.float64)
    if a.shape != b.shape or a.ndim != 2:
        return compose(inverse(a), b)
    result = np.empty(a.shape)
    for first in range(0, a.shape[0], _ROWS_AT_ONCE):
        rows = slice(first, first + _ROWS_AT_ONCE)
        result[rows] = compose(inverse(a[rows]), b[rows])
    return result


def transform_points(a_from_b: F64, points_b: F64) -> F64:
    """Take points (..., 2) of frame b into frame a; the pose's leading axes broadcast."""
    a = np.asarray(a_from_b, dtype=np.float64)
    cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
    x, y = points_b[..., 0], points_b[..., 1]
    return np.stack([a[..., 0] + cos * x - sin * y, a[..., 1] + sin * x + cos * y], axis=-1)


def interpolate(stamps_ns: I64, poses: F64, at_ns: I64) -> F64:
    """Pose at each time, linear in position and along the shorter arc in yaw; NaN outside the span.

    Parameters
    ----------
    stamps_ns : (n,) int64
        Ascending times of *poses*, nanoseconds.
    poses : (n, 3) float64
    at_ns : (m,) int64

    Returns
    -------
    (m, 3) float64
    """
    if stamps_ns.size == 0:
        return np.full((at_ns.size, 3), np.nan)
    right = np.clip(np.searchsorted(stamps_ns, at_ns, side="left"), 1, max(stamps_ns.size - 1, 1))
    left = right - 1
    right = np.minimum(right, stamps_ns.size - 1)
    span = np.maximum(stamps_ns[right] - stamps_ns[left], 1).astype(np.float64)
    share = (at_ns - stamps_ns[left]).astype(np.float64) / span
    delta = poses[right] - poses[left]
    delta[:, 2] = wrap_angle(delta[:, 2])
    result = poses[left] + share[:, None] * delta
    result[:, 2] = wrap_angle(result[:, 2])
    result[(at_ns < stamps_ns[0]) | (at_ns > stamps_ns[-1])] = np.nan
    return np.asarray(result)


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Where the robot was, one pose per scan.

    Attributes
    ----------
    stamps_ns : (n,) int64
        Header stamp of the scan, nanoseconds, ascending.
    poses : (n, 3) float64
        map_from_robot: x, y in metres, yaw in radians; all finite.
    """

    stamps_ns: I64
    poses: F64

    def __post_init__(self) -> None:
        """Check that each stamp has a pose."""
        if self.poses.shape != (self.stamps_ns.size, 3):
            msg = f"{self.stamps_ns.size} stamps, but poses of shape {self.poses.shape}"
            raise ValueError(msg)

    def length_m(self) -> float:
        """Distance travelled, metres."""
        return float(np.linalg.norm(np.diff(self.poses[:, :2], axis=0), axis=1).sum())
