"""Contested cells -> rectangles: growing, cutting, merging (paper, 1.3.1)."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from dynmap_cli.arrays import B1, I8, I64
from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.kernels.regions import segment_is_blocked

_EIGHT = np.ones((3, 3), dtype=bool)


@dataclass(frozen=True, slots=True)
class RegionParams:
    """How contested cells become rectangles; lengths in cells, areas in square cells.

    Attributes
    ----------
    growth : int
        Components are those of the contested cells dilated by this.
    min_cells : int
        Smaller components are left out.
    margin : int
        Border of a rectangle around its contested cells.
    max_area : float
        No rectangle, border included, is larger.
    reach : float
        Components whose centroids are farther apart never merge.
    """

    growth: int
    min_cells: int
    margin: int
    max_area: float
    reach: float


@dataclass(frozen=True, slots=True)
class Box:
    """A rectangle of cells, high ends exclusive, border included."""

    row: int
    col: int
    row_end: int
    col_end: int

    @property
    def area(self) -> int:
        """Number of cells."""
        return (self.row_end - self.row) * (self.col_end - self.col)

    @property
    def window(self) -> tuple[slice, slice]:
        """Rows and columns, to cut it out of the whole map."""
        return slice(self.row, self.row_end), slice(self.col, self.col_end)

    def union(self, other: Box) -> Box:
        """Smallest box around both."""
        return Box(
            min(self.row, other.row),
            min(self.col, other.col),
            max(self.row_end, other.row_end),
            max(self.col_end, other.col_end),
        )


def box_around(cells: I64, margin: int) -> Box:
    """Box of cells (n, 2) with a border; it may reach over the edge of the map."""
    (row, col), (row_end, col_end) = cells.min(axis=0), cells.max(axis=0)
    return Box(int(row) - margin, int(col) - margin, int(row_end) + margin + 1, int(col_end) + margin + 1)


def grow_components(contested: B1, params: RegionParams) -> list[I64]:
    """Groups of contested cells, (n, 2) each, none of whose boxes exceeds the cap.

    Cells that touch after dilation form a component. One over the cap is labelled again with less dilation;
    what is still too large without any is cut at its widest gap.
    """
    return _split(np.argwhere(contested).astype(np.int64), params.growth, params)


def _split(cells: I64, growth: int, params: RegionParams) -> list[I64]:
    """Components of cells at this dilation, split further where they exceed the cap."""
    kept: list[I64] = []
    for component in _components(cells, growth):
        if component.shape[0] < params.min_cells:
            continue
        if box_around(component, params.margin).area <= params.max_area:
            kept.append(component)
        elif growth > 0:
            kept += _split(component, growth - 1, params)
        else:
            for part in _cut_at_widest_gap(component):
                kept += _split(part, 0, params)
    return kept


def _components(cells: I64, growth: int) -> list[I64]:
    """Cells that touch (also at corners) after dilation by *growth*, in order of their first cell."""
    if cells.shape[0] == 0:
        return []
    box = box_around(cells, growth + 1)
    local = np.zeros((box.row_end - box.row, box.col_end - box.col), dtype=bool)
    rows, cols = cells[:, 0] - box.row, cells[:, 1] - box.col
    local[rows, cols] = True
    if growth:
        local = ndimage.maximum_filter(local, size=2 * growth + 1, mode="constant")
    labels, _ = ndimage.label(local, structure=_EIGHT)
    label = labels[rows, cols]
    order = np.argsort(label, kind="stable")
    return np.split(cells[order], np.flatnonzero(np.diff(label[order])) + 1)


def _cut_at_widest_gap(cells: I64) -> tuple[I64, I64]:
    """Two parts of cells, cut across an axis where it is empty the longest; else in the middle of the longer side."""
    gaps = []
    for axis in (0, 1):
        places = np.unique(cells[:, axis])
        steps = np.diff(places)
        if steps.size:
            middle = 0.5 * (places[0] + places[-1])
            at = np.lexsort((np.abs(places[:-1] + 0.5 * steps - middle), -steps))[0]
            gaps.append((int(steps[at]), int(places[-1] - places[0]), axis, int(places[at])))
    _, _, axis, last = max(gaps, key=lambda gap: (gap[0], gap[1], -gap[2]))
    below = cells[:, axis] <= last
    return cells[below], cells[~below]


def merge_regions(
    components: list[I64], standing: I8, params: RegionParams, dependent: B1 | None = None
) -> list[list[int]]:
    """Groups of components that see one another and fit under the cap, cheapest added area first.

    Two groups may merge while every pair of their components is mutually visible. With p contested cells
    this costs O(p log p): components lie apart, so each has a bounded number of partners within reach.

    Parameters
    ----------
    components : list of (n, 2) int64
    standing : (rows, cols) int8
        1 = blocks the sight.
    params : RegionParams
    dependent : (n, n) bool or None
        Which pairs may merge at all; None = every one.

    Returns
    -------
    list of list of int
        Indices into *components*, every one once.
    """
    boxes = {k: box_around(cells, params.margin) for k, cells in enumerate(components)}
    members = {k: [k] for k in boxes}
    partners = _partners(components, standing, params, boxes)
    if dependent is not None:
        partners = {k: {other for other in near if dependent[k, other]} for k, near in partners.items()}
    queue = [
        entry for k in partners for other in partners[k] if k < other for entry in _offer(boxes, k, other)
    ]
    heapq.heapify(queue)
    next_id = len(components)
    while queue:
        _, a, b = heapq.heappop(queue)
        if a not in members or b not in members:
            continue
        boxes[next_id] = boxes[a].union(boxes[b])
        members[next_id] = members.pop(a) + members.pop(b)
        of_a, of_b = partners.pop(a), partners.pop(b)
        for k in (of_a | of_b) - {a, b}:
            partners[k] -= {a, b}
        both = (of_a & of_b) - {a, b}
        partners[next_id] = {k for k in both if boxes[next_id].union(boxes[k]).area <= params.max_area}
        for k in sorted(partners[next_id]):
            partners[k].add(next_id)
            for entry in _offer(boxes, next_id, k):
                heapq.heappush(queue, entry)
        next_id += 1
    return [sorted(group) for group in members.values()]


def _offer(boxes: dict[int, Box], a: int, b: int) -> list[tuple[int, int, int]]:
    """Queue entry of a pair: the area that merging adds, then its numbers."""
    return [(boxes[a].union(boxes[b]).area - boxes[a].area - boxes[b].area, a, b)]


def _partners(
    components: list[I64], standing: I8, params: RegionParams, boxes: dict[int, Box]
) -> dict[int, set[int]]:
    """For each component the others within reach that fit under the cap with it and are mutually visible."""
    partners: dict[int, set[int]] = {k: set() for k in boxes}
    if len(components) < 2:
        return partners
    centroids = np.array([cells.mean(axis=0) for cells in components])
    trees = [cKDTree(cells) for cells in components]
    pairs = cKDTree(centroids).query_pairs(params.reach, output_type="ndarray")
    corners = np.array([[box.row, box.col, box.row_end, box.col_end] for box in boxes.values()])
    low = np.minimum(corners[pairs[:, 0], :2], corners[pairs[:, 1], :2])
    high = np.maximum(corners[pairs[:, 0], 2:], corners[pairs[:, 1], 2:])
    for a, b in pairs[(high - low).prod(axis=1) <= params.max_area].tolist():
        gaps, nearest = trees[b].query(components[a])
        at = int(np.argmin(gaps))
        ends = (
            (components[a][at] + 0.5, components[b][nearest[at]] + 0.5),
            (centroids[a] + 0.5, centroids[b] + 0.5),
        )
        if not any(
            segment_is_blocked(float(p[1]), float(p[0]), float(q[1]), float(q[0]), standing) for p, q in ends
        ):
            partners[a].add(b)
            partners[b].add(a)
    return partners


def make_submaps(groups: list[I64], frame: GridFrame, margin: int) -> tuple[SubMap, ...]:
    """Rectangles around groups of contested cells (n, 2), from the lowest y to the highest.

    A cell that lies in several rectangles is owned by the one of them whose contested cells are nearest.
    """
    boxes = [_clipped(box_around(cells, margin), frame) for cells in groups]
    order = sorted(range(len(groups)), key=lambda k: (boxes[k].row, boxes[k].col, boxes[k].area))
    nearest, owner = np.full(frame.shape, np.inf), np.full(frame.shape, -1, dtype=np.int32)
    for number, k in enumerate(order):
        window = boxes[k].window
        distance = ndimage.distance_transform_edt(~_contested(groups[k], boxes[k]))
        nearer = distance < nearest[window]
        nearest[window][nearer] = distance[nearer]
        owner[window][nearer] = number
    return tuple(
        SubMap(
            submap_id=number,
            frame=frame.window(boxes[k].row, boxes[k].col, *owner[boxes[k].window].shape),
            row=boxes[k].row,
            col=boxes[k].col,
            contested=_contested(groups[k], boxes[k]),
            owned=owner[boxes[k].window] == number,
            area_m2=boxes[k].area * frame.resolution_m**2,
        )
        for number, k in enumerate(order)
    )


def _contested(cells: I64, box: Box) -> B1:
    """Cells (n, 2) of the whole map as a mask of the box."""
    mask = np.zeros((box.row_end - box.row, box.col_end - box.col), dtype=bool)
    mask[cells[:, 0] - box.row, cells[:, 1] - box.col] = True
    return mask


def _clipped(box: Box, frame: GridFrame) -> Box:
    """The part of a box that lies in the map."""
    return Box(max(box.row, 0), max(box.col, 0), min(box.row_end, frame.rows), min(box.col_end, frame.cols))
