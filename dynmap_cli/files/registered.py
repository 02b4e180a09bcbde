"""What later stages take from map/: poses of the scans, and in which order the beams of a sweep were made."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from dynmap_cli.arrays import F64
from dynmap_cli.domain.poses import Trajectory
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.errors import ArtifactError
from dynmap_cli.files.damage import refusing_damage
from dynmap_cli.files.npy import Column, read_npy
from dynmap_cli.files.scan_log import read_scan_log
from dynmap_cli.files.trajectory import read_tum, write_tum

TRAJECTORY, BEAM_INTERVALS = "trajectory.tum", "beam_interval_s.npy"
_REMEDY = "Run `dynmap map` again with --force."


def write_registered(map_dir: Path, trajectory: Trajectory, beam_interval_s: F64) -> None:
    """Write trajectory.tum and beam_interval_s.npy (n_geometries,)."""
    write_tum(map_dir / TRAJECTORY, trajectory)
    np.save(map_dir / BEAM_INTERVALS, np.ascontiguousarray(beam_interval_s, dtype="<f8"))


def read_registered(scans_dir: Path, map_dir: Path) -> tuple[ScanLog, Trajectory]:
    """Open the scans of a run with the times of their beams as the map has them, and read their poses.

    Raises
    ------
    ArtifactError
        If a file is missing or damaged, or the map is not of these scans.
    """
    log, trajectory = read_scan_log(scans_dir), read_tum(map_dir / TRAJECTORY)
    if not np.array_equal(trajectory.stamps_ns, log.stamps_ns):
        msg = f"{map_dir / TRAJECTORY}: not the trajectory of these scans. {_REMEDY}"
        raise ArtifactError(msg)
    path = map_dir / BEAM_INTERVALS
    with refusing_damage(f"{path}: not a readable table of beam intervals", _REMEDY, ArtifactError):
        intervals = read_npy(path, Column("<f8", log.beam_interval_s.shape), in_memory=True)
        if not np.isfinite(intervals).all():
            msg = "it has values that are no numbers"
            raise ValueError(msg)
    return replace(log, beam_interval_s=intervals), trajectory
