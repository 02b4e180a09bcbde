"""Poses, map and moving beams together: registration and beam filter in turn (paper, Fig. 1.2)."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dynmap_cli.arrays import F32, F64
from dynmap_cli.counting.counts import SCANS_PER_CHUNK, twists_of
from dynmap_cli.counting.em import FilteredMap, FilterParams, all_static, count_ended, filter_beams, occupancy
from dynmap_cli.counting.frames import frame_of_scans
from dynmap_cli.counting.standing import LookParams, filter_by_looks
from dynmap_cli.domain.grid import OccupancyGrid
from dynmap_cli.domain.mapped import copied_rows, give_back
from dynmap_cli.domain.poses import Trajectory
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.files.tables import new_table
from dynmap_cli.mapping.first_guess import crowd_weights
from dynmap_cli.mapping.site import Site

if TYPE_CHECKING:
    from dynmap_cli.mapping.back_end import Graph
    from dynmap_cli.mapping.registrar import Registrar
    from dynmap_cli.mapping.settings import MapSettings

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Round:
    """What one round of registration and filtering changed.

    Attributes
    ----------
    log_likelihood : float
        Eq. 1.7 at the end of the round, without the prior's constant.
    dynamic_share : float
        Share of the beams with an end point that are called dynamic.
    changed_labels : float
        Share of the beams whose label changed in this round; 1 in the first.
    pose_shift_m : float
        Largest shift of a pose in this round; NaN in the first.
    occupancy : OccupancyGrid
        The map at the end of the round.
    """

    log_likelihood: float
    dynamic_share: float
    changed_labels: float
    pose_shift_m: float
    occupancy: OccupancyGrid


@dataclass(frozen=True, slots=True)
class FilterMap:
    """Result of the room, in the order of the scan log.

    Attributes
    ----------
    trajectory : Trajectory
    filtered : FilteredMap
    rounds : tuple of Round
    unfiltered : OccupancyGrid
        What the first round would have drawn of all beams.
    graph : Graph or None
        Of the key scans of all drives; None where the recorded poses were taken as they are.
    beam_interval_s : (n_geometries,) float64
        Time from one beam to the next as the scans show it: negative where a sweep runs from the last beam to the
        first, 0 where all beams are made at once.
    sensor_poses : (n_geometries, 3) float64
        robot_from_sensor, corrected where several lasers contradict one another.
    drives : tuple of Registrar
        What registered each drive; empty where the recorded poses were taken as they are.
    matched_range_m : float
        Range up to which returns were matched.
    """

    trajectory: Trajectory
    filtered: FilteredMap
    rounds: tuple[Round, ...]
    unfiltered: OccupancyGrid
    graph: Graph | None
    beam_interval_s: F64
    sensor_poses: F64
    drives: tuple[Registrar, ...]
    matched_range_m: float


def build_filter_map(
    log: ScanLog, settings: MapSettings, *, threads: int, folder: Path | None = None
) -> FilterMap:
    """Find poses, map and moving beams together (EM).

    Parameters
    ----------
    log : ScanLog
    settings : MapSettings
    threads : int
    folder : Path, optional
        Where tables of all beams are kept when they are large; None = where temporary files are put.
    """
    params = FilterParams(
        settings.static_prior,
        settings.support_cells,
        settings.usable_range_m,
        settings.em,
        settings.stop_at_walls,
    )
    crowd: F32 | None = None
    if settings.poses == "estimate":
        crowd = crowd_weights(log, settings.usable_range_m, threads=threads, folder=folder)
    if crowd is not None:
        _log.info("a crowd: the path is found without the beams that move by the odometry of a few seconds")
    site = Site(log, settings, is_crowded=crowd is not None, folder=folder)
    known: F32 | None = None
    spare: F32 | None = None
    poses: F64 | None = None
    rounds: list[Round] = []
    while True:
        # Two tables in turn: e of the round before (known), and that of this one.
        spare = new_table(log.n_scans, log.n_beams, folder) if spare is None else spare
        weights = known
        if crowd is not None:
            # Where people come by all the time, few of them stand out on the map of the whole recording.
            weights = crowd if known is None else _least_of(known, crowd, spare)
        before, poses = poses, site.poses(weights, f"round {len(rounds) + 1} of {settings.max_rounds}")
        frame = frame_of_scans(site.log, poses, settings.usable_range_m, settings.resolution_m)
        twists = twists_of(site.log, poses)
        filtered = filter_beams(site.log, poses, frame, params, twists=twists, threads=threads, out=spare)
        if not rounds:
            unfiltered = occupancy(all_static(filtered.counting_map))
        rounds.append(_round(filtered, known, poses, before))
        spare, known = known, filtered.static_probability
        percent = 100 * filtered.dynamic_share
        _log.info("round %d: %.1f %% of the beams dynamic, before looks", len(rounds), percent)
        if rounds[-1].changed_labels < settings.stop_label_share or len(rounds) == settings.max_rounds:
            return FilterMap(
                Trajectory(log.stamps_ns, poses),
                _with_looks(filtered, site.log, poses, twists, settings, threads, folder),
                tuple(rounds),
                unfiltered,
                site.graph,
                np.array(site.log.beam_interval_s),
                np.array(site.log.sensor_poses),
                site.drives,
                site.matched_range_m,
            )
        del filtered  # as large as the map of the next round


def _with_looks(
    filtered: FilteredMap,
    log: ScanLog,
    poses: F64,
    twists: F64 | None,
    settings: MapSettings,
    threads: int,
    folder: Path | None,
) -> FilteredMap:
    """The result with those taken out that stood longer, where looks are asked for."""
    if settings.look_s == 0.0:
        return filtered
    return filter_by_looks(
        filtered,
        log,
        poses,
        LookParams(look_s=settings.look_s, look_prior=settings.look_prior),
        usable_range_m=settings.usable_range_m,
        twists=twists,
        threads=threads,
        out=(filtered.static_probability, new_table(log.n_scans, log.n_beams, folder, np.bool_)),
    )


def _round(filtered: FilteredMap, e_before: F32 | None, poses: F64, poses_before: F64 | None) -> Round:
    """Compare a round with the one before, if there is one."""
    changed, shift = 1.0, float("nan")
    if e_before is not None and poses_before is not None:
        changed = _changed_share(filtered.static_probability, e_before)
        shift = float(np.nanmax(np.linalg.norm(poses[:, :2] - poses_before[:, :2], axis=1), initial=0.0))
    drawn = occupancy(filtered.counting_map)
    return Round(filtered.log_likelihood, filtered.dynamic_share, changed, shift, drawn)


def _least_of(e: F32, other: F32, out: F32) -> F32:
    """The smaller e of two tables, or the one that is known."""
    for first in range(0, e.shape[0], SCANS_PER_CHUNK):
        rows = slice(first, first + SCANS_PER_CHUNK)
        out[rows] = np.fmin(copied_rows(e, rows), copied_rows(other, rows))
        give_back(out)
    return out


def _changed_share(e: F32, before: F32) -> float:
    """Share of the beams with an end point that are called otherwise than before."""
    differ = 0
    for first in range(0, e.shape[0], SCANS_PER_CHUNK):
        rows = slice(first, first + SCANS_PER_CHUNK)
        now = copied_rows(e, rows)
        differs = (now < 0.5) != (copied_rows(before, rows) < 0.5)
        differ += int(np.count_nonzero(differs & np.isfinite(now)))
    return differ / max(count_ended(e)[0], 1)
