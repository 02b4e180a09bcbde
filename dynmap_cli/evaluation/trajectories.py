"""Absolute and relative trajectory error (Sturm et al., IROS 2012), in the plane."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from dynmap_cli.arrays import F64, I64
from dynmap_cli.domain.poses import Trajectory, between, compose, transform_points
from dynmap_cli.errors import ArtifactError
from dynmap_cli.evaluation.association import associate
from dynmap_cli.evaluation.scores import Score, mean_or_nan
from dynmap_cli.files.damage import reason
from dynmap_cli.files.documents import MAX_TABLE_BYTES, read_text
from dynmap_cli.files.trajectory import parse_stamp, read_tum

_INDEX_TABLE = "raw_scan_index"
LEAST_POSES = 2


def align(points: F64, reference: F64) -> F64:
    """Pose reference_from_estimate that brings points closest to their partners (Umeyama 1991, no scale).

    Parameters
    ----------
    points, reference : (n, 2) float64
    """
    mean, target = points.mean(axis=0), reference.mean(axis=0)
    a, b = points - mean, reference - target
    yaw = math.atan2(float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()), float((a * b).sum()))
    turned = transform_points(np.array([0.0, 0.0, yaw]), mean)
    return np.array([target[0] - turned[0], target[1] - turned[1], yaw])


def absolute_errors_m(estimate: F64, reference: F64) -> F64:
    """(n,) distance of each pose from its partner after alignment."""
    aligned = compose(align(estimate[:, :2], reference[:, :2]), estimate)
    return np.asarray(np.linalg.norm(aligned[:, :2] - reference[:, :2], axis=1))


def relative_errors(estimate: F64, reference: F64, ids: I64) -> F64:
    """(n - 1, 3) error of the motion between consecutive *ids*: (reference motion)^-1 estimated motion."""
    true_motion = between(reference[ids[:-1]], reference[ids[1:]])
    return between(true_motion, between(estimate[ids[:-1]], estimate[ids[1:]]))


def every_metres(reference: F64, step_m: float) -> I64:
    """Indices of poses, each the first that is *step_m* of path beyond the one before."""
    ids, path = [0], 0.0
    for number, length in enumerate(np.linalg.norm(np.diff(reference[:, :2], axis=0), axis=1), start=1):
        path += float(length)
        if path >= step_m:
            ids.append(number)
            path = 0.0
    return np.array(ids, dtype=np.int64)


def score_trajectory(name: str, estimate: Trajectory, reference: Trajectory) -> Score:
    """ATE after SE(2) alignment, RPE from pose to pose and over one metre of the reference path."""
    est, ref, coverage = associate(estimate, reference)
    values = {"poses": float(est.shape[0])}
    if est.shape[0] < LEAST_POSES:
        est = ref = np.full((LEAST_POSES, 3), np.nan)
    absolute = absolute_errors_m(est, ref)
    values["ate_rmse_m"] = _rms(absolute)
    values |= {
        f"ate_{word}_m": float(f(absolute))
        for word, f in (("mean", np.mean), ("median", np.median), ("max", np.max))
    }
    for label, ids in (("step", np.arange(est.shape[0])), ("1m", every_metres(ref, 1.0))):
        errors = relative_errors(est, ref, ids)
        values[f"rpe_{label}_translation_rmse_m"] = _rms(np.hypot(errors[:, 0], errors[:, 1]))
        values[f"rpe_{label}_rotation_rmse_deg"] = _rms(np.degrees(errors[:, 2]))
    aligned = compose(align(est[:, :2], ref[:, :2]), est)
    series = {"reference": ref[:, :2], "estimate, aligned": aligned[:, :2]}
    return Score(name, coverage, values, series=series)


def read_reference(path: Path) -> Trajectory:
    """Read a TUM file, or a table `raw_scan_index raw_timestamp x y theta ...` that says so in a comment."""
    try:
        text = read_text(path, MAX_TABLE_BYTES)
    except (OSError, ValueError) as err:
        msg = f"{path}: not a readable trajectory ({reason(err)})"
        raise ArtifactError(msg) from err
    if _INDEX_TABLE not in text[:2000]:
        return read_tum(path)
    rows = [line.split() for line in text.splitlines() if line.strip() and not line.startswith("#")]
    try:
        stamps = np.array([parse_stamp(row[1]) for row in rows], dtype=np.int64)
        poses = np.array([[float(word) for word in row[2:5]] for row in rows]).reshape(-1, 3)
    except (ValueError, IndexError) as err:
        msg = f"{path}: expected lines of 'raw_scan_index raw_timestamp x y theta ...' ({reason(err)})"
        raise ArtifactError(msg) from err
    return Trajectory(stamps, poses)


def _rms(errors: F64) -> float:
    return math.sqrt(mean_or_nan(errors**2))
