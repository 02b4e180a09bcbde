"""Pictures on the cells of the map: the map with path, removed beams and sub-maps; the states of a sub-map."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from PIL import Image, ImageDraw

from dynmap_cli.arrays import F32, F64, I8, U8
from dynmap_cli.domain.grid import FREE, OCCUPIED, GridFrame, OccupancyGrid
from dynmap_cli.domain.patches import PatchSet
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.report.axes import in_axes
from dynmap_cli.report.ink import (
    CHANGING,
    INK,
    MOVED,
    PAPER,
    PATH,
    UNSEEN,
    Colour,
    colour_of_submap,
    font_of,
    font_pixels,
)
from dynmap_cli.report.labels import Box, Label, above_legend, draw_labels

_TARGET_PIXELS, _MOST_PIXELS = 1700, 2400
_ROW_PIXELS, _TILE_PIXELS, _MOST_ZOOM, _GAP_PIXELS, _TILES_PER_ROW = 1200, 280, 20, 16, 6
"""States of a sub-map: width of a row of tiles, height of a tile, pixels per cell at most."""
_STATE_FONT, _TEXT_PIXELS, _LEAST_STEP = 15, 20, 150
_SCALE_PIXELS, _MARGIN_PIXELS = 36, 10
_FEW, _FEW_PIXELS = 500, 4
"""So few removed beams are drawn larger, or nobody finds them on a large map."""
Cells = TypeVar("Cells", F32, I8)
FULL_REFLECTANCE = 0.5
"""What reflects so much, or more, is drawn in full colour."""


class MapPicture:
    """A map drawn with a whole number of pixels per cell, or of cells per pixel where it is large."""

    def __init__(
        self, grid: OccupancyGrid, target_pixels: int = _TARGET_PIXELS, most_pixels: int = _MOST_PIXELS
    ) -> None:
        self._frame = grid.frame
        rows, cols = grid.frame.shape
        self._zoom, reduce = (
            max(1, target_pixels // max(rows, cols)),
            math.ceil(max(rows, cols) / (most_pixels - _SCALE_PIXELS)),
        )
        cells = largest_of_blocks(grid.cells, reduce)
        colours = np.full((*cells.shape, 3), UNSEEN, dtype=np.uint8)
        colours[cells == FREE] = PAPER
        colours[cells == OCCUPIED] = INK
        self._pixels: U8 = np.flipud(colours).repeat(self._zoom, axis=0).repeat(self._zoom, axis=1)
        self._pixels_per_m = self._zoom / reduce / grid.frame.resolution_m

    def draw(self, removed_m: F64, paths_m: Sequence[F64], submaps: Sequence[SubMap]) -> Image.Image:
        """Put removed beams, paths and numbered sub-maps on the map.

        Parameters
        ----------
        removed_m : (n, 2) float64
            End points of the beams that were removed.
        paths_m : sequence of (m, 2) float64
            Of each drive.
        submaps : sequence of SubMap
        """
        pixels = self._pixels.copy()
        height, width = pixels.shape[:2]
        spots = np.floor(self._to_pixels(removed_m)).astype(np.int64)
        side = _FEW_PIXELS if len(spots) <= _FEW else min(self._zoom, 2)
        for step_x, step_y in np.ndindex(side, side):
            x, y = spots[:, 0] + step_x - side // 2, spots[:, 1] + step_y - side // 2
            inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
            pixels[y[inside], x[inside]] = MOVED
        image = Image.fromarray(pixels)
        pen = ImageDraw.Draw(image)
        for path_m in paths_m:
            pen.line([tuple(point) for point in self._to_pixels(path_m).tolist()], fill=PATH, width=2)
        labels = []
        for submap in submaps:
            colour = colour_of_submap(submap.submap_id)
            labels.append(Label(submap.called, self._draw_box(pen, submap.frame, colour), colour))
        draw_labels(image, labels)
        words = [("removed beams", MOVED)] if removed_m.size else []
        words += [("path", PATH)] if paths_m else []
        words += [("frames: sub-maps, with their numbers", INK)] if submaps else []
        return above_legend(self._in_axes(image), words) if paths_m else self._above_scale(image)

    def _to_pixels(self, points_m: F64) -> F64:
        """Points of the map frame in the picture, whose first row is on top."""
        x = (points_m[:, 0] - self._frame.origin_x_m) * self._pixels_per_m
        y = self._pixels.shape[0] - (points_m[:, 1] - self._frame.origin_y_m) * self._pixels_per_m
        return np.column_stack([x, y])

    def _draw_box(self, pen: ImageDraw.ImageDraw, frame: GridFrame, colour: Colour) -> Box:
        """Draw the rectangle of a sub-map; give back its left, top, right and bottom, pixels."""
        low = np.array([frame.origin_x_m, frame.origin_y_m])
        size_m = np.array([frame.cols, frame.rows]) * frame.resolution_m
        (left, bottom), (right, top) = self._to_pixels(np.array([low, low + size_m])).tolist()
        pen.rectangle((left, top, right, bottom), outline=colour, width=2)
        return left, top, right, bottom

    def _in_axes(self, image: Image.Image) -> Image.Image:
        """Put coordinates beside the map."""
        return in_axes(image, (self._frame.origin_x_m, self._frame.origin_y_m), self._pixels_per_m)

    def _above_scale(self, image: Image.Image) -> Image.Image:
        """Put a bar of 1, 2, 5, 10, ... metres with its length below the map."""
        longest_m = 0.25 * self._pixels.shape[1] / self._pixels_per_m
        decade = 10.0 ** math.floor(math.log10(longest_m))
        length_m = max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= longest_m)
        label = f"{length_m:g} m"
        font = font_of(font_pixels(image.size))
        left, right = _MARGIN_PIXELS, _MARGIN_PIXELS + length_m * self._pixels_per_m
        width = max(image.width, math.ceil(right + 8 + font.getlength(label)) + _MARGIN_PIXELS)
        sheet = Image.new("RGB", (width, image.height + _SCALE_PIXELS), PAPER)
        sheet.paste(image, (0, 0))
        pen, y = ImageDraw.Draw(sheet), image.height + _SCALE_PIXELS // 2
        pen.line((left, y, right, y), fill=INK, width=3)
        pen.text((right + 8, y), label, fill=INK, font=font, anchor="lm")
        return sheet


def draw_states(patch_set: PatchSet) -> Image.Image:
    """Draw the states of a sub-map beside one another; cells that change and reflect are red."""
    rows, cols = patch_set.frame.shape
    count = len(patch_set.patches)
    per_row = min(count, _TILES_PER_ROW)
    zoom = max(1, min(_MOST_ZOOM, _TILE_PIXELS // rows, _ROW_PIXELS // per_row // cols))
    step_x = max(cols * zoom, _LEAST_STEP) + _GAP_PIXELS
    step_y = rows * zoom + _TEXT_PIXELS + _GAP_PIXELS
    sheet = Image.new("RGB", (per_row * step_x, math.ceil(count / per_row) * step_y), (255, 255, 255))
    pen = ImageDraw.Draw(sheet)
    for number, patch in enumerate(patch_set.patches):
        left, top = number % per_row * step_x, number // per_row * step_y
        visits = f"{patch.support} visit{'s' * (patch.support != 1)}"
        pen.text((left, top), f"state {patch.patch_id}: {visits}", fill=INK, font=font_of(_STATE_FONT))
        tile = Image.fromarray(
            state_tile(patch.reflectance, patch_set).repeat(zoom, axis=0).repeat(zoom, axis=1)
        )
        sheet.paste(tile, (left, top + _TEXT_PIXELS))
        box = (left, top + _TEXT_PIXELS, left + cols * zoom - 1, top + _TEXT_PIXELS + rows * zoom - 1)
        pen.rectangle(box, outline=(150, 150, 150))
    return sheet


def state_tile(reflectance: F32, patch_set: PatchSet) -> U8:
    """(rows, cols, 3) colours of a state, first row on top."""
    strength = np.clip(np.nan_to_num(reflectance) / FULL_REFLECTANCE, 0.0, 1.0)[..., None]
    ink = np.where(patch_set.varying[..., None], np.array(CHANGING), np.array(INK))
    colours = np.array(PAPER) * (1.0 - strength) + ink * strength
    colours[np.isnan(reflectance)] = UNSEEN
    return np.asarray(np.flipud(colours), dtype=np.uint8)


def largest_of_blocks(cells: Cells, factor: int) -> Cells:
    """Largest value of each block of factor x factor cells: walls stay, then free, then unknown."""
    if factor == 1:
        return cells
    rows, cols = (-(-size // factor) * factor for size in cells.shape)
    padded = np.pad(cells, ((0, rows - cells.shape[0]), (0, cols - cells.shape[1])), constant_values=-1)
    blocks: Cells = padded.reshape(rows // factor, factor, cols // factor, factor).max(axis=(1, 3))
    return blocks
