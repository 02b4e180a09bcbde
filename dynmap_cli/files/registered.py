"""What later stages take from map/: poses of the scans, the order of the beams of a sweep, where lasers are mounted."""

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

TRAJECTORY, BEAM_INTERVALS, MOUNTINGS = "trajectory.tum", "beam_interval_s.npy", "sensor_poses.npy"
_REMEDY = "Run `dynmap map` again with --force."


def write_registered(map_dir: Path, trajectory: Trajectory, beam_interval_s: F64) -> None:
    """Write trajectory.tum and beam_interval_s.npy (n_geometries,)."""
    write_tum(map_dir / TRAJECTORY, trajectory)
    np.save(map_dir / BEAM_INTERVALS, np.ascontiguousarray(beam_interval_s, dtype="<f8"))


def write_mountings(map_dir: Path, sensor_poses: F64) -> None:
    """Write sensor_poses.npy (n_geometries, 3), which stands for what the recording states."""
    np.save(map_dir / MOUNTINGS, np.ascontiguousarray(sensor_poses, dtype="<f8"))


def read_registered(scans_dir: Path, map_dir: Path) -> tuple[ScanLog, Trajectory]:
    """Open the scans of a run with times of their beams and mountings as the map has them, and read their poses.

    Raises
    ------
    ArtifactError
        If a file is missing or damaged, or the map is not of these scans.
    """
    log, trajectory = read_scan_log(scans_dir), read_tum(map_dir / TRAJECTORY)
    if not np.array_equal(trajectory.stamps_ns, log.stamps_ns):
        msg = f"{map_dir / TRAJECTORY}: not the trajectory of these scans. {_REMEDY}"
        raise ArtifactError(msg)
    intervals = _read_table(map_dir / BEAM_INTERVALS, log.beam_interval_s.shape, "beam intervals")
    sensor_poses = log.sensor_poses
    if (map_dir / MOUNTINGS).exists():
        sensor_poses = _read_table(map_dir / MOUNTINGS, sensor_poses.shape, "sensor poses")
    return replace(log, beam_interval_s=intervals, sensor_poses=sensor_poses), trajectory


def with_mountings_of(log: ScanLog, scans_dir: Path, map_dir: Path) -> tuple[ScanLog, str]:
    """Another recording, with lasers where the map found those stated to be in the same places; and what to say of it.

    The same wrong mounting is stated in every recording of a robot. What was stated stands in the scans of the run.
    """
    if not (map_dir / MOUNTINGS).exists():
        return log, ""
    if not scans_dir.exists():
        return log, (
            f"all lasers taken to be mounted as stated: which of them the map found elsewhere, {scans_dir} would tell"
        )
    stated = read_scan_log(scans_dir).sensor_poses
    found = _read_table(map_dir / MOUNTINGS, stated.shape, "sensor poses")
    mounted = log.sensor_poses.copy()
    for before, after in zip(stated, found, strict=True):
        mounted[(log.sensor_poses == before).all(axis=1)] = after
    moved = np.unique(log.sensor_poses[(mounted != log.sensor_poses).any(axis=1)], axis=0)
    if not moved.size:
        return log, ""
    lasers = "1 laser" if len(moved) == 1 else f"{len(moved)} lasers"
    told = f"{lasers} taken to be mounted as the map found it, not as stated"
    return replace(log, sensor_poses=mounted), told


def _read_table(path: Path, shape: tuple[int, ...], what: str) -> F64:
    """Numbers of each geometry."""
    with refusing_damage(f"{path}: not a readable table of {what}", _REMEDY, ArtifactError):
        values: F64 = read_npy(path, Column("<f8", shape), in_memory=True)
        if not np.isfinite(values).all():
            msg = "it has values that are no numbers"
            raise ValueError(msg)
    return values
