"""A map without a reference: how thin its walls are, how well it foretells scans, how often it contradicts itself."""

from __future__ import annotations

import math

import numpy as np
from scipy import ndimage

from dynmap_cli.arrays import B1, F32, F64, I32
from dynmap_cli.counting.counts import count_beams, end_cells
from dynmap_cli.counting.evidence import Evidence, EvidenceParams, surface_cells
from dynmap_cli.counting.frames import frame_of_scans
from dynmap_cli.domain.grid import FREE, GridFrame, frame_around
from dynmap_cli.domain.scans import ScanLog, end_points
from dynmap_cli.evaluation.scores import Score, mean_or_nan, ratio
from dynmap_cli.evaluation.truth import Run

LINE_CELL_M, LINE_REACH = 0.05, 2
"""End points within 5 x 5 cells of 5 cm make the local line."""
HELD_OUT_EVERY = 10
"""Every tenth scan is foretold from the others."""
_LEAST_POINTS, _LEAST_SIGMA_M, _PRIOR_HITS, _PRIOR_PASSES = 6, 0.001, 0.1, 0.1
_LOOKED_THROUGH = EvidenceParams(occupied_share=0.5, occupied_hits=1.0, free_share=0.5, free_cells=3.0)
"""An end point is looked through where beams crossed its surroundings for three cells and more than they hit."""
_WINDOW_SCANS = 1024


def line_sigmas_m(points: F64) -> F64:
    """Spread of the end points across the line through those around each cell, once per end point that has a line.

    The spread is the root of the smaller eigenvalue of the covariance of all end points in 5 x 5 cells of 5 cm.
    """
    if points.shape[0] == 0:
        return np.empty(0)
    frame = frame_around(points, LINE_CELL_M, LINE_CELL_M)
    rows, cols = frame.to_cells(points).T
    flat = rows * frame.cols + cols
    centred = points - points.mean(axis=0)
    x, y = centred[:, 0], centred[:, 1]

    def around(values: F64 | None) -> F64:
        summed = np.bincount(flat, values, frame.rows * frame.cols).reshape(frame.shape)
        for axis in (0, 1):
            summed = ndimage.correlate1d(summed, np.ones(2 * LINE_REACH + 1), axis=axis, mode="constant")
        return np.asarray(summed.ravel()[flat], dtype=np.float64)

    n = around(None)
    mean_x, mean_y = around(x) / n, around(y) / n
    xx, yy, xy = (
        around(x * x) / n - mean_x**2,
        around(y * y) / n - mean_y**2,
        around(x * y) / n - mean_x * mean_y,
    )
    smaller = 0.5 * (xx + yy) - np.sqrt(0.25 * (xx - yy) ** 2 + xy**2)
    sigmas = np.sqrt(np.maximum(smaller, _LEAST_SIGMA_M**2))
    return np.asarray(sigmas[n >= _LEAST_POINTS])


def held_out_log_likelihood(
    log: ScanLog, poses: F64, weights: F32, frame: GridFrame, usable_m: float
) -> float:
    """Mean log-likelihood (Eq. 1.1) of the beams of every tenth scan in the counting map of the others.

    Each cell starts with a tenth of a hit and of a passed cell, so that nothing is impossible.
    """
    held = np.arange(log.n_scans) % HELD_OUT_EVERY == HELD_OUT_EVERY // 2
    learned = count_beams(log.select(~held), poses[~held], frame, usable_m, weights=weights[~held])
    tested = log.select(held)
    asked = count_beams(tested, poses[held], frame, usable_m)
    hits = learned.static_hits + _PRIOR_HITS
    passes = learned.dynamic_hits + learned.passed_cells + _PRIOR_PASSES
    reflectance = hits / (hits + passes)
    total = (asked.static_hits * np.log(reflectance)).sum() + (
        asked.passed_cells * np.log1p(-reflectance)
    ).sum()
    return float(total) / max(int((end_cells(tested, poses[held], frame, usable_m) >= 0).sum()), 1)


def is_looked_through(log: ScanLog, poses: F64, frame: GridFrame, cells: I32) -> B1:
    """Whether other beams went through the cell in which a beam ends more than they ended there.

    Grazing beams say nothing; see `counting.evidence`.

    Parameters
    ----------
    log : ScanLog
    poses : (n_scans, 3) float64
    frame : GridFrame
    cells : (n_scans, n_beams) int32
        End cell of each beam, -1 = none.
    """
    windows = [slice(first, first + _WINDOW_SCANS) for first in range(0, log.n_scans, _WINDOW_SCANS)]
    surface = surface_cells(log, poses, frame, windows, _LOOKED_THROUGH)
    evidence = Evidence(surface, _LOOKED_THROUGH)
    evidence.add(log, poses)
    free = np.zeros(frame.rows * frame.cols + 1, dtype=bool)
    rows, cols = surface.cells[evidence.states() == FREE].T
    free[rows * frame.cols + cols] = True
    return np.asarray(free[cells])


def score_alone(name: str, run: Run) -> Score:
    """Sharpness, foretold likelihood and contradictions of a run."""
    log, poses, usable_m = run.log, run.poses, run.settings["usable_range_m"]
    frame = frame_of_scans(log, poses, usable_m, run.settings["resolution_m"])
    cells = end_cells(log, poses, frame, usable_m)
    near = (cells >= 0) & (np.asarray(log.ranges_m) <= _LOOKED_THROUGH.max_range_m)
    kept = (cells >= 0) & (run.static_probability >= 0.5)
    sigmas = line_sigmas_m(end_points(log, poses, kept))
    through = is_looked_through(log, poses, frame, cells)
    entropy = 0.5 * math.log(2.0 * math.pi * math.e) + mean_or_nan(np.log(sigmas))
    has_pose = np.isfinite(poses).all(axis=1)
    values = {
        "line_entropy_nats": entropy,
        "line_thickness_mm": 1000.0 * math.exp(mean_or_nan(np.log(sigmas))),
        "held_out_log_likelihood_per_beam": held_out_log_likelihood(
            log, poses, run.static_probability, frame, usable_m
        ),
        "looked_through_share": ratio(int((through & near).sum()), int(near.sum())),
        "looked_through_share_of_kept": ratio(int((through & near & kept).sum()), int((near & kept).sum())),
        "removed_share": ratio(int((run.static_probability < 0.5).sum()), int((cells >= 0).sum())),
    }
    return Score(name, float(has_pose.mean()) if has_pose.size else 0.0, values)
