"""One map of several drives: each registered on its own, placed on the others, and all joined in one graph."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dynmap_cli.arrays import F32, F64, I64
from dynmap_cli.counting.counts import rays_of
from dynmap_cli.counting.em import count_ended
from dynmap_cli.domain.poses import compose, inverse
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.errors import LogError
from dynmap_cli.kernels.beams import Rays
from dynmap_cli.mapping.back_end import Graph, Known, close_loops, refine_graph, spread_to_scans
from dynmap_cli.mapping.local_maps import make_local_maps
from dynmap_cli.mapping.loops import Loop, LoopParams
from dynmap_cli.mapping.matched_range import matched_range_m
from dynmap_cli.mapping.placing import Places, joined_places, near_pairs, place_drive
from dynmap_cli.mapping.registrar import Registrar
from dynmap_cli.scan_matching.front_end import Registered
from dynmap_cli.scan_matching.sweeps import Sweeps, sweeps_of, times_of

if TYPE_CHECKING:
    from dynmap_cli.mapping.settings import MapSettings

_log = logging.getLogger(__name__)
_FEW_DYNAMIC = 0.02
_LEAST_PLACES = 2
_PAIR_REACH_M, _N_PAIRS = 2.0, 12
_LONGEST_GAP_S, _SOON_S = 60.0, 3600.0


class Site:
    """Poses of all scans of a log, whose drives it registers and joins.

    Attributes
    ----------
    log : ScanLog
    drives : tuple of Registrar
        One of each drive; empty where the recorded poses are taken as they are.
    matched_range_m : float
        Range up to which returns are matched.
    graph : Graph or None
        Of the key scans of all drives.
    """

    def __init__(
        self, log: ScanLog, settings: MapSettings, *, is_crowded: bool = False, folder: Path | None = None
    ) -> None:
        self.log, self._settings, self._folder = log, settings, folder
        self.drives: tuple[Registrar, ...] = ()
        self.matched_range_m = matched_range_m(log, settings.usable_range_m)
        if settings.poses != "recorded":
            self.drives = tuple(
                Registrar(_drive_of(log, number), self.matched_range_m, is_crowded=is_crowded)
                for number in range(log.n_drives)
            )
        self.graph: Graph | None = None
        self._rays: Rays = rays_of(log, self.matched_range_m)
        self._front: Registered | None = None
        self._site_from_drive: F64 | None = None

    def poses(self, weights: F32 | None, label: str) -> F64:
        """(n_scans, 3) poses in the order of the log, with the beams weighted by e (Eq. 1.11)."""
        if self._settings.poses == "recorded":
            return np.array(self.log.odometry)
        sweeps = sweeps_of(self.log, weights, self._folder)
        is_first = self._front is None
        if self._front is None or self.graph is None or not _few_are_dynamic(weights):
            self._front = self.graph = None
            self._front, self.graph = self._register(sweeps, label)
            # In the first of several rounds the next one fits the poses again.
            is_last = not is_first or self._settings.max_rounds == 1
        else:
            # Hardly anything was filtered: the registration stands, only the poses are fitted again.
            is_last = True
        if is_last:
            # Its edges are measured anew, and are as many.
            graph, self.graph = self.graph.without_edges(), None
            self.graph = refine_graph(sweeps, self._rays, self._front, graph)
        in_order = spread_to_scans(self._front, self.graph, sweeps.drive_index)
        poses = np.empty_like(in_order)
        poses[np.argsort(self.log.arrival_index, kind="stable")] = in_order
        return poses

    def _register(self, sweeps: Sweeps, label: str) -> tuple[Registered, Graph]:
        """Register each drive, then join them."""
        parts = [
            drive.register(self._own_sweeps(sweeps, number), label)
            for number, drive in enumerate(self.drives)
        ]
        self._take_lasers()
        if len(parts) == 1:
            return parts[0]
        if self._site_from_drive is None:
            self._site_from_drive = self._place(sweeps, parts)
        front = _joined_fronts([front for front, _ in parts], self._site_from_drive)
        known = _known([graph for _, graph in parts], self._site_from_drive)
        graph = close_loops(sweeps, self._rays, front, LoopParams(), _log.debug, known)
        first_keys = np.unique(sweeps.drive_index[graph.keys], return_index=True)[1]
        drive_poses = np.array([one.poses[one.is_key][0] for one, _ in parts])
        self._site_from_drive = compose(graph.poses[first_keys], inverse(drive_poses))
        return front, graph

    def _take_lasers(self) -> None:
        """The order of the beams and the mountings as the drives found them, for each drive's own geometries."""
        intervals, mounted = self._rays.beam_interval_s.copy(), self._rays.sensor_poses.copy()
        for drive in self.drives:
            own = np.unique(drive.log.geometry_index)
            intervals[own] = drive.rays.beam_interval_s[own]
            mounted[own] = drive.rays.sensor_poses[own]
        # The log makes its columns read-only; the kernels keep one signature with a copy.
        self.log = replace(self.log, beam_interval_s=intervals.copy(), sensor_poses=mounted.copy())
        self._rays = rays_of(self.log, self.matched_range_m)

    def _own_sweeps(self, sweeps: Sweeps, number: int) -> Sweeps:
        """The sweeps of one drive; they are those of the whole log where there is no other."""
        if len(self.drives) == 1:
            return sweeps
        part = sweeps.part(*np.searchsorted(sweeps.drive_index, (number, number + 1)).tolist())
        return replace(
            part, times_s=times_of(self.drives[number].log), drive_index=np.zeros_like(part.drive_index)
        )

    def _place(self, sweeps: Sweeps, parts: Sequence[tuple[Registered, Graph]]) -> F64:
        """(n_drives, 3) poses of the drives in the frame of the first.

        Raises
        ------
        LogError
            If a drive does not fit.
        """
        places = [
            self._places(self._own_sweeps(sweeps, number), number, *part) for number, part in enumerate(parts)
        ]
        found: dict[int, F64] = {0: np.zeros(3)}
        waiting = [*range(1, len(parts))]
        evidence: dict[int, str] = {}
        while waiting:
            site = joined_places([places[number].moved(pose) for number, pose in found.items()])
            before = [*waiting]
            for number in before:
                placement = place_drive(site, places[number])
                evidence[number] = placement.evidence
                if placement.site_from_drive is not None:
                    _log.info("%s: %s", self._names(number), placement.evidence)
                    found[number] = placement.site_from_drive
                    waiting.remove(number)
                    break
            if waiting == before:
                others = "; ".join(self._names(number) for number in found)
                msg = (
                    f"{self._names(waiting[0])}: does not fit on the map of {others}: {evidence[waiting[0]]}. "
                    f"Leave it out, or build it on its own{self._or_as_one_drive(waiting[0])}."
                )
                raise LogError(msg)
        return np.array([found[number] for number in range(len(parts))])

    def _places(self, sweeps: Sweeps, number: int, front: Registered, graph: Graph) -> Places:
        """Local maps of one drive in its own frame."""
        drive = self.drives[number]
        if graph.anchors.size < _LEAST_PLACES:
            path_m = float(np.linalg.norm(np.diff(front.poses[:, :2], axis=0), axis=1).sum())
            msg = (
                f"{self._names(number)}: the robot hardly moves ({path_m:.1f} m), so one map with the others would "
                "rest on a single place. Leave it out, or build it on its own."
            )
            raise LogError(msg)
        maps = make_local_maps(sweeps, drive.rays, front.twists, graph.keys, graph.poses)
        return Places(maps, graph.poses[graph.anchors])

    def _or_as_one_drive(self, number: int) -> str:
        """What else can be done where a drive begins soon after another one whose odometry it may go on with."""
        first_ns = self.drives[number].log.stamps_ns[0]
        ends_ns = [drive.log.stamps_ns[-1] for drive in self.drives if drive.log.stamps_ns[-1] < first_ns]
        pause_s = float(first_ns - max(ends_ns, default=0)) * 1e-9
        if pause_s > _SOON_S or pause_s < _LONGEST_GAP_S:
            return ""
        return (
            "; if its odometry goes on with that of the one before, set ingest.max_gap_s above "
            f"{np.ceil(pause_s):.0f} to make them one drive"
        )

    def _names(self, number: int) -> str:
        return ", ".join(self.log.recordings_of(number))


