"""Local maps of a few key scans each, and how well two of them fit on one another."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynmap_cli.arrays import F32, F64, I32, I64, U8
from dynmap_cli.domain.poses import between
from dynmap_cli.files.tables import Shelf
from dynmap_cli.kernels.beams import Rays
from dynmap_cli.kernels.local_maps import (
    COARSE,
    COARSE_M,
    FREE_SIDE,
    SIZE,
    collect_local_map,
    draw_local_map,
)
from dynmap_cli.kernels.map_fits import fit_scans, judge_fit, refine_local_map, search_coarse
from dynmap_cli.scan_matching.sweeps import Sweeps

_EVERY, _MEMBERS = 10, 8
_MAX_POINTS, _HALF_CELLS = 20_000, 768
"""Maps of 77 m x 77 m, so that two whose anchors seem 12 m apart, shifted by 12 m, do not meet around the torus."""
_SPACING_M = 0.03
_N_PLACES, _PROMISING = 6, 0.8
_POINTS_TO_TRY, _POINTS_TO_FIT = 250, 1000
_MAPS_IN_MEMORY, _SCANS_AT_ONCE = 256, 64


@dataclass(frozen=True, slots=True)
class LocalMap:
    """What a few consecutive key scans saw, in the frame of the one in the middle.

    Attributes
    ----------
    anchor : int
        Number of the middle key scan.
    points, normals : (n, 2) float32
        Hit centroids and the normals of the lines through them, to the side they were seen from; (0, 0) = no line.
    packed_free : (FREE_SIDE, ceil(FREE_SIDE / 8)) uint8
        The mask `free`, eight cells to a byte: a long recording has thousands of maps.
    """

    anchor: int
    points: F32
    normals: F32
    packed_free: U8

    @property
    def free(self) -> U8:
        """(FREE_SIDE, FREE_SIDE) uint8, 1 where nothing stands."""
        return np.unpackbits(self.packed_free, axis=1, count=FREE_SIDE)


@dataclass(frozen=True, slots=True)
class Fit:
    """How a moved map fits on a fixed one.

    Attributes
    ----------
    pose : (3,) float64
        fixed_from_moved.
    information : (3, 3) float64
        Normal equations of the point-to-line residuals, per square metre.
    residual_m : float
    matched, seen, in_free : float
        Shares of the moved map's points: on a line of the fixed one, seen by it, in its free space.
    """

    pose: F64
    information: F64
    residual_m: float
    matched: float
    seen: float
    in_free: float

    @property
    def matched_of_seen(self) -> float:
        """Share of the points that the fixed map sees which lie on its lines."""
        return self.matched / max(self.seen, 1e-9)


class LocalMaps:
    """Many local maps, by number, of which those that were asked for last are in memory.

    A long recording has more than fit: ten hours some 20000 of 80 kB.

    Parameters
    ----------
    folder : Path or None
        On which disk the others lie; None = where temporary files are put.
    """

    def __init__(self, folder: Path | None) -> None:
        self._shelves = [Shelf(folder)]
        self._maps: list[LocalMap] = []
        self._n_asked = 0

    def add(self, local_map: LocalMap) -> None:
        """Put one behind those that are there."""
        put = self._shelves[0].put
        self._maps.append(
            LocalMap(
                local_map.anchor,
                put(local_map.points),
                put(local_map.normals),
                put(local_map.packed_free),
            )
        )

    def __add__(self, others: LocalMaps) -> LocalMaps:
        """These and others."""
        result = LocalMaps(None)
        result._shelves = [*self._shelves, *others._shelves]
        result._maps = [*self._maps, *others._maps]
        return result

    def __len__(self) -> int:
        """How many there are."""
        return len(self._maps)

    def __getitem__(self, number: int) -> LocalMap:
        """One of them."""
        self._n_asked += 1
        if self._n_asked % _MAPS_IN_MEMORY == 0:
            for shelf in self._shelves:
                shelf.give_back()
        return self._maps[number]

    def __iter__(self) -> Iterator[LocalMap]:
        """All of them, in their order."""
        return (self[number] for number in range(len(self)))


def make_local_maps(sweeps: Sweeps, rays: Rays, twists: F64, keys: I64, key_poses: F64) -> LocalMaps:
    """Collect a local map around every tenth key scan of each drive.

    Parameters
    ----------
    sweeps : Sweeps
    rays : Rays
    twists : (n_scans, 3) float64
        Velocity during each scan.
    keys : (n_keys,) int64
        Scan numbers of the key scans.
    key_poses : (n_keys, 3) float64
        Their poses, which are good over a few metres.
    """
    collector, maps = Collector(sweeps, rays), LocalMaps(sweeps.folder)
    for anchor, members in _members(sweeps.drive_index[keys]):
        poses = between(key_poses[anchor], key_poses[members])
        maps.add(collector.collect(anchor, keys[members], poses, twists))
    return maps


class Collector:
    """Makes local maps of some scans, one after another in the same memory."""

    def __init__(self, sweeps: Sweeps, rays: Rays) -> None:
        self._sweeps, self._rays = sweeps, rays
        self._sums = np.zeros((2 * _HALF_CELLS, 2 * _HALF_CELLS, 3), dtype=np.int64)
        self._points, self._normals = (np.empty((_MAX_POINTS, 2), np.float32) for _ in range(2))
        self._free = np.zeros((FREE_SIDE, FREE_SIDE), dtype=np.uint8)

    def collect(self, anchor: int, scans: I64, poses: F64, twists: F64) -> LocalMap:
        """What some scans saw.

        Parameters
        ----------
        anchor : int
        scans : (k,) int64
        poses : (k, 3) float64
            anchor_from_robot.
        twists : (n_scans, 3) float64
            Velocity during each scan.
        """
        count = collect_local_map(
            *self._sweeps.read(scans),
            self._sweeps.geometry_index[scans],
            self._rays,
            twists[scans],
            poses,
            _SPACING_M,
            self._sums,
            self._points,
            self._normals,
            self._free,
        )
        packed = np.packbits(self._free, axis=1)
        return LocalMap(anchor, self._points[:count].copy(), self._normals[:count].copy(), packed)


def _members(drive_index: I32) -> Iterator[tuple[int, I64]]:
    """The key scan in the middle of each local map, and the key scans in it; those of one drive only."""
    first = 0
    for size in np.bincount(drive_index).tolist():
        last = first + size
        for anchor in range(min(first + _EVERY // 2, last - 1), last, _EVERY) if size else ():
            yield anchor, np.arange(max(anchor - _MEMBERS, first), min(anchor + _MEMBERS + 1, last))
        first = last


def anchors_of(maps: LocalMaps) -> I64:
    """(n_maps,) numbers of the key scans in the middle of local maps."""
    return np.array([local_map.anchor for local_map in maps], dtype=np.int64)


class Easel:
    """Where one local map at a time is drawn, so that others can be fitted on it."""

    def __init__(self) -> None:
        self._index = np.full((SIZE, SIZE), -1, dtype=np.int32)
        self._field = np.zeros((SIZE, SIZE), dtype=np.uint8)
        self._coarse = np.zeros((COARSE, COARSE), dtype=np.uint8)
        self._scores = np.zeros((COARSE, COARSE), dtype=np.int32)
        self._free = np.zeros((FREE_SIDE, FREE_SIDE), dtype=np.uint8)
        self._drawn: LocalMap | None = None

    def draw(self, local_map: LocalMap) -> None:
        """Replace the drawn map."""
        if self._drawn is local_map:
            return
        if self._drawn is not None:
            draw_local_map(
                self._drawn.points, self._drawn.points.shape[0], 0, self._index, self._field, self._coarse
            )
        draw_local_map(local_map.points, local_map.points.shape[0], 1, self._index, self._field, self._coarse)
        self._free = local_map.free
        self._drawn = local_map

    def search(self, moved: LocalMap, guess: F64, reach_m: float, half_turn_rad: float) -> list[Fit]:
        """Fits of *moved* at the best places around a guess, most matched points first; none where nothing overlaps."""
        places = np.zeros((_N_PLACES, 4))
        reach = int(np.ceil(reach_m / COARSE_M))
        count = search_coarse(
            moved.points,
            moved.points.shape[0],
            guess,
            half_turn_rad,
            reach,
            self._coarse,
            self._scores,
            places,
        )
        if count == 0 or not places[0, 3] > 0.0:
            return []
        promising = places[:count][places[:count, 3] >= _PROMISING * places[0, 3]]
        fits = [self.fit(moved, place[:3], polish=False, n_points=_POINTS_TO_TRY) for place in promising]
        fits.sort(key=lambda fit: -fit.matched)
        return [self.fit(moved, fits[0].pose, polish=True), *fits[1:]]

    def fit(self, moved: LocalMap, start: F64, *, polish: bool, n_points: int = _POINTS_TO_FIT) -> Fit:
        """Fit of a map near a start; *polish* = the start is within a few centimetres."""
        stride = max(1, moved.points.shape[0] // n_points)
        drawn = self._require()
        pose, information = start.astype(np.float64).copy(), np.zeros((3, 3))
        residual = refine_local_map(
            moved.points,
            moved.normals,
            moved.points.shape[0],
            drawn.points,
            drawn.normals,
            self._index,
            self._field,
            pose,
            information,
            stride,
            int(polish),
        )
        return self._judged(moved, pose, information, residual, stride)

    def fit_scans(
        self, sweeps: Sweeps, rays: Rays, twists: F64, scans: I64, starts: F64
    ) -> tuple[F64, F64, F64]:
        """Fit single scans near their starts (k, 3), drawn_from_robot.

        Returns
        -------
        poses : (k, 3) float64
        information : (k, 3, 3) float64
        judged : (k, 4) float64
            Shares matched, seen and in free space, and residual in metres.
        """
        drawn = self._require()
        poses, information, judged = starts.copy(), np.zeros((scans.size, 3, 3)), np.zeros((scans.size, 4))
        # To a place that is often come back to there are thousands.
        for first in range(0, scans.size, _SCANS_AT_ONCE):
            part = slice(first, first + _SCANS_AT_ONCE)
            fit_scans(
                *sweeps.read(scans[part]),
                sweeps.geometry_index[scans[part]],
                rays,
                twists[scans[part]],
                _SPACING_M,
                drawn.points,
                drawn.normals,
                self._free,
                self._index,
                self._field,
                poses[part],
                information[part],
                judged[part],
            )
        return poses, information, judged

    def judge(self, moved: LocalMap, pose: F64) -> Fit:
        """Shares at a given pose, without refinement."""
        stride = max(1, moved.points.shape[0] // _POINTS_TO_FIT)
        return self._judged(moved, pose, np.zeros((3, 3)), 0.0, stride)

    def _judged(self, moved: LocalMap, pose: F64, information: F64, residual_m: float, stride: int) -> Fit:
        drawn = self._require()
        shares = np.zeros(3)
        judge_fit(
            moved.points,
            moved.normals,
            moved.points.shape[0],
            drawn.points,
            drawn.normals,
            self._free,
            self._index,
            pose,
            stride,
            shares,
        )
        return Fit(pose, information, residual_m, *shares.tolist())

    def _require(self) -> LocalMap:
        if self._drawn is None:
            msg = "draw a local map first"
            raise ValueError(msg)
        return self._drawn
