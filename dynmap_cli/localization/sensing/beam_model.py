"""The beam model of Eq. 1.1 as a sensor model: reflectances of map and patches in one pool, and what a scan says.

It knows that a beam passes what is not there, which a likelihood field does not see; but it is so sharp that
only a filter that already knows about where the robot is can use it.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from dynmap_cli.arrays import F32, F64, I32
from dynmap_cli.domain.grid import FREE, OCCUPIED, CountingMap, OccupancyGrid
from dynmap_cli.domain.patches import PatchSet
from dynmap_cli.errors import ArtifactError
from dynmap_cli.kernels.beam_likelihood import beam_log_likelihoods
from dynmap_cli.localization.sensing.map_pool import MapPool, slices_of
from dynmap_cli.localization.sensing.pose_chunks import weigh_in_chunks
from dynmap_cli.localization.sensing.sensor import Sweep, evenly
from dynmap_cli.localization.settings import LocalizationSettings

UNKNOWN_REFLECTANCE = 0.1
"""Of what nobody saw: a beam gets through a few such cells, not through a metre of them."""
PLAIN_REFLECTANCE = {OCCUPIED: 0.7, FREE: 0.005}
"""Of the cells of a map that does not say how often it reflects; medians of maps that do."""
MOST_REFLECTANCE = 0.99
"""No cell stops every beam: no pose is exact."""


def with_beam_model(
    pool: MapPool, grid: OccupancyGrid, counting_map: CountingMap | None, patch_sets: Sequence[PatchSet]
) -> MapPool:
    """The pool with reflectances, which it needs for `localization.sensor: beam`.

    Parameters
    ----------
    pool : MapPool
    grid : OccupancyGrid
        The map that the pool was made of.
    counting_map : CountingMap or None
        Its reflectance; none = taken from what is occupied and what is free.
    patch_sets : sequence of PatchSet
        Those that the pool was made of.
    """
    whole = np.full(pool.frame.shape, UNKNOWN_REFLECTANCE)
    if counting_map is None:
        for value, reflectance in PLAIN_REFLECTANCE.items():
            whole[slices_of(grid.frame, pool.frame)][grid.cells == value] = reflectance
    else:
        if counting_map.frame.shape != grid.frame.shape:
            msg = (
                f"map/reflectance.npz has {counting_map.frame.shape} cells, but map/map.pgm {grid.frame.shape}. "
                "Run `dynmap map` again with --force."
            )
            raise ArtifactError(msg)
        m = counting_map.reflectance
        whole[slices_of(counting_map.frame, pool.frame)] = np.where(np.isfinite(m), m, UNKNOWN_REFLECTANCE)
    fields = [log_pass_of(whole).ravel()]
    for patch_set in (each for each in patch_sets if each.patches):
        states = np.stack([patch.reflectance for patch in patch_set.patches]).astype(np.float64)
        fields.append(log_pass_of(_filled(states, whole[slices_of(patch_set.frame, pool.frame)])).ravel())
    result = replace(pool, log_pass=np.concatenate(fields))
    for number, submap in enumerate(result.submaps):
        result.paint(number, np.full(submap.n_states, 1.0 / submap.n_states))
    return result


def log_pass_of(reflectance: F64) -> F32:
    """ln(1 - m)."""
    return np.log1p(-np.minimum(reflectance, MOST_REFLECTANCE)).astype(np.float32)


def beams_of(sweep: Sweep, max_beams: int) -> Sweep:
    """At most *max_beams* beams of a scan, evenly spread; also those that hit nothing."""
    if sweep.ranges_m.size <= max_beams:
        return sweep
    beams = evenly(sweep.ranges_m.size, max_beams)
    return replace(sweep, directions_rad=sweep.directions_rad[beams], ranges_m=sweep.ranges_m[beams])


def scan_beam_log_likelihoods(
    pool: MapPool,
    poses: F64,
    sweep: Sweep,
    settings: LocalizationSettings,
    windows: I32 | None = None,
    executor: ThreadPoolExecutor | None = None,
) -> F64:
    """Logarithm of the likelihood of a scan under Eq. 1.1 for each pose.

    Beams that hit nothing say that the way is free as far as the sensor reaches.

    Parameters
    ----------
    pool : MapPool
        From `with_beam_model`.
    poses : (n_poses, 3) float64
        map_from_robot.
    sweep : Sweep
    settings : LocalizationSettings
    windows : (n_poses, 5) int32, optional
        The patch each pose reads from; none = all read from the map.
    executor : ThreadPoolExecutor, optional
        Shares long lists of poses among threads.

    Returns
    -------
    (n_poses,) float64
    """
    if pool.log_pass is None:
        msg = "the pool has no reflectances; with_beam_model adds them"
        raise ValueError(msg)
    frame, log_pass = pool.frame, pool.log_pass
    hits = np.isfinite(sweep.ranges_m)
    lengths = np.where(hits, sweep.ranges_m, sweep.reach_m) / frame.resolution_m
    directions = np.stack([np.cos(sweep.directions_rad), np.sin(sweep.directions_rad)])
    floor = settings.z_rand / settings.laser_max_range
    model = np.array([settings.z_hit, floor, settings.static_prior, np.log(1.0 - UNKNOWN_REFLECTANCE)])

    def weigh(some: F64, their_windows: I32, out: F64) -> None:
        beam_log_likelihoods(
            log_pass, frame.rows, frame.cols, frame.corner, some, sweep.sensor, directions, lengths, hits,
            their_windows, model, out,
        )  # fmt: skip

    return weigh_in_chunks(weigh, poses, windows, executor)


def _filled(states: F64, whole: F64) -> F64:
    """What a state (n_states, rows, cols) does not know is the mean of the others, or what the map says."""
    known = np.isfinite(states)
    count = known.sum(axis=0)
    mean = np.where(known, states, 0.0).sum(axis=0) / np.maximum(count, 1)
    return np.asarray(np.where(known, states, np.where(count > 0, mean, whole)))