def _rows_of(log: ScanLog, number: int) -> slice | I64:
    """The sweeps of one drive; a slice where they follow one another, which copies nothing."""
    rows = np.flatnonzero(log.drive_index == number)
    if rows.size and rows[-1] - rows[0] + 1 == rows.size:
        return slice(int(rows[0]), int(rows[-1]) + 1)
    return rows.astype(np.int64)


def _drive_of(log: ScanLog, number: int) -> ScanLog:
    """The sweeps of one drive as a log of its own."""
    if log.n_drives == 1:
        return log
    part = log.select(_rows_of(log, number))
    return replace(part, drive_of_recording=np.zeros(len(log.recordings), dtype=np.int32))


def _joined_fronts(fronts: Sequence[Registered], site_from_drive: F64) -> Registered:
    """What the front end found in all drives, in one frame."""
    poses, information = [], []
    for front, pose in zip(fronts, site_from_drive, strict=True):
        poses.append(compose(pose, front.poses))
        turn = np.eye(3)
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        turn[:2, :2] = [[cos, -sin], [sin, cos]]
        information.append(turn @ front.information @ turn.T)
    return Registered(
        np.concatenate(poses),
        np.concatenate([front.shares for front in fronts]),
        np.concatenate(information),
        np.concatenate([front.twists for front in fronts]),
        np.concatenate([front.is_key for front in fronts]),
        np.concatenate([front.is_lost for front in fronts]),
        np.concatenate([front.is_wide for front in fronts]),
    )


def _known(graphs: Sequence[Graph], site_from_drive: F64) -> Known:
    """What the graphs of the drives say about their common one."""
    poses: list[F64] = []
    anchor_poses: list[F64] = []
    loops: list[Loop] = []
    rejected: dict[tuple[int, int], str] = {}
    first_of_drive: list[int] = []
    n_maps = 0
    for graph, pose in zip(graphs, site_from_drive, strict=True):
        poses.append(compose(pose, graph.poses))
        anchor_poses.append(poses[-1][graph.anchors])
        loops += [
            Loop(loop.fixed + n_maps, loop.moved + n_maps, loop.fit, loop.shift_m, loop.turn_rad)
            for loop in graph.loops
        ]
        rejected |= {(a + n_maps, b + n_maps): reason for (a, b), reason in graph.rejected.items()}
        first_of_drive.append(n_maps)
        n_maps += graph.anchors.size
    pairs = near_pairs(np.concatenate(anchor_poses), np.array(first_of_drive), _PAIR_REACH_M, _N_PAIRS)
    return Known(np.concatenate(poses), tuple(loops), rejected, tuple(pairs))


def _few_are_dynamic(weights: F32 | None) -> bool:
    """Whether so few beams were taken out that they cannot have misled the registration."""
    if weights is None:
        return False
    ended, dynamic = count_ended(weights)
    return dynamic < _FEW_DYNAMIC * ended
