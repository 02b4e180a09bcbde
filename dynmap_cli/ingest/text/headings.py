"""Headings of a text log that are in degrees: those along which the robot drives are."""

from __future__ import annotations

import numpy as np

from dynmap_cli.arrays import F64

_LEAST_STEP_M, _LEAST_STEPS = 0.02, 50
_LARGEST_RAD, _LARGEST_DEG = 7.0, 361.0
_ALONG, _NOT_ALONG = 0.8, 0.5


def are_headings_degrees(poses: F64) -> bool:
    """Whether a robot drives, forwards or backwards, along its headings only if these are degrees; poses (n, 3)."""
    largest = np.abs(poses[:, 2]).max(initial=0.0)
    if not _LARGEST_RAD < largest <= _LARGEST_DEG:
        return False
    steps = np.diff(poses[:, :2], axis=0)
    is_long = np.hypot(*steps.T) > _LEAST_STEP_M
    if np.count_nonzero(is_long) < _LEAST_STEPS:
        return False
    directions = np.arctan2(steps[is_long, 1], steps[is_long, 0])
    headings = poses[:-1, 2][is_long]
    return _along(directions, np.radians(headings)) > _ALONG and _along(directions, headings) < _NOT_ALONG


def _along(directions: F64, headings_rad: F64) -> float:
    """1 where all directions are those of headings or their opposites, 0 where they have nothing in common."""
    return float(np.cos(2.0 * (directions - headings_rad)).mean())
