"""map/reflectance.npz and map/beams.npz."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path

import numpy as np

from dynmap_cli.arrays import F32, I64
from dynmap_cli.domain.grid import CountingMap, GridFrame
from dynmap_cli.errors import ArtifactError

DAMAGE = (OSError, EOFError, KeyError, TypeError, ValueError, zipfile.BadZipFile, zlib.error)
"""What numpy raises on files that are missing, cut off, damaged or of something else."""


def write_counting_map(path: Path, counting_map: CountingMap) -> None:
    """Write hits, passed length, reflectance m, hit centroids and the frame."""
    frame = counting_map.frame
    np.savez_compressed(
        path,
        static_hits=counting_map.static_hits.astype(np.float32),
        dynamic_hits=counting_map.dynamic_hits.astype(np.float32),
        passed_cells=counting_map.passed_cells.astype(np.float32),
        reflectance=counting_map.reflectance.astype(np.float32),
        centroids_m=counting_map.centroids_m.astype(np.float32),
        resolution_m=np.float64(frame.resolution_m),
        origin_m=np.array([frame.origin_x_m, frame.origin_y_m]),
    )


def read_counting_map(path: Path) -> CountingMap:
    """Read what `write_counting_map` wrote."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            columns = {
                name: archive[name].astype(np.float64)
                for name in ("static_hits", "dynamic_hits", "passed_cells", "centroids_m")
            }
            x, y = (float(value) for value in archive["origin_m"])
            rows, cols = columns["static_hits"].shape
            return CountingMap(GridFrame(float(archive["resolution_m"]), x, y, rows, cols), **columns)
    except DAMAGE as err:
        msg = f"{path}: not a readable counting map ({err}). Run `dynmap map` again with --force."
        raise ArtifactError(msg) from err


def write_beams(path: Path, stamps_ns: I64, static_probability: F32) -> None:
    """Write e of each beam: (n_scans, n_beams) float32, NaN where a beam has no end point."""
    np.savez_compressed(path, stamps_ns=stamps_ns, static_probability=static_probability.astype(np.float32))


def read_beams(path: Path) -> F32:
    """Read e of each beam."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            return np.asarray(archive["static_probability"], dtype=np.float32)
    except DAMAGE as err:
        msg = f"{path}: not a readable table of beams ({err}). Run `dynmap map` again with --force."
        raise ArtifactError(msg) from err
