"""A run with known truth: a square room, a robot in its middle, somebody who walks about."""

from pathlib import Path

import numpy as np

from dynmap_cli.domain.poses import Trajectory
from dynmap_cli.domain.scans import single_laser_log
from dynmap_cli.evaluation.truth import Run, Truth

N_SCANS, N_BEAMS = 60, 90
SETTINGS = {
    "resolution_m": 0.05,
    "usable_range_m": 30.0,
    "static_prior": 0.95,
    "support_cells": 1,
    "stop_at_walls": True,
    "look_s": 5.0,
    "look_prior": 0.8,
}


def room(seed=0, static_probability=None):
    """Return a run and its truth; without e, all labels are right."""
    draw = np.random.default_rng(seed)
    bearings = np.linspace(-np.pi, np.pi, N_BEAMS, endpoint=False)
    poses = np.column_stack([np.linspace(-1.0, 1.0, N_SCANS), np.zeros(N_SCANS), np.zeros(N_SCANS)])
    stamps = 10**18 + np.arange(N_SCANS, dtype=np.int64) * 200_000_000
    cos, sin = np.cos(bearings), np.sin(bearings)
    with np.errstate(divide="ignore"):
        along_x = np.where(cos > 0, (3.0 - poses[:, :1]) / cos, (-3.0 - poses[:, :1]) / cos)
        along_y = np.abs(3.0 / sin)
    ranges = np.minimum(along_x, along_y) + draw.normal(0.0, 0.005, (N_SCANS, N_BEAMS))
    classes = np.zeros((N_SCANS, N_BEAMS), dtype=np.int32)
    walker = (np.arange(N_SCANS)[:, None] * 2 + np.arange(5)) % N_BEAMS
    rows = np.arange(N_SCANS)[:, None]
    ranges[rows, walker] = 1.2
    classes[rows, walker] = 1
    ranges[:, 0], classes[:, 0] = np.inf, 2
    log = single_laser_log(stamps, ranges.astype(np.float32), bearings, poses)
    truth = Truth(Trajectory(stamps, poses), classes, np.zeros((N_SCANS, 0), np.int32), (), 0, 1, 2, 3, 10)
    if static_probability is None:
        static_probability = np.where(classes == 1, 0.0, 1.0).astype(np.float32)
        static_probability[classes == 2] = np.nan
    return Run(Path("run"), log, poses, static_probability, np.zeros(classes.shape, bool), SETTINGS), truth
