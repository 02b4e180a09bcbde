"""The door of the room: maps and a recording -> trajectory.tum, poses.csv, states.csv, objects.csv, health.csv."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dynmap_cli.domain.grid import FREE, OCCUPIED, CountingMap, GridFrame, OccupancyGrid
from dynmap_cli.domain.patches import PatchSet
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.errors import ConfigError
from dynmap_cli.files.areas_digest import KEY, areas_digest
from dynmap_cli.files.pgm import read_map
from dynmap_cli.files.registered import with_mountings_of
from dynmap_cli.files.scan_log import read_scan_log
from dynmap_cli.files.trajectory import write_tum
from dynmap_cli.localization.afterwards.smoothing import smooth
from dynmap_cli.localization.beliefs.parts import Part, believed_parts
from dynmap_cli.localization.beliefs.state_tables import object_beliefs, patch_beliefs
from dynmap_cli.localization.found import HealthRow
from dynmap_cli.localization.odometry import with_sound_odometry
from dynmap_cli.localization.outputs import (
    write_health,
    write_objects,
    write_particles,
    write_poses,
    write_states,
)
from dynmap_cli.localization.sensing.beam_model import with_beam_model
from dynmap_cli.localization.sensing.map_pool import make_map_pool
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.localization.starting.global_start import LEAST_RETURNS
from dynmap_cli.localization.summary import summarize
from dynmap_cli.localization.tracking import localize_log
from dynmap_cli.localization.watching.doubts import began_outside, doubts
from dynmap_cli.progress import progress
from dynmap_cli.stage import Stage, StageContext

_LONG_GAP_S = 5.0
"""A robot that stands weighs a scan every second."""
START_MARGIN_M = 5.0
"""A robot may start where its map has no cells, but not far from them."""


def run(context: StageContext) -> dict[str, Any]:
    """Read the maps and the scans, localize, write."""
    settings = context.config.localization
    log = read_scan_log(context.scans_dir)
    grid, warnings = read_map(context.map_yaml or context.run_dir / "map" / "map.yaml")
    _check_start(settings, grid)
    warnings += _warn_of_map(grid)
    patch_sets = _patch_sets(context)
    parts = _parts(context, patch_sets)
    pool = make_map_pool(grid, [part.states for part in parts], settings)
    if settings.sensor == "beam":
        pool = with_beam_model(pool, grid, _counting_map(context), [part.states for part in parts])
    log, mounted_words = _as_mounted(context, log)
    log, wheel_words = with_sound_odometry(log, settings)
    with progress("localize", log.n_scans, "scans") as tick:
        found = localize_log(
            log, pool, settings, seed=context.config.seed, threads=context.threads, tick=tick
        )
    write_tum(context.out_dir / "trajectory.tum", found.trajectory)
    write_poses(context.out_dir / "poses.csv", found.poses)
    believed = patch_beliefs(found.states, pool, parts, patch_sets)
    write_states(context.out_dir / "states.csv", believed)
    write_objects(context.out_dir / "objects.csv", object_beliefs(found.states, parts))
    write_health(context.out_dir / "health.csv", found.health)
    if settings.smooth:
        smoothed = smooth(log, pool, found, settings)
        folder = context.out_dir / "smoothed"
        folder.mkdir()
        write_tum(folder / "trajectory.tum", smoothed.trajectory)
        write_states(folder / "states.csv", patch_beliefs(smoothed.states, pool, parts, patch_sets))
        write_objects(folder / "objects.csv", object_beliefs(smoothed.states, parts))
        write_health(folder / "health.csv", found.health)
    if settings.save_particles:
        write_particles(context.out_dir / "particles.npz", found)
    summary = summarize(found, believed, _names(context))
    if context.map_yaml is None:
        summary[KEY] = areas_digest(context.run_dir / "patches" / "patches.zip")
    if mounted_words:
        summary["lines"].append(mounted_words)
    warnings += [*wheel_words, *found.warnings, *_warn_of_gaps(log, found.health, settings)]
    outside = began_outside(found.health, int(log.stamps_ns[0]))
    warnings += (
        [outside]
        if outside
        else doubts(
            found.health, found.alike, lost_share=summary["lost"], is_elsewhere=summary["another_place"]
        )
    )
    summary["lines"] += [f"warning: {sentence}" for sentence in warnings]
    return summary


def _warn_of_gaps(log: ScanLog, rows: Sequence[HealthRow], settings: LocalizationSettings) -> list[str]:
    """Where no scan was weighed for long, poses are those of the odometry, whatever the verdicts around say."""
    stamps = np.array([row.stamp_ns for row in rows], dtype=np.int64)
    made = np.diff(np.searchsorted(log.stamps_ns, stamps)) > 1
    gaps_s = np.where(made, np.diff(stamps) * 1e-9, 0.0)
    least_s = max(_LONG_GAP_S, 2.0 * settings.update_max_s)
    if not gaps_s.size or gaps_s.max() <= least_s:
        return []
    longest, n_gaps = int(np.argmax(gaps_s)), int((gaps_s > least_s).sum())
    first_s, last_s = ((stamps[k] - log.stamps_ns[0]) * 1e-9 for k in (longest, longest + 1))
    more = f", and {n_gaps - 1} times more for over {least_s:g} s" if n_gaps > 1 else ""
    return [
        f"no scan with enough returns from t = {first_s:.1f} to {last_s:.1f} s{more}: poses there are those of the "
        "odometry, and what changed was not seen"
    ]


def _warn_of_map(grid: OccupancyGrid) -> list[str]:
    """A map that shows hardly anything says nothing of where the robot is, and one that is mostly walls is none."""
    occupied, free = (int(np.count_nonzero(grid.cells == value)) for value in (OCCUPIED, FREE))
    if occupied > free > 0:
        return [
            f"the map has {occupied} occupied cells, more than the {free} free ones: check `negate` and the thresholds "
            "in its YAML"
        ]
    if occupied >= LEAST_RETURNS:
        return []
    cells = "cell" if occupied == 1 else "cells"
    return [
        f"the map has {occupied} occupied {cells}, too few to localize by: poses are those of the odometry from the "
        "start; check the image of the map and its thresholds"
    ]


def _check_start(settings: LocalizationSettings, grid: OccupancyGrid) -> None:
    """Refuse a start pose that no robot in this map can have."""
    if settings.start is None:
        return
    x_m, y_m, _ = settings.start
    if why := outside(grid.frame, x_m, y_m):
        msg = (
            f"localization.start {x_m:g}, {y_m:g}: {why}. "
            "Give --start in the frame of the map, or leave it out to have the robot found."
        )
        raise ConfigError(msg)


def outside(frame: GridFrame, x_m: float, y_m: float) -> str:
    """Say how far the map reaches if a robot at a place, in its frame, cannot be in it; "" if it can."""
    left_m, low_m = frame.origin_x_m, frame.origin_y_m
    rows, columns = frame.shape
    right_m = left_m + columns * frame.resolution_m
    high_m = low_m + rows * frame.resolution_m
    if (
        left_m - START_MARGIN_M <= x_m <= right_m + START_MARGIN_M
        and low_m - START_MARGIN_M <= y_m <= high_m + START_MARGIN_M
    ):
        return ""
    return (
        f"outside the map, which reaches from x = {left_m:.1f} to {right_m:.1f} m "
        f"and from y = {low_m:.1f} to {high_m:.1f} m (at most {START_MARGIN_M:g} m beyond)"
    )


def _patch_sets(context: StageContext) -> tuple[PatchSet, ...]:
    """The patch map of the run; a plain map_server map has none."""
    if context.map_yaml is not None:
        return ()
    from dynmap_cli.files.patch_archive import read_patches

    return read_patches(context.run_dir / "patches" / "patches.zip")


def _parts(context: StageContext, patch_sets: Sequence[PatchSet]) -> tuple[Part, ...]:
    """What has a belief of its own."""
    if not patch_sets:
        return ()
    from dynmap_cli.files.patch_archive import read_visits

    visits = read_visits(context.run_dir / "patches" / "patches.zip")
    return believed_parts(patch_sets, visits, context.config.localization.states)


def _as_mounted(context: StageContext, log: ScanLog) -> tuple[ScanLog, str]:
    """The recording with its lasers where the map of the run found them, and what to say of it."""
    if context.map_yaml is not None:
        return log, ""
    return with_mountings_of(log, context.run_dir / "scans", context.run_dir / "map")


def _counting_map(context: StageContext) -> CountingMap | None:
    """How often the cells of the run's map reflect; a plain map_server map does not say."""
    if context.map_yaml is not None:
        return None
    from dynmap_cli.files.counting_map import read_counting_map

    return read_counting_map(context.run_dir / "map" / "reflectance.npz")


def _names(context: StageContext) -> dict[int, str]:
    """What people call the sub-maps of the run."""
    if context.map_yaml is not None:
        return {}
    from dynmap_cli.files.patch_archive import read_names

    return read_names(context.run_dir / "patches" / "patches.zip")


STAGE = Stage(
    name="localize",
    title="localizing",
    section="localization",
    folder="",
    reads=("scans/", "map/", "patches/"),
    writes=("trajectory.tum", "poses.csv", "states.csv", "objects.csv", "health.csv"),
    run=run,
    seeded=True,
)
