"""submaps/: submaps.yaml with rectangles, areas and seed cells, and one mask PGM per sub-map.

In a mask, 0 is a contested cell, 64 one of a spot that is taken and left, 254 another cell the sub-map owns, 205 a
cell that another one owns.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from PIL import Image

from dynmap_cli.domain.grid import MAX_CELLS, GridFrame
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.errors import ArtifactError
from dynmap_cli.files.damage import reason, refusing_damage
from dynmap_cli.files.documents import parse_yaml, read_text
from dynmap_cli.files.images import read_grey
from dynmap_cli.files.manifest import FORMAT_VERSION

_CONTESTED, _RECURRING, _OWNED, _ELSEWHERE = 0, 64, 254, 205


def write_submaps(folder: Path, submaps: tuple[SubMap, ...]) -> None:
    """Write submaps.yaml and the masks."""
    folder.mkdir(parents=True, exist_ok=True)
    entries = []
    for submap in submaps:
        name = f"submap_{submap.submap_id:03d}.pgm"
        grey = np.where(submap.contested, _CONTESTED, np.where(submap.owned, _OWNED, _ELSEWHERE))
        if submap.recurring is not None:
            grey[submap.contested & submap.recurring] = _RECURRING
        Image.fromarray(np.flipud(grey.astype(np.uint8))).save(folder / name)
        frame = submap.frame
        row, col = np.argwhere(submap.contested)[0].tolist()
        by_hand: dict[str, Any] = {"name": submap.name} if submap.name else {}
        by_hand |= {"by_hand": True} if submap.by_hand else {}
        entries.append(
            {
                "id": submap.submap_id,
                "origin_m": [_rounded(frame.origin_x_m), _rounded(frame.origin_y_m)],
                "size_cells": [frame.cols, frame.rows],
                "corner_cell": [submap.row, submap.col],
                "area_m2": _rounded(submap.area_m2),
                "contested_cells": int(submap.contested.sum()),
                "seed_cell": [submap.row + row, submap.col + col],
                "mask": name,
                **by_hand,
            }
        )
    resolution = _rounded(submaps[0].frame.resolution_m) if submaps else None
    content = {"format_version": FORMAT_VERSION, "resolution_m": resolution, "submaps": entries}
    (folder / "submaps.yaml").write_text(
        yaml.safe_dump(content, sort_keys=False, default_flow_style=None), encoding="ascii"
    )


def read_submaps(folder: Path) -> tuple[SubMap, ...]:
    """Read what `write_submaps` wrote.

    Raises
    ------
    ArtifactError
        If a file is missing, damaged or of another format version.
    """
    path = folder / "submaps.yaml"
    try:
        content = parse_yaml(read_text(path))
    except (OSError, ValueError) as err:
        msg = f"{path}: not a readable list of sub-maps ({reason(err)}). Run `dynmap segment` again."
        raise ArtifactError(msg) from err
    found = content.get("format_version") if isinstance(content, dict) else None
    if found != FORMAT_VERSION:
        msg = (
            f"{path}: written in format version {found}, this dynmap reads version {FORMAT_VERSION}. "
            "Run `dynmap segment` again with --force, or use the dynmap that wrote it."
        )
        raise ArtifactError(msg)
    with refusing_damage(
        f"{path}: damaged list of sub-maps", "Run `dynmap segment` again with --force.", ArtifactError
    ):
        return tuple(_read_one(folder, content["resolution_m"], entry) for entry in content["submaps"])


def _read_one(folder: Path, resolution_m: float, entry: dict[str, Any]) -> SubMap:
    """One entry with its mask."""
    cols, rows = (int(size) for size in entry["size_cells"])
    if min(cols, rows) < 1 or cols * rows > MAX_CELLS:
        msg = f"size_cells {entry['size_cells']}"
        raise ValueError(msg)
    name = Path(str(entry["mask"])).name
    grey = np.flipud(read_grey(folder / name))
    if grey.shape != (rows, cols):
        msg = f"{name} is {grey.shape[::-1]}, not {(cols, rows)}"
        raise ValueError(msg)
    recurring = grey == _RECURRING
    contested = (grey == _CONTESTED) | recurring
    if not contested.any():
        msg = f"{name} has no contested cell"
        raise ValueError(msg)
    origin_x, origin_y = (float(value) for value in entry["origin_m"])
    row, col = (int(value) for value in entry["corner_cell"])
    resolution = float(resolution_m)
    if not (0.0 < resolution < math.inf and math.isfinite(origin_x) and math.isfinite(origin_y)):
        msg = f"resolution_m {resolution}, origin_m {entry['origin_m']}"
        raise ValueError(msg)
    return SubMap(
        submap_id=int(entry["id"]),
        frame=GridFrame(resolution, origin_x, origin_y, rows, cols),
        row=row,
        col=col,
        contested=contested,
        owned=grey != _ELSEWHERE,
        area_m2=float(entry["area_m2"]),
        name=str(entry.get("name", "")),
        by_hand=bool(entry.get("by_hand", False)),
        recurring=recurring if recurring.any() else None,
    )


def _rounded(value: float) -> float:
    """Nanometres are enough; hides the noise of sums of fractions."""
    return round(float(value), 9)
