"""Which pose belongs to which time: nearest stamps, and how much of what was asked for has an answer."""

from __future__ import annotations

import numpy as np

from dynmap_cli.arrays import F64, I64
from dynmap_cli.domain.poses import Trajectory

MOST_APART_S = 0.05
"""A pose answers for a time that is at most this far away."""


def nearest_stamp(stamps_ns: I64, at_ns: I64, most_apart_s: float = MOST_APART_S) -> I64:
    """Index of the stamp nearest to each time, -1 where none is near enough.

    Parameters
    ----------
    stamps_ns : (n,) int64
        Ascending.
    at_ns : (m,) int64
    most_apart_s : float

    Returns
    -------
    (m,) int64
    """
    if stamps_ns.size == 0:
        return np.full(at_ns.size, -1, dtype=np.int64)
    right = np.clip(np.searchsorted(stamps_ns, at_ns), 0, stamps_ns.size - 1)
    left = np.maximum(right - 1, 0)
    best = np.where(np.abs(stamps_ns[left] - at_ns) <= np.abs(stamps_ns[right] - at_ns), left, right)
    return np.where(np.abs(stamps_ns[best] - at_ns) <= round(most_apart_s * 1e9), best, -1)


def known_poses(trajectory: Trajectory) -> Trajectory:
    """Only the poses that are numbers, in the order of their stamps."""
    known = np.isfinite(trajectory.poses).all(axis=1)
    order = np.argsort(trajectory.stamps_ns[known], kind="stable")
    return Trajectory(trajectory.stamps_ns[known][order], trajectory.poses[known][order])


def associate(estimate: Trajectory, reference: Trajectory) -> tuple[F64, F64, float]:
    """Pairs of poses of the same time, taken from the sparser trajectory to the denser one.

    Returns
    -------
    (n, 3) float64
        Estimated poses.
    (n, 3) float64
        Reference poses.
    float
        Coverage: share of the reference poses near which there is an estimate, where "near" follows the usual
        distance of the estimates, so that a slower sensor loses nothing and a gap does.
    """
    estimate, reference = known_poses(estimate), known_poses(reference)
    if estimate.stamps_ns.size <= reference.stamps_ns.size:
        there = nearest_stamp(reference.stamps_ns, estimate.stamps_ns)
        est, ref = estimate.poses[there >= 0], reference.poses[there[there >= 0]]
    else:
        there = nearest_stamp(estimate.stamps_ns, reference.stamps_ns)
        est, ref = estimate.poses[there[there >= 0]], reference.poses[there >= 0]
    usual_s = float(np.median(np.diff(estimate.stamps_ns))) * 1e-9 if estimate.stamps_ns.size > 1 else 0.0
    answered = nearest_stamp(estimate.stamps_ns, reference.stamps_ns, max(MOST_APART_S, 1.5 * usual_s)) >= 0
    return est, ref, float(answered.mean()) if answered.size else 0.0
