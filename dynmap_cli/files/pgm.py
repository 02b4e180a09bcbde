"""map_server pairs: a PGM (0 occupied, 205 unknown, 254 free, first row on top) and its YAML."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from PIL import Image

from dynmap_cli.domain.grid import FREE, OCCUPIED, UNKNOWN, GridFrame, OccupancyGrid
from dynmap_cli.errors import ArtifactError

OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196
"""free_thresh 0.25, an old default, would turn 205 (unknown) into free."""
MAX_PIXELS = 400_000_000
_GREY = {FREE: 254, OCCUPIED: 0, UNKNOWN: 205}


def write_map(folder: Path, name: str, grid: OccupancyGrid) -> None:
    """Write `<name>.pgm` and `<name>.yaml` into *folder*; map_server and AMCL load them as they are."""
    grey = np.full(grid.cells.shape, _GREY[UNKNOWN], dtype=np.uint8)
    for value, level in _GREY.items():
        grey[grid.cells == value] = level
    Image.fromarray(np.flipud(grey)).save(folder / f"{name}.pgm")
    frame = grid.frame
    (folder / f"{name}.yaml").write_text(
        f"image: {name}.pgm\nmode: trinary\nresolution: {frame.resolution_m:.10g}\n"
        f"origin: [{frame.origin_x_m:.10g}, {frame.origin_y_m:.10g}, 0.0]\nnegate: 0\n"
        f"occupied_thresh: {OCCUPIED_THRESH}\nfree_thresh: {FREE_THRESH}\n",
        encoding="ascii",
    )


def read_map(yaml_path: Path) -> tuple[OccupancyGrid, list[str]]:
    """Read any map_server pair in trinary reading.

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
    content = _read_yaml(yaml_path)
    occupied_thresh = float(content.get("occupied_thresh", OCCUPIED_THRESH))
    free_thresh = float(content.get("free_thresh", FREE_THRESH))
    warnings = []
    unknown_shade = (255 - 205) / 255
    if free_thresh > unknown_shade:
        warnings.append(
            f"{yaml_path}: free_thresh {free_thresh:g} would read unknown cells (205) as free; "
            f"{FREE_THRESH} is used instead"
        )
        free_thresh = FREE_THRESH
    grey = _read_grey(yaml_path.parent / str(content["image"]))
    shade = grey / 255.0 if content.get("negate") else (255.0 - grey) / 255.0
    cells = np.full(grey.shape, UNKNOWN, dtype=np.int8)
    cells[shade > occupied_thresh] = OCCUPIED
    cells[shade < free_thresh] = FREE
    frame = GridFrame(
        float(content["resolution"]), float(content["origin"][0]), float(content["origin"][1]), *cells.shape
    )
    return OccupancyGrid(frame, np.ascontiguousarray(np.flipud(cells))), warnings


def image_of(yaml_path: Path) -> Path:
    """Where the image of a map_server YAML lies."""
    return yaml_path.parent / str(_read_yaml(yaml_path)["image"])


def _read_yaml(path: Path) -> dict[str, Any]:
    """Read the YAML of a map and check what the rest relies on."""
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as err:
        msg = f"{path}: not a readable map YAML ({str(err).splitlines()[0]})."
        raise ArtifactError(msg) from err
    missing = (
        [key for key in ("image", "resolution", "origin") if key not in (content or {})]
        if isinstance(content, dict)
        else ["image", "resolution", "origin"]
    )
    if missing:
        msg = f"{path}: not a map_server YAML, {', '.join(missing)} missing."
        raise ArtifactError(msg)
    try:
        origin = [float(value) for value in content["origin"]]
        resolution = float(content["resolution"])
        valid = len(origin) == 3 and all(map(math.isfinite, origin)) and 0 < resolution < math.inf
    except (TypeError, ValueError):
        valid = False
    if not valid:
        msg = (
            f"{path}: origin must be [x, y, yaw] and resolution a positive number of metres, "
            f"found {content['origin']!r} and {content['resolution']!r}."
        )
        raise ArtifactError(msg)
    if abs(origin[2]) > 1e-9:
        msg = (
            f"{path}: origin is turned by {origin[2]:g} rad; only maps with yaw 0 are read. Rotate the image."
        )
        raise ArtifactError(msg)
    return dict(content)


def _read_grey(path: Path) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Read an image as shades of grey, 0 to 255, first row on top."""
    try:
        with Image.open(path) as image:
            if image.width * image.height > MAX_PIXELS:
                msg = f"{path}: {image.width} x {image.height} pixels, at most {MAX_PIXELS:.0e} are read."
                raise ArtifactError(msg)
            return np.asarray(image.convert("L"), dtype=np.float64)
    except (OSError, ValueError, Image.DecompressionBombError) as err:
        msg = f"{path}: not a readable map image ({err})."
        raise ArtifactError(msg) from err
