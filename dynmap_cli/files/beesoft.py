"""Maps of CMU's course on statistical robotics (`wean.dat`), in the text format of BeeSoft: no longer written.

`robot_specifications->resolution 10` (cm), then `global_map[0]: 800 800` and one line of numbers for each x,
from low y to high: the probability that a cell is free, -1 = unknown.
"""

from __future__ import annotations

import gzip
import re
from pathlib import Path

import numpy as np

from dynmap_cli.domain.grid import FREE, MAX_CELLS, OCCUPIED, UNKNOWN, GridFrame, OccupancyGrid
from dynmap_cli.errors import ArtifactError
from dynmap_cli.files.damage import DAMAGE, reason

_MAGIC = b"robot_specifications->"
_RESOLUTION = re.compile(rb"^robot_specifications->resolution\s+(\d+(?:\.\d+)?)\s*$", re.MULTILINE)
_SIZE = re.compile(rb"^global_map\[0\]:\s+(\d+)\s+(\d+)\s*$", re.MULTILINE)
_FREE_ABOVE, _OCCUPIED_BELOW = 0.804, 0.35
"""The thresholds of map_server, seen from the free side."""
_MOST_BYTES = 1_000_000_000
_MOST_CM = 10_000.0


def is_beesoft_map(path: Path) -> bool:
    """Whether a file, plain or `.gz`, begins as such a map does."""
    try:
        with path.open("rb") as stream:
            is_packed = stream.read(2) == b"\x1f\x8b"
        with gzip.open(path) if is_packed else path.open("rb") as stream:
            return stream.read(len(_MAGIC)) == _MAGIC
    except DAMAGE:
        return False


def read_beesoft_map(path: Path) -> OccupancyGrid:
    """Read such a map; its corner is the origin.

    Raises
    ------
    ArtifactError
        If it is cut off or damaged.
    """
    try:
        with path.open("rb") as stream:
            is_packed = stream.read(2) == b"\x1f\x8b"
        with gzip.open(path) if is_packed else path.open("rb") as stream:
            content = stream.read(_MOST_BYTES)
        return _parse(content)
    except DAMAGE as err:
        msg = f"{path}: not a readable map ({reason(err)})."
        raise ArtifactError(msg) from err


def _parse(content: bytes) -> OccupancyGrid:
    """Turn the text into cells, rows along x and columns along y."""
    resolution, size = _RESOLUTION.search(content), _SIZE.search(content)
    if resolution is None or size is None:
        msg = "resolution or size of global_map missing"
        raise ValueError(msg)
    resolution_cm, n_x, n_y = float(resolution[1]), int(size[1]), int(size[2])
    if not 0.1 <= resolution_cm <= _MOST_CM or not 0 < n_x * n_y <= MAX_CELLS:
        msg = f"{n_x} x {n_y} cells of {resolution_cm:g} cm"
        raise ValueError(msg)
    values = np.array(content[size.end() :].split(), dtype=np.float64)
    if values.size != n_x * n_y:
        msg = f"{values.size} values, {n_x} x {n_y} expected"
        raise ValueError(msg)
    free = values.reshape(n_x, n_y).T
    cells = np.full(free.shape, UNKNOWN, dtype=np.int8)
    cells[free > _FREE_ABOVE] = FREE
    cells[(free >= 0.0) & (free < _OCCUPIED_BELOW)] = OCCUPIED
    return OccupancyGrid(GridFrame(resolution_cm / 100.0, 0.0, 0.0, *cells.shape), cells)
