"""The patch map in one picture: the map with its sub-maps, and the states of each beside it (Fig. 1.11, 1.12)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw

from dynmap_cli.arrays import F32, U8
from dynmap_cli.domain.grid import FREE, OCCUPIED, OccupancyGrid
from dynmap_cli.domain.patches import PatchSet
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.report.ink import INK, PAPER, UNSEEN, Colour, colour_of_submap, font_of
from dynmap_cli.report.pictures import FULL_REFLECTANCE, largest_of_blocks, state_tile

_TILE_EDGE = (176, 176, 176)
_MAP_WIDTH, _MAP_HEIGHT, _SHEET_HEIGHT = 900, 1200, 1500
_LARGEST_TILE, _SMALLEST_TILE, _MOST_ZOOM = 120, 24, 12
_GAP, _TEXT, _NUMBER, _LEADER, _MOST_PER_ROW, _FONT = 6, 18, 17, 60, 4, 14


@dataclass(frozen=True, slots=True)
class _Group:
    """The states of a sub-map beside one another, under its name.

    Attributes
    ----------
    submap : SubMap
    patch_set : PatchSet
    tile_pixels : int
        Largest edge of a tile, if cells are not smaller than a pixel.
    """

    submap: SubMap
    patch_set: PatchSet
    tile_pixels: int

    @property
    def colour(self) -> Colour:
        """Of its frame and of its rectangle in the map."""
        return colour_of_submap(self.submap.submap_id)

    @property
    def title(self) -> str:
        """What stands above its states."""
        return f"sub-map {self.submap.called}"

    @property
    def zoom(self) -> int:
        """Pixels per cell."""
        return max(1, min(_MOST_ZOOM, self.tile_pixels // max(self.submap.frame.shape)))

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, pixels."""
        rows, cols = self.submap.frame.shape
        per_row = min(len(self.patch_set.patches), _MOST_PER_ROW)
        n_rows = math.ceil(len(self.patch_set.patches) / _MOST_PER_ROW)
        width = _GAP + per_row * (cols * self.zoom + _GAP)
        label = math.ceil(font_of(_FONT).getlength(self.title)) + 2 * _GAP
        return max(width, label), _TEXT + _GAP + n_rows * (rows * self.zoom + _NUMBER + _GAP)

    def draw(self) -> Image.Image:
        """Draw it."""
        rows, cols = self.submap.frame.shape
        sheet = Image.new("RGB", self.size, PAPER)
        pen = ImageDraw.Draw(sheet)
        pen.text((_GAP, 3), self.title, fill=self.colour, font=font_of(_FONT))
        for number, patch in enumerate(self.patch_set.patches):
            left = _GAP + number % _MOST_PER_ROW * (cols * self.zoom + _GAP)
            top = _TEXT + _GAP + number // _MOST_PER_ROW * (rows * self.zoom + _NUMBER + _GAP)
            colours = state_tile(patch.reflectance, self.patch_set)
            sheet.paste(Image.fromarray(_enlarged(colours, self.zoom)), (left, top))
            box = (left - 1, top - 1, left + cols * self.zoom, top + rows * self.zoom)
            pen.rectangle(box, outline=_TILE_EDGE)
            place = (left + cols * self.zoom // 2, box[3] + 2)
            pen.text(place, str(patch.patch_id), fill=INK, font=font_of(_FONT), anchor="mt")
        pen.rectangle((0, 0, sheet.width - 1, sheet.height - 1), outline=self.colour, width=2)
        return sheet


def draw_patch_map(
    grid: OccupancyGrid, submaps: Sequence[SubMap], patch_sets: Sequence[PatchSet]
) -> Image.Image:
    """Draw the map, in each sub-map the mean of its states, and beside it the states, joined with their place.

    Parameters
    ----------
    grid : OccupancyGrid
    submaps : sequence of SubMap
    patch_sets : sequence of PatchSet
        Of those sub-maps whose states were seen.
    """
    pixels, per_cell = _map_pixels(_with_means(grid, submaps, patch_sets))
    height, width = pixels.shape[:2]
    columns = [_column(side) for side in _sides(submaps, patch_sets)]
    widths = [max((group.size[0] for group in column), default=-_LEADER) for column in columns]
    left, total = widths[0] + _LEADER, max(height, *map(_height_of, columns))
    sheet = Image.new("RGB", (left + width + _LEADER + widths[1], total), PAPER)
    sheet.paste(Image.fromarray(pixels), (left, (total - height) // 2))
    pen = ImageDraw.Draw(sheet)
    for column, is_left in zip(columns, (True, False), strict=True):
        boxes = [_box(group.submap, per_cell, (left, (total + height) // 2)) for group in column]
        for group, box, y in zip(column, boxes, _tops(column, boxes, total), strict=True):
            x = widths[0] - group.size[0] if is_left else left + width + _LEADER
            sheet.paste(group.draw(), (x, y))
            start = (x + group.size[0] if is_left else x, y + group.size[1] // 2)
            end = (box[0] if is_left else box[2], (box[1] + box[3]) // 2)
            pen.rectangle(box, outline=group.colour, width=2)
            pen.line((*start, *end), fill=group.colour, width=1)
    return sheet


def _with_means(grid: OccupancyGrid, submaps: Sequence[SubMap], patch_sets: Sequence[PatchSet]) -> F32:
    """(rows, cols) how black a cell is: 1 occupied, 0 free, -1 unknown; in sub-maps the mean of all visits."""
    strength = np.full(grid.cells.shape, -1.0, dtype=np.float32)
    strength[grid.cells == FREE], strength[grid.cells == OCCUPIED] = 0.0, 1.0
    places = {submap.submap_id: submap for submap in submaps}
    for patch_set in patch_sets:
        submap = places[patch_set.submap_id]
        rows, cols = submap.frame.shape
        window = strength[submap.row : submap.row + rows, submap.col : submap.col + cols]
        values = np.stack([patch.reflectance for patch in patch_set.patches])
        support = np.array([patch.support for patch in patch_set.patches], dtype=np.float64)
        weights = support[:, None, None] * ~np.isnan(values)
        total = weights.sum(axis=0)
        known = total > 0.0
        mean = (weights * np.nan_to_num(values)).sum(axis=0)[known] / total[known]
        window[known] = np.clip(mean / FULL_REFLECTANCE, 0.0, 1.0)
    return strength


def _map_pixels(strength: F32) -> tuple[U8, float]:
    """(height, width, 3) first row on top, and pixels per cell."""
    rows, cols = strength.shape
    reduce = max(math.ceil(cols / _MAP_WIDTH), math.ceil(rows / _MAP_HEIGHT))
    zoom = max(1, min(_MAP_WIDTH // cols, _MAP_HEIGHT // rows))
    blocks = np.flipud(largest_of_blocks(strength, reduce))[..., None]
    colours = np.where(blocks < 0.0, UNSEEN, np.array(PAPER) * (1.0 - blocks) + np.array(INK) * blocks)
    return _enlarged(colours.astype(np.uint8), zoom), zoom / reduce


def _enlarged(colours: U8, zoom: int) -> U8:
    """So many pixels per cell along both axes."""
    return colours.repeat(zoom, axis=0).repeat(zoom, axis=1)


def _sides(
    submaps: Sequence[SubMap], patch_sets: Sequence[PatchSet]
) -> tuple[list[tuple[SubMap, PatchSet]], list[tuple[SubMap, PatchSet]]]:
    """What is drawn left and right of the map: half of the sub-maps each, from top to bottom."""
    by_id = {patch_set.submap_id: patch_set for patch_set in patch_sets}
    pairs = [(submap, by_id[submap.submap_id]) for submap in submaps if submap.submap_id in by_id]
    pairs.sort(key=lambda pair: (pair[0].center_m[0], pair[0].submap_id))
    half = len(pairs) // 2
    left, right = (
        sorted(side, key=lambda pair: (-pair[0].center_m[1], pair[0].submap_id))
        for side in (pairs[:half], pairs[half:])
    )
    return left, right


def _column(side: Sequence[tuple[SubMap, PatchSet]]) -> list[_Group]:
    """Groups with tiles as large as lets them stand below one another in the picture."""
    column: list[_Group] = []
    for pixels in range(_LARGEST_TILE, _SMALLEST_TILE - 1, -4):
        column = [_Group(submap, patch_set, pixels) for submap, patch_set in side]
        if _height_of(column) <= _SHEET_HEIGHT:
            break
    return column


def _tops(column: Sequence[_Group], boxes: Sequence[tuple[int, int, int, int]], total: int) -> list[int]:
    """Top of each group: as near to the height of its rectangle as the others and the edges of the sheet let it.

    Groups that push one another go half of the way down and half of the way up.
    """
    heights = [group.size[1] for group in column]
    wanted = [
        (top + bottom - height) // 2 for height, (_, top, _, bottom) in zip(heights, boxes, strict=True)
    ]
    down = _pushed_down(wanted, heights, total)
    mirrored = [total - top - height for top, height in zip(wanted, heights, strict=True)]
    up = _pushed_down(mirrored[::-1], heights[::-1], total)[::-1]
    return [(one + total - other - height) // 2 for one, other, height in zip(down, up, heights, strict=True)]


def _pushed_down(wanted: Sequence[int], heights: Sequence[int], total: int) -> list[int]:
    """Tops from the first to the last: none above the end of the one before it, none over the end of the sheet."""
    tops: list[int] = []
    least, most = 0, total
    for top, height in zip(wanted, heights, strict=True):
        tops.append(max(least, top))
        least = tops[-1] + height + _GAP
    for number in range(len(tops) - 1, -1, -1):
        tops[number] = min(tops[number], most - heights[number])
        most = tops[number] - _GAP
    return tops


def _height_of(column: Sequence[_Group]) -> int:
    """Height of groups below one another."""
    return sum(group.size[1] + _GAP for group in column)


def _box(submap: SubMap, per_cell: float, corner: tuple[int, int]) -> tuple[int, int, int, int]:
    """Left, top, right and bottom of a rectangle; *corner* is the pixel of the lower left corner of the map."""
    rows, cols = submap.frame.shape
    left, bottom = corner[0] + submap.col * per_cell, corner[1] - submap.row * per_cell
    return round(left), round(bottom - rows * per_cell), round(left + cols * per_cell), round(bottom)
