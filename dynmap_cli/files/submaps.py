"""submaps/: submaps.yaml with rectangles, areas and seed cells, and one mask PGM per sub-map.

In a mask, 0 is a contested cell, 64 one of a spot that is taken and left, 254 another cell the sub-map owns, 205 a
cell that another one owns.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from PIL import Image

from dynmap_cli.arrays import B1
from dynmap_cli.domain.grid import FARTHEST_M, MAX_CELLS, RESOLUTIONS_M, GridFrame
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.errors import ArtifactError
from dynmap_cli.files.damage import reason, refusing_damage
from dynmap_cli.files.documents import parse_yaml, read_text
from dynmap_cli.files.edits import name_at
from dynmap_cli.files.images import read_grey
from dynmap_cli.files.manifest import FORMAT_VERSION
from dynmap_cli.files.plain_values import (
    distinct,
    item_of,
    list_at,
    mapping_at,
    number_at,
    numbers_at,
    said,
    text_at,
    whole_at,
)

_REMEDY = "Run `dynmap segment` again with --force."
_MOST_AREA_M2 = 1e12
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


def read_submaps(folder: Path, remedy: str = _REMEDY) -> tuple[SubMap, ...]:
    """Read what `write_submaps` wrote; *remedy* is what a message advises.

    Raises
    ------
    ArtifactError
        If a file is missing, damaged or of another format version.
    """
    path = folder / "submaps.yaml"
    try:
        content = parse_yaml(read_text(path))
    except (OSError, ValueError) as err:
        msg = f"{path}: not a readable list of sub-maps ({reason(err)}). {remedy}"
        raise ArtifactError(msg) from err
    found = content.get("format_version") if isinstance(content, dict) else None
    if found != FORMAT_VERSION:
        msg = (
            f"{path}: written in format version {said(found)}, this dynmap reads version {FORMAT_VERSION}. "
            "Run `dynmap segment` again with --force, or use the dynmap that wrote it."
        )
        raise ArtifactError(msg)
    with refusing_damage(f"{path}: damaged list of sub-maps", remedy, ArtifactError):
        listed = list_at(item_of(content, "submaps", "it"), "submaps")
        if not listed:
            return ()
        resolution = number_at(item_of(content, "resolution_m", "it"), "resolution_m", *RESOLUTIONS_M)
        submaps = tuple(
            _read_one(folder, resolution, entry, f"submaps[{k}]") for k, entry in enumerate(listed)
        )
        distinct([submap.submap_id for submap in submaps], "sub-map")
        return submaps


def _read_one(folder: Path, resolution_m: float, value: object, where: str) -> SubMap:
    """One entry with its mask."""
    entry = mapping_at(value, where)
    cols, rows = _pair(entry, "size_cells", where, least=1)
    row, col = _pair(entry, "corner_cell", where, least=0)
    if cols * rows > MAX_CELLS:
        msg = f"{where}.size_cells is {cols} x {rows}, more than {MAX_CELLS} cells"
        raise ValueError(msg)
    name = text_at(item_of(entry, "mask", where), f"{where}.mask")
    if name != Path(name).name:
        msg = f"{where}.mask is {said(name)}, not the name of a file beside it"
        raise ValueError(msg)
    contested, recurring, owned = _mask(folder / name, (rows, cols))
    origin = numbers_at(item_of(entry, "origin_m", where), f"{where}.origin_m", -FARTHEST_M, FARTHEST_M)
    if len(origin) != 2:
        msg = f"{where}.origin_m is {said(origin)}, not [x, y]"
        raise ValueError(msg)
    return SubMap(
        submap_id=whole_at(item_of(entry, "id", where), f"{where}.id", 0, 2**31 - 1),
        frame=GridFrame(resolution_m, origin[0], origin[1], rows, cols),
        row=row,
        col=col,
        contested=contested,
        owned=owned,
        area_m2=number_at(item_of(entry, "area_m2", where), f"{where}.area_m2", 0.0, _MOST_AREA_M2),
        name=name_at(entry["name"], f"{where}.name") if "name" in entry else "",
        by_hand=entry.get("by_hand") is True,
        recurring=recurring if recurring.any() else None,
    )


def _pair(entry: dict[str, Any], key: str, where: str, *, least: int) -> tuple[int, int]:
    """Two whole numbers of cells."""
    values = list_at(item_of(entry, key, where), f"{where}.{key}")
    if len(values) != 2:
        msg = f"{where}.{key} is {said(values)}, not two whole numbers"
        raise ValueError(msg)
    first, second = (whole_at(one, f"{where}.{key}[{k}]", least, MAX_CELLS) for k, one in enumerate(values))
    return first, second


def _mask(path: Path, shape: tuple[int, int]) -> tuple[B1, B1, B1]:
    """Cells of a mask that are contested, recurring, owned."""
    try:
        grey = np.flipud(read_grey(path))
    except OSError as err:
        msg = f"{path.name}: {reason(err)}"
        raise ValueError(msg) from err
    except ValueError as err:
        msg = f"{path.name}: {err}"
        raise ValueError(msg) from err
    if grey.shape != shape:
        msg = f"{path.name} has {grey.shape[1]} x {grey.shape[0]} pixels, not {shape[1]} x {shape[0]}"
        raise ValueError(msg)
    others = ~np.isin(grey, (_CONTESTED, _RECURRING, _OWNED, _ELSEWHERE))
    if others.any():
        msg = f"{path.name} has a pixel of {grey[others][0]}, pixels are 0, 64, 205 or 254"
        raise ValueError(msg)
    recurring = grey == _RECURRING
    contested = (grey == _CONTESTED) | recurring
    if not contested.any():
        msg = f"{path.name} has no contested cell"
        raise ValueError(msg)
    return contested, recurring, grey != _ELSEWHERE


def _rounded(value: float) -> float:
    """Nanometres are enough; hides the noise of sums of fractions."""
    return round(float(value), 9)
