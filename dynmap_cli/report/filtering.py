"""What the filter did: the map without and with it, and round by round (paper, Fig. 1.4, 1.6 and 1.7)."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw
from scipy import ndimage

from dynmap_cli.arrays import F64, I8
from dynmap_cli.domain.grid import OCCUPIED, UNKNOWN, GridFrame, OccupancyGrid
from dynmap_cli.report.ink import INK, font_of
from dynmap_cli.report.pictures import MapPicture

_PANEL_PIXELS, _GAP_PIXELS, _TITLE_PIXELS, _MARGIN_PIXELS = (850, 1200), 12, 24, 4
_NEAR = np.ones((3, 3), dtype=bool)


def draw_filtered(final: OccupancyGrid, removed_m: F64, n_removed: int) -> Image.Image:
    """Draw the map with every end point in it, and the filtered one with the removed ones (n, 2) in colour.

    Of the *n_removed* beams only one need be given for each cell of the map.
    """
    nothing = np.empty((0, 2))
    cells: I8 = final.cells.copy()
    row, col = final.frame.to_cells(removed_m).T
    inside = (row >= 0) & (row < final.frame.rows) & (col >= 0) & (col < final.frame.cols)
    cells[row[inside], col[inside]] = OCCUPIED
    every_end = MapPicture(OccupancyGrid(final.frame, cells), *_PANEL_PIXELS).draw(nothing, (), ())
    filtered = MapPicture(final, *_PANEL_PIXELS).draw(removed_m, (), ())
    return side_by_side((("every end point", every_end), (f"filtered, {n_removed} beams removed", filtered)))


def draw_rounds_of_map(
    titled: Sequence[tuple[str, OccupancyGrid]], final: OccupancyGrid, curves_png: bytes
) -> Image.Image:
    """Draw maps in which cells are coloured that the final map does not have, above the curves of em.csv."""
    *grids, last = _in_one_frame((*(grid for _, grid in titled), final))
    walls = ndimage.binary_dilation(last.cells == OCCUPIED, _NEAR)
    panels = []
    for (title, _), grid in zip(titled, grids, strict=True):
        extra = np.argwhere((grid.cells == OCCUPIED) & ~walls)
        picture = MapPicture(grid, *_PANEL_PIXELS).draw(grid.frame.to_points(extra), (), ())
        panels.append((f"{title}: {extra.shape[0]} orange cell{'s' * (extra.shape[0] != 1)}", picture))
    maps, curves = side_by_side(panels), Image.open(io.BytesIO(curves_png)).convert("RGB")
    sheet = Image.new(
        "RGB", (max(maps.width, curves.width), maps.height + _GAP_PIXELS + curves.height), (255, 255, 255)
    )
    sheet.paste(maps, (0, 0))
    sheet.paste(curves, (0, maps.height + _GAP_PIXELS))
    return sheet


def side_by_side(titled: Sequence[tuple[str, Image.Image]]) -> Image.Image:
    """Put pictures of one size beside one another, or below one another where they are wide, each under its title."""
    font = font_of(_TITLE_PIXELS - 8)
    width, height = titled[0][1].size
    across = len(titled) if height > 0.6 * width else 1
    down = -(-len(titled) // across)
    longest = max(math.ceil(font.getlength(title)) for title, _ in titled)
    step_x, step_y = (
        max(width, longest + 2 * _MARGIN_PIXELS) + _GAP_PIXELS,
        height + _GAP_PIXELS + _TITLE_PIXELS,
    )
    sheet = Image.new("RGB", (across * step_x - _GAP_PIXELS, down * step_y - _GAP_PIXELS), (255, 255, 255))
    pen = ImageDraw.Draw(sheet)
    for number, (title, image) in enumerate(titled):
        left, top = number % across * step_x, number // across * step_y
        pen.text((left + _MARGIN_PIXELS, top + 2), title, fill=INK, font=font)
        sheet.paste(image, (left, top + _TITLE_PIXELS))
    return sheet


def _in_one_frame(grids: Sequence[OccupancyGrid]) -> list[OccupancyGrid]:
    """The grids, whose frames lie on the same cells, in the smallest frame that holds all of them."""
    resolution_m = grids[0].frame.resolution_m
    corners = np.array(
        [
            (round(grid.frame.origin_y_m / resolution_m), round(grid.frame.origin_x_m / resolution_m))
            for grid in grids
        ]
    )
    ends = corners + np.array([grid.frame.shape for grid in grids])
    low, high = corners.min(axis=0), ends.max(axis=0)
    rows, cols = (high - low).tolist()
    frame = GridFrame(
        resolution_m, float(low[1] * resolution_m), float(low[0] * resolution_m), int(rows), int(cols)
    )
    result = []
    for grid, (row, col) in zip(grids, (corners - low).tolist(), strict=True):
        cells: I8 = np.full(frame.shape, UNKNOWN, dtype=np.int8)
        cells[row : row + grid.frame.rows, col : col + grid.frame.cols] = grid.cells
        result.append(OccupancyGrid(frame, cells))
    return result
