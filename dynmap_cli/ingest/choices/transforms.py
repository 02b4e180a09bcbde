"""The arithmetic of frames: transforms in space as translations and unit quaternions x, y, z, w, and as matrices."""

from __future__ import annotations

import numpy as np

from dynmap_cli.arrays import B1, F64
from dynmap_cli.domain.poses import wrap_angle

SAME = 1e-10
"""Metres, and parts of a quaternion, by which a transform that is repeated may differ."""


def unit(quaternions: F64) -> F64:
    """Quaternions (n, 4) of unit length."""
    return np.asarray(quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True))


def are_same(quaternions: F64, other: F64) -> bool:
    """Whether quaternions (n, 4) all stand for one rotation; q and -q do."""
    off = np.minimum(np.abs(quaternions - other).max(axis=1), np.abs(quaternions + other).max(axis=1))
    return bool((off < SAME).all())


def slerp(start: F64, end: F64, share: F64) -> F64:
    """Quaternions (n, 4) at *share* (n, 1) of the shorter arc from start to end."""
    dot = np.sum(start * end, axis=1, keepdims=True)
    end = np.where(dot < 0.0, -end, end)
    angle = np.arccos(np.clip(np.abs(dot), 0.0, 1.0))
    is_short: B1 = angle < 1e-4
    sine = np.where(is_short, 1.0, np.sin(angle))
    a = np.where(is_short, 1.0 - share, np.sin((1.0 - share) * angle) / sine)
    b = np.where(is_short, share, np.sin(share * angle) / sine)
    mixed = a * start + b * end
    return np.asarray(mixed / np.linalg.norm(mixed, axis=1, keepdims=True))


def matrices(translations_m: F64, quaternions: F64) -> F64:
    """Homogeneous matrices (n, 4, 4) from translations (n, 3) and unit quaternions (n, 4) x, y, z, w."""
    x, y, z, w = quaternions.T
    result = np.zeros((quaternions.shape[0], 4, 4))
    result[:, 0, 0] = 1.0 - 2.0 * (y * y + z * z)
    result[:, 0, 1] = 2.0 * (x * y - z * w)
    result[:, 0, 2] = 2.0 * (x * z + y * w)
    result[:, 1, 0] = 2.0 * (x * y + z * w)
    result[:, 1, 1] = 1.0 - 2.0 * (x * x + z * z)
    result[:, 1, 2] = 2.0 * (y * z - x * w)
    result[:, 2, 0] = 2.0 * (x * z - y * w)
    result[:, 2, 1] = 2.0 * (y * z + x * w)
    result[:, 2, 2] = 1.0 - 2.0 * (x * x + y * y)
    result[:, :3, 3] = translations_m
    result[:, 3, 3] = 1.0
    return result


def inverse_matrices(poses: F64) -> F64:
    """Turn a_from_b into b_from_a, (n, 4, 4)."""
    result = np.zeros_like(poses)
    rotation = np.swapaxes(poses[:, :3, :3], 1, 2)
    result[:, :3, :3] = rotation
    result[:, :3, 3] = -(rotation @ poses[:, :3, 3:])[:, :, 0]
    result[:, 3, 3] = 1.0
    return result


def planar(poses: F64) -> F64:
    """(n, 4, 4) -> x, y and heading of the x axis (n, 3)."""
    yaw = np.arctan2(poses[:, 1, 0], poses[:, 0, 0])
    return np.column_stack([poses[:, 0, 3], poses[:, 1, 3], wrap_angle(yaw)])


def planar_of(values: F64) -> F64:
    """x, y and heading of the x axis (n, 3) of translations and quaternions of any length (n, 7)."""
    return planar(matrices(values[:, :3], unit(values[:, 3:])))


def put_at(values: F64, poses: F64) -> F64:
    """Translations and quaternions (n, 7) moved in the plane, and turned about z, to where their poses are (n, 3)."""
    result = values.copy()
    half_rad = (poses[:, 2] - planar_of(values)[:, 2]) / 2.0
    turn_z, turn_w = np.sin(half_rad), np.cos(half_rad)
    x, y, z, w = values[:, 3:].T
    result[:, :2] = poses[:, :2]
    result[:, 3:] = np.column_stack(
        [turn_w * x - turn_z * y, turn_w * y + turn_z * x, turn_w * z + turn_z * w, turn_w * w - turn_z * z]
    )
    return result
