"""A localization in one picture: the map in the states believed last, and the path coloured by its verdicts."""

from __future__ import annotations

import csv
import math
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from dynmap_cli.arrays import F64
from dynmap_cli.domain.grid import UNKNOWN, OccupancyGrid
from dynmap_cli.domain.patches import NEVER_MAPPED, SURE, PatchSet
from dynmap_cli.domain.points import point_for_people
from dynmap_cli.domain.poses import Trajectory
from dynmap_cli.files.trajectory import parse_stamp, read_tum
from dynmap_cli.report.ink import INK, PAPER, colour_of_submap
from dynmap_cli.report.labels import Box, Label, above_legend, draw_labels
from dynmap_cli.report.pictures import MapPicture

NAME = "localization.png"
COLOURS = {"tracking": (40, 110, 200), "changed": (240, 128, 16), "lost": (200, 20, 50)}
_START, _NEVER_SEEN = (30, 140, 70), (120, 120, 120)
_JUMP_M = 1.0
"""No line is drawn between consecutive scans further apart: the robot was found elsewhere."""
_RADIUS = 7
_MARGIN_M = 1.0
_RING_M, _RING_PIXELS, _MOST_NAMED = 0.5, 14, 5
"""A place that changed is known to half a metre; its ring is never smaller than can be seen. As on the terminal, those
that were seen most often are named."""


@dataclass(frozen=True, slots=True)
class SeenSubMap:
    """A sub-map and what was believed of it last.

    Attributes
    ----------
    patch_set : PatchSet
    called : str
        Its number, and its name where it has one.
    patch : int or None
        The likeliest state at the last look; None where it never came into view.
    state : str
        What this state is called: its number, or the combination of objects that is nearest to it.
    probability : float
    """

    patch_set: PatchSet
    called: str
    patch: int | None = None
    state: str = ""
    probability: float = 0.0

    @property
    def label(self) -> str:
        """What stands beside it."""
        if self.patch is None:
            return f"{self.called}: {'not seen' if len(self.patch_set.patches) > 1 else 'one state is known'}"
        doubt = "undecided, " if self.probability < SURE else ""
        return f"{self.called}: {doubt}state {self.state} ({self.probability:.2f})"


def draw_localized(
    grid: OccupancyGrid,
    patch_sets: Sequence[PatchSet],
    names: Mapping[int, str],
    folder: Path,
    places: Sequence[Mapping[str, Any]] = (),
) -> Image.Image:
    """Draw what the files of a localization say.

    Parameters
    ----------
    grid : OccupancyGrid
        The map.
    patch_sets : sequence of PatchSet
    names : mapping of int to str
        What people call each sub-map, "" = nothing.
    folder : Path
        With trajectory.tum, states.csv and health.csv.
    places : sequence of mapping
        Where a map update is advised, as in the summary of the localization.
    """
    trajectory = read_tum(folder / "trajectory.tum")
    believed = _believed_last(folder / "states.csv")
    submaps = []
    for one in patch_sets:
        name = names.get(one.submap_id, "")
        called = f"{one.submap_id} ({name})" if name else str(one.submap_id)
        submaps.append(SeenSubMap(one, called, *believed.get(one.submap_id, ())))
    verdicts = _verdicts(folder / "health.csv", trajectory)
    shown = _without_edges(_as_believed(grid, submaps), trajectory.poses[:, :2])
    return _LocalizationPicture(shown).draw_path(trajectory, verdicts, submaps, places)


def _without_edges(grid: OccupancyGrid, path_m: F64) -> OccupancyGrid:
    """The map without what lies beyond all known cells and the path (n, 2), but for a margin."""
    known = np.argwhere(grid.cells != UNKNOWN)
    used = np.concatenate([known, grid.frame.to_cells(path_m[np.isfinite(path_m).all(axis=1)])])
    if not used.size:
        return grid
    margin = math.ceil(_MARGIN_M / grid.frame.resolution_m)
    first = np.maximum(used.min(axis=0) - margin, 0)
    last = np.minimum(used.max(axis=0) + margin + 1, grid.frame.shape)
    (row, col), (rows, cols) = first.tolist(), (last - first).tolist()
    if min(rows, cols) < 1:
        return grid
    return OccupancyGrid(
        grid.frame.window(row, col, rows, cols), grid.cells[row : row + rows, col : col + cols]
    )


def _as_believed(grid: OccupancyGrid, submaps: Sequence[SeenSubMap]) -> OccupancyGrid:
    """The map with each sub-map that was seen in the state believed last."""
    cells = grid.cells.copy()
    frame = grid.frame
    for submap in submaps:
        inner = submap.patch_set.frame
        row = round((inner.origin_y_m - frame.origin_y_m) / frame.resolution_m)
        col = round((inner.origin_x_m - frame.origin_x_m) / frame.resolution_m)
        for patch in submap.patch_set.patches:
            if patch.patch_id != submap.patch or min(row, col) < 0:
                continue
            window = cells[row : row + inner.rows, col : col + inner.cols]
            state = patch.cells[: window.shape[0], : window.shape[1]]
            window[state != UNKNOWN] = state[state != UNKNOWN]
    return replace(grid, cells=cells)


