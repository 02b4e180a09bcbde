"""map/reflectance.npz and map/beams.npz."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynmap_cli.arrays import B1, F32, F64, I64
from dynmap_cli.domain.grid import FARTHEST_M, MAX_CELLS, RESOLUTIONS_M, CountingMap, GridFrame
from dynmap_cli.domain.mapped import give_back
from dynmap_cli.errors import ArtifactError
from dynmap_cli.files.damage import refusing_damage
from dynmap_cli.files.npy import Column, npz_rows, read_npz, write_npz
from dynmap_cli.files.tables import new_table
from dynmap_cli.files.zip_archive import ZipArchive

_GRIDS = {
    "static_hits": Column("<f4", (None, None)),
    "dynamic_hits": Column("<f4", (None, None)),
    "passed_cells": Column("<f4", (None, None)),
    "centroids_m": Column("<f4", (None, None, 2)),
}
_FRAME = {"resolution_m": Column("<f8", ()), "origin_m": Column("<f8", (2,))}
_REMEDY = "Run `dynmap map` again with --force."


def write_counting_map(path: Path, counting_map: CountingMap) -> None:
    """Write hits, passed length, reflectance m, hit centroids and the frame."""
    write_npz(path, _arrays_of(counting_map))


def _arrays_of(counted: CountingMap) -> Iterator[tuple[str, NDArray[Any]]]:
    """What is written of a map; each grid is made when the one before is on the disk."""
    frame, cells = counted.frame, counted.hit_cells

    def grid_of(values: F64, elsewhere: float) -> F32:
        grid = np.full((frame.rows * frame.cols, *values.shape[1:]), elsewhere, dtype=np.float32)
        grid[cells] = values
        return grid.reshape(*frame.shape, *values.shape[1:])

    yield "static_hits", grid_of(counted.static_at_hits, 0.0)
    yield "dynamic_hits", grid_of(counted.dynamic_at_hits, 0.0)
    yield "passed_cells", counted.passed_cells.astype(np.float32)
    reflectance = grid_of(counted.reflectance_at_hits, np.nan)
    reflectance[np.isnan(reflectance) & (counted.passed_cells > 0)] = 0.0
    yield "reflectance", reflectance
    del reflectance
    yield "centroids_m", grid_of(counted.centroids_at_hits_m, np.nan)
    yield "resolution_m", np.array(frame.resolution_m)
    yield "origin_m", np.array([frame.origin_x_m, frame.origin_y_m])


def read_counting_map(path: Path) -> CountingMap:
    """Read what `write_counting_map` wrote.

    Raises
    ------
    ArtifactError
        If the file is missing, damaged or absurdly large.
    """
    with refusing_damage(f"{path}: not a readable counting map", _REMEDY, ArtifactError):
        arrays = read_npz(path, {**_GRIDS, **_FRAME}, max_bytes=8 * MAX_CELLS)
        shape = arrays["static_hits"].shape
        if any(arrays[name].shape[:2] != shape for name in _GRIDS):
            msg = f"grids of different sizes: {[arrays[name].shape for name in _GRIDS]}"
            raise ValueError(msg)
        for name in ("static_hits", "dynamic_hits", "passed_cells"):
            _check_values(
                arrays[name], name, "finite and at least 0", np.isfinite(arrays[name]) & (arrays[name] >= 0)
            )
        centroids = arrays["centroids_m"]
        _check_values(centroids, "centroids_m", f"within {FARTHEST_M:g} m", ~(np.abs(centroids) > FARTHEST_M))
        return CountingMap.of_grids(
            _frame_of(arrays, shape),
            arrays["static_hits"],
            arrays["dynamic_hits"],
            arrays["passed_cells"].astype(np.float64),
            centroids,
        )


def read_map_frame(path: Path) -> GridFrame:
    """Read the frame of a counting map, and of its grids only one.

    Raises
    ------
    ArtifactError
        As `read_counting_map`.
    """
    with refusing_damage(f"{path}: not a readable counting map", _REMEDY, ArtifactError):
        wanted = {"dynamic_hits": _GRIDS["dynamic_hits"], **_FRAME}
        arrays = read_npz(path, wanted, max_bytes=8 * MAX_CELLS)
        return _frame_of(arrays, arrays["dynamic_hits"].shape)


def _frame_of(arrays: Mapping[str, Any], shape: tuple[int, ...]) -> GridFrame:
    """Check and build the frame of grids of a shape."""
    resolution, (x, y) = float(arrays["resolution_m"]), arrays["origin_m"].tolist()
    if not RESOLUTIONS_M[0] <= resolution <= RESOLUTIONS_M[1]:
        msg = f"resolution_m.npy holds {resolution}, not {RESOLUTIONS_M[0]:g} to {RESOLUTIONS_M[1]:g}"
        raise ValueError(msg)
    if not max(abs(x), abs(y)) <= FARTHEST_M:
        msg = f"origin_m.npy holds {x}, {y}, not numbers within {FARTHEST_M:g} m"
        raise ValueError(msg)
    rows, cols = shape
    return GridFrame(resolution, x, y, rows, cols)


def _check_values(values: F32, name: str, allowed: str, is_right: B1) -> None:
    """Refuse values that no map has."""
    if not bool(is_right.all()):
        msg = f"{name}.npy holds {values[~is_right][0]:g}, values are {allowed}"
        raise ValueError(msg)


def _check_probabilities(found: F32) -> None:
    """Refuse e of beams that is no probability."""
    is_right = np.isnan(found) | ((found >= 0.0) & (found <= 1.0))
    _check_values(found, "static_probability", "from 0 to 1, or NaN without an end point", is_right)


def write_beams(path: Path, stamps_ns: I64, static_probability: F32, is_unknown: B1) -> None:
    """Write e of each beam, (n_scans, n_beams) float32, NaN where it has no end point, and which are unknown."""
    table: tuple[tuple[str, NDArray[Any]], ...] = (
        ("stamps_ns", stamps_ns),
        ("static_probability", static_probability.astype(np.float32, copy=False)),
        ("is_unknown", is_unknown.view(np.uint8)),
    )
    write_npz(path, table)


def beams_in_parts(path: Path, shape: tuple[int, int]) -> Iterator[tuple[slice, F32]]:
    """Read e of each beam as `read_beams`, some scans at a time, with their rows."""
    with refusing_damage(f"{path}: not a readable table of beams", _REMEDY, ArtifactError):
        for rows, part in _parts(path, "static_probability", Column("<f4", shape)):
            _check_probabilities(part)
            yield rows, part


def read_beams(path: Path, shape: tuple[int, int], folder: Path | None = None) -> F32:
    """Read e of each beam; *shape* is (n_scans, n_beams) of the scans it is of.

    A large table is put on the disk of *folder*, or where temporary files are.

    Raises
    ------
    ArtifactError
        If the file is missing, damaged or of other scans.
    """
    return _filled(beams_in_parts(path, shape), shape, folder, np.float32)


def _filled(
    parts: Iterator[tuple[slice, Any]], shape: tuple[int, int], folder: Path | None, dtype: Any
) -> NDArray[Any]:
    """A table of all parts; it is made once the first one was read, for before that the file may be of anything."""
    table: NDArray[Any] | None = None
    for rows, part in parts:
        table = new_table(*shape, folder, dtype) if table is None else table
        table[rows] = part
        give_back(table)
    return np.zeros(shape, dtype=dtype) if table is None else table


def read_unknown(path: Path, shape: tuple[int, int], folder: Path | None = None) -> B1:
    """Read which beams hit what was seen too little to tell, as `read_beams`; none in files that do not say.

    Raises
    ------
    ArtifactError
        If the file is missing, damaged or of other scans.
    """
    with refusing_damage(f"{path}: not a readable table of beams", _REMEDY, ArtifactError):
        with closing(ZipArchive(path)) as archive:
            if "is_unknown.npy" not in archive:
                return np.zeros(shape, dtype=bool)
        return _filled(_parts(path, "is_unknown", Column("|u1", shape)), shape, folder, np.bool_)


def _parts(path: Path, name: str, column: Column) -> Iterator[tuple[slice, Any]]:
    """Rows of some scans at a time, and what an array has for them."""
    first = 0
    most_bytes = np.dtype(column.dtype).itemsize * math.prod(length or 0 for length in column.shape)
    for part in npz_rows(path, name, column, most_bytes):
        yield slice(first, first + part.shape[0]), part
        first += part.shape[0]
