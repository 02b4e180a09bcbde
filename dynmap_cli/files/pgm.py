"""map_server pairs: a PGM (0 occupied, 205 unknown, 254 free, first row on top) and its YAML."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from dynmap_cli.arrays import I8
from dynmap_cli.domain.grid import (
    FARTHEST_M,
    FREE,
    OCCUPIED,
    RESOLUTIONS_M,
    UNKNOWN,
    GridFrame,
    OccupancyGrid,
)
from dynmap_cli.errors import ArtifactError
from dynmap_cli.files.beesoft import is_beesoft_map, read_beesoft_map
from dynmap_cli.files.damage import reason
from dynmap_cli.files.documents import parse_yaml, read_text
from dynmap_cli.files.images import read_grey
from dynmap_cli.files.plain_values import said

OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196
"""free_thresh 0.25, an old default, would turn 205 (unknown) into free."""
_GREY = {FREE: 254, OCCUPIED: 0, UNKNOWN: 205}


def write_map(folder: Path, name: str, grid: OccupancyGrid) -> None:
    """Write `<name>.pgm` and `<name>.yaml` into *folder*; map_server and AMCL load them as they are."""
    (folder / f"{name}.pgm").write_bytes(pgm_bytes(grid.cells))
    frame = grid.frame
    (folder / f"{name}.yaml").write_text(
        f"image: {name}.pgm\nmode: trinary\nresolution: {frame.resolution_m:.10g}\n"
        f"origin: [{frame.origin_x_m:.10g}, {frame.origin_y_m:.10g}, 0.0]\nnegate: 0\n"
        f"occupied_thresh: {OCCUPIED_THRESH}\nfree_thresh: {FREE_THRESH}\n",
        encoding="ascii",
    )


def pgm_bytes(cells: I8) -> bytes:
    """Image of cells (rows, cols) that are OCCUPIED, FREE or UNKNOWN."""
    grey = np.full(cells.shape, _GREY[UNKNOWN], dtype=np.uint8)
    for value, level in _GREY.items():
        grey[cells == value] = level
    stream = io.BytesIO()
    Image.fromarray(np.flipud(grey)).save(stream, format="PPM")
    return stream.getvalue()


def read_map(yaml_path: Path) -> tuple[OccupancyGrid, list[str]]:
    """Read any map_server pair in trinary reading, or a map as in `files.beesoft`.

    Returns
    -------
    OccupancyGrid
    list of str
        Warnings, one line each: what in the file is probably not meant.

    Raises
    ------
    ArtifactError
        If the YAML or the image is missing, damaged, rotated or too large.
    """
    if is_beesoft_map(yaml_path):
        return read_beesoft_map(yaml_path), []
    content = _read_yaml(yaml_path)
    occupied_thresh, free_thresh = content["occupied_thresh"], content["free_thresh"]
    warnings = []
    unknown_shade = (255 - 205) / 255
    if free_thresh > unknown_shade:
        warnings.append(
            f"{yaml_path}: free_thresh {free_thresh:g} would read unknown cells (205) as free; "
            f"{FREE_THRESH} is used instead"
        )
        free_thresh = FREE_THRESH
    image_path = yaml_path.parent / content["image"]
    try:
        grey = read_grey(image_path)
    except (OSError, ValueError) as err:
        msg = f"{image_path}: not a readable map image ({reason(err)})."
        raise ArtifactError(msg) from err
    levels = np.arange(256)
    shade = levels / 255.0 if content["negate"] else (255.0 - levels) / 255.0
    meaning = np.full(256, UNKNOWN, dtype=np.int8)
    meaning[shade > occupied_thresh] = OCCUPIED
    meaning[shade < free_thresh] = FREE
    cells = meaning[grey]
    frame = GridFrame(content["resolution"], content["origin"][0], content["origin"][1], *cells.shape)
    return OccupancyGrid(frame, np.ascontiguousarray(np.flipud(cells))), warnings


def image_of(yaml_path: Path) -> Path:
    """Where the image of a map_server YAML lies; a map as in `files.beesoft` has all in one file."""
    if is_beesoft_map(yaml_path):
        return yaml_path
    image: str = _read_yaml(yaml_path)["image"]
    return yaml_path.parent / image


def _read_yaml(path: Path) -> dict[str, Any]:
    """Read the YAML of a map and check what the rest relies on."""
    try:
        content = parse_yaml(read_text(path))
    except (OSError, ValueError) as err:
        msg = f"{path}: not a readable map YAML ({reason(err)})."
        raise ArtifactError(msg) from err
    content = content if isinstance(content, dict) else {}
    missing = [key for key in ("image", "resolution", "origin") if key not in content]
    if missing:
        msg = f"{path}: not a map_server YAML, {', '.join(missing)} missing."
        raise ArtifactError(msg)
    content = {
        "negate": 0,
        "mode": "trinary",
        "occupied_thresh": OCCUPIED_THRESH,
        "free_thresh": FREE_THRESH,
        **content,
    }
    for key, (is_right, allowed) in _ALLOWED.items():
        if not is_right(content[key]):
            msg = f"{path}: {key} must be {allowed}, found {said(content[key])}."
            raise ArtifactError(msg)
    origin = [float(value) for value in content["origin"]]
    if abs(origin[2]) > 1e-9:
        msg = (
            f"{path}: origin is turned by {origin[2]:g} rad; only maps with yaw 0 are read. Rotate the image."
        )
        raise ArtifactError(msg)
    numbers = {key: float(content[key]) for key in ("resolution", "occupied_thresh", "free_thresh")}
    if numbers["free_thresh"] >= numbers["occupied_thresh"]:
        msg = (
            f"{path}: free_thresh {numbers['free_thresh']:g} must be below occupied_thresh "
            f"{numbers['occupied_thresh']:g}; usual are {FREE_THRESH} and {OCCUPIED_THRESH}."
        )
        raise ArtifactError(msg)
    return {**content, **numbers, "origin": origin}


def _is_number(value: object, low: float, high: float) -> bool:
    """Whether a value is a number between two others; YAML 1.1 takes 1e-3, without a point, for a word."""
    try:
        return isinstance(value, int | float | str) and low <= float(value) <= high
    except ValueError:
        return False


def _is_origin(value: object) -> bool:
    """Whether a value is a pose."""
    return (
        isinstance(value, list)
        and len(value) == 3
        and all(_is_number(number, -FARTHEST_M, FARTHEST_M) for number in value)
    )


_ALLOWED: dict[str, tuple[Callable[[object], bool], str]] = {
    "image": (
        lambda value: isinstance(value, str) and value != "" and value.isprintable(),
        "the name of a file, in printable characters",
    ),
    "resolution": (
        lambda value: _is_number(value, *RESOLUTIONS_M),
        f"a number of metres from {RESOLUTIONS_M[0]:g} to {RESOLUTIONS_M[1]:g}",
    ),
    "origin": (_is_origin, f"[x, y, yaw] in metres and radians, at most {FARTHEST_M:g} m away"),
    "negate": (lambda value: value in (0, 1), "0 or 1"),
    "mode": (
        lambda value: value in ("trinary", "scale"),
        "trinary, or scale, of which what lies between the thresholds is unknown",
    ),
    "occupied_thresh": (lambda value: _is_number(value, 0.0, 1.0), "a number from 0 to 1"),
    "free_thresh": (lambda value: _is_number(value, 0.0, 1.0), "a number from 0 to 1"),
}