class _LocalizationPicture(MapPicture):
    """The map with a path on it."""

    def draw_path(
        self,
        trajectory: Trajectory,
        verdicts: Sequence[str],
        submaps: Sequence[SeenSubMap],
        places: Sequence[Mapping[str, Any]],
    ) -> Image.Image:
        """Put sub-maps, path, start, changed places, coordinates, words and a legend on the map."""
        image = Image.fromarray(self._pixels.copy())
        pen = ImageDraw.Draw(image)
        spots = self._to_pixels(trajectory.poses[:, :2])
        steps_m = np.linalg.norm(np.diff(trajectory.poses[:, :2], axis=0), axis=1)
        for verdict, colour in COLOURS.items():
            for line in _lines(verdicts, verdict, steps_m):
                pen.line([tuple(spot) for spot in spots[line].tolist()], fill=colour, width=3)
        labels = [Label("start", _mark_start(pen, spots[0]), _START)] if spots.shape[0] else []
        for submap in submaps:
            colour = _NEVER_SEEN if submap.patch is None else colour_of_submap(submap.patch_set.submap_id)
            labels.append(Label(submap.label, self._draw_box(pen, submap.patch_set.frame, colour), colour))
        rings = [self._mark_changed(pen, place) for place in places]
        labels += [
            Label(_called(place), ring, COLOURS["changed"])
            for place, ring in zip(places[:_MOST_NAMED], rings, strict=False)
        ]
        draw_labels(image, labels)
        words = [
            ("path:", INK),
            *((verdict, colour) for verdict, colour in COLOURS.items() if verdict in verdicts),
        ]
        if any(submap.patch is not None for submap in submaps):
            words.append(("frames: sub-maps, state believed last (probability)", INK))
        if places:
            words.append(("rings: the map is out of date", COLOURS["changed"]))
        return above_legend(self._in_axes(image), words)

    def _mark_changed(self, pen: ImageDraw.ImageDraw, place: Mapping[str, Any]) -> Box:
        """Draw a ring around a place where a map update is advised; give back its box."""
        ((x, y),) = self._to_pixels(np.array([[place["x_m"], place["y_m"]]])).tolist()
        radius = max(_RING_PIXELS, _RING_M * self._pixels_per_m)
        box = (x - radius, y - radius, x + radius, y + radius)
        pen.ellipse(box, outline=COLOURS["changed"], width=4)
        return box


def _called(place: Mapping[str, Any]) -> str:
    """What stands beside a ring."""
    which = place["submap"] if place["submap"] is not None else point_for_people(place["x_m"], place["y_m"])
    return f"{place['kind']} {which}"


def _mark_start(pen: ImageDraw.ImageDraw, spot: F64) -> Box:
    """Draw a disc where the robot was at the first scan; give back its box."""
    x, y = spot.tolist()
    box = (x - _RADIUS, y - _RADIUS, x + _RADIUS, y + _RADIUS)
    pen.ellipse(box, fill=_START, outline=PAPER, width=2)
    return box


def _lines(verdicts: Sequence[str], verdict: str, steps_m: F64) -> list[slice]:
    """Stretches of the path under one verdict, each with the scan after it; cut where the path jumps."""
    lines, first = [], None
    for k, step_m in enumerate(steps_m.tolist()):
        goes_on = verdicts[k] == verdict and step_m <= _JUMP_M
        if goes_on and first is None:
            first = k
        if not goes_on and first is not None:
            lines.append(slice(first, k + 1))
            first = None
    if first is not None:
        lines.append(slice(first, steps_m.size + 1))
    return lines


def _verdicts(path: Path, trajectory: Trajectory) -> list[str]:
    """Of each scan: that of the update before it, or of the first."""
    rows = [(parse_stamp(row["stamp_s"]), row["verdict"]) for row in _rows(path)]
    stamps = [stamp for stamp, _ in rows]
    return [
        rows[max(bisect_right(stamps, stamp) - 1, 0)][1] if rows else "lost"
        for stamp in trajectory.stamps_ns.tolist()
    ]


def _believed_last(path: Path) -> dict[int, tuple[int, str, float]]:
    """Likeliest patch at the last look, what it is called and its probability, by sub-map."""
    last: dict[int, int] = {}
    best: dict[int, tuple[int, str, float]] = {}
    for row in _rows(path):
        submap, stamp = int(row["submap"]), parse_stamp(row["stamp_s"])
        if last.get(submap) != stamp:
            last[submap], best[submap] = stamp, (NEVER_MAPPED, "", -1.0)
        patch, probability = int(row["patch"]), float(row["probability"])
        if probability > best[submap][2]:
            state = row["nearest"] if patch == NEVER_MAPPED else str(patch)
            best[submap] = (patch, state, probability)
    return best


def _rows(path: Path) -> Iterator[dict[str, str]]:
    """Row by row: a day of states is large."""
    with path.open(encoding="ascii", newline="") as stream:
        yield from csv.DictReader(stream)
