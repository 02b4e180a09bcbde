"""The door of the room: maps and a recording -> trajectory.tum, states.csv, health.csv."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dynmap_cli.domain.grid import OccupancyGrid
from dynmap_cli.domain.patches import PatchSet
from dynmap_cli.errors import ConfigError
from dynmap_cli.files.pgm import read_map
from dynmap_cli.files.scan_log import read_scan_log
from dynmap_cli.files.trajectory import format_stamp, write_tum
from dynmap_cli.localization.map_pool import MapPool, make_map_pool
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.localization.tracking import HealthRow, Localization, StateRow, localize_log
from dynmap_cli.progress import progress
from dynmap_cli.stage import Stage, StageContext

STATES_HEADER = "stamp_s,submap,patch,probability"
HEALTH_HEADER = (
    "stamp_s,explained,explained_by_other_state,unexplained,log_likelihood_per_beam,"
    "effective_particles,patch_entropy_bits,verdict"
)
VERDICTS = ("tracking", "changed", "lost")
SURE = 0.8
"""A state counts as seen when its probability reaches this."""
_MUCH_LOST = 0.2
START_MARGIN_M = 5.0
"""A robot may start where its map has no cells, but not far from them."""


def run(context: StageContext) -> dict[str, Any]:
    """Read the maps and the scans, localize, write."""
    settings = context.config.localization
    log = read_scan_log(context.scans_dir)
    grid, warnings = read_map(context.map_yaml or context.run_dir / "map" / "map.yaml")
    _check_start(settings, grid)
    pool = make_map_pool(grid, _patch_sets(context), settings)
    with progress("localize", log.n_scans, "scans") as tick:
        found = localize_log(
            log, pool, settings, seed=context.config.seed, threads=context.threads, tick=tick
        )
    write_tum(context.out_dir / "trajectory.tum", found.trajectory)
    write_states(context.out_dir / "states.csv", found.states, pool)
    write_health(context.out_dir / "health.csv", found.health)
    if settings.save_particles:
        write_particles(context.out_dir / "particles.npz", found)
    summary = summarize(found, pool)
    warnings += [*found.warnings, *_warn_of_losses(summary["lost"])]
    summary["lines"] += [f"warning: {sentence}" for sentence in warnings]
    return summary


def _warn_of_losses(lost_share: float) -> list[str]:
    """A robot that is lost for much of a recording is probably somewhere else."""
    if lost_share <= _MUCH_LOST:
        return []
    return [
        f"lost for {100 * lost_share:.0f} % of the recording: it probably shows another place than the map, or one "
        "that changed a lot; do not trust states and poses"
    ]


def _check_start(settings: LocalizationSettings, grid: OccupancyGrid) -> None:
    """Refuse a start pose that no robot in this map can have."""
    if settings.start is None:
        return
    frame = grid.frame
    x_m, y_m, _ = settings.start
    left_m, low_m = frame.origin_x_m, frame.origin_y_m
    rows, columns = grid.frame.shape
    right_m = left_m + columns * frame.resolution_m
    high_m = low_m + rows * frame.resolution_m
    if (
        left_m - START_MARGIN_M <= x_m <= right_m + START_MARGIN_M
        and low_m - START_MARGIN_M <= y_m <= high_m + START_MARGIN_M
    ):
        return
    msg = (
        f"localization.start {x_m:g}, {y_m:g}: outside the map, which reaches from x = {left_m:.1f} to {right_m:.1f} m "
        f"and from y = {low_m:.1f} to {high_m:.1f} m (at most {START_MARGIN_M:g} m beyond). "
        "Give --start in the frame of the map, or leave it out to have the robot found."
    )
    raise ConfigError(msg)


def write_states(path: Path, rows: Sequence[StateRow], pool: MapPool) -> None:
    """Write one line per scan, sub-map in view and state."""
    lines = [STATES_HEADER]
    for row in rows:
        submap = pool.submaps[row.submap]
        for patch_id, probability in zip(submap.patch_ids, row.belief.tolist(), strict=True):
            lines.append(f"{format_stamp(row.stamp_ns)},{submap.submap_id},{patch_id},{probability:.6f}")
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def write_health(path: Path, rows: Sequence[HealthRow]) -> None:
    """Write one line per update."""
    lines = [HEALTH_HEADER]
    for row in rows:
        health = row.health
        lines.append(
            f"{format_stamp(row.stamp_ns)},{health.explained:.4f},{health.explained_by_other_state:.4f},"
            f"{health.unexplained:.4f},{row.log_likelihood_per_beam:.4f},{row.effective_particles:.1f},"
            f"{row.patch_entropy_bits:.4f},{row.verdict}"
        )
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def write_particles(path: Path, found: Localization) -> None:
    """Write the clouds of all updates, one after another.

    `stamps_ns (n_updates,)`, `counts (n_updates,)`, and for all particles `poses (n, 3)` float32,
    `weights (n,)` float32, `submaps (n,)` and `states (n,)` int16 (-1 = none).
    """
    clouds = [cloud for _, cloud in found.clouds]
    np.savez_compressed(
        path,
        stamps_ns=np.array([stamp for stamp, _ in found.clouds], dtype=np.int64),
        counts=np.array([cloud.count for cloud in clouds], dtype=np.int64),
        poses=np.concatenate([np.empty((0, 3)), *(cloud.poses for cloud in clouds)]).astype(np.float32),
        weights=np.concatenate([np.empty(0), *(cloud.weights for cloud in clouds)]).astype(np.float32),
        submaps=np.concatenate([np.empty(0), *(cloud.submaps for cloud in clouds)]).astype(np.int16),
        states=np.concatenate([np.empty(0), *(cloud.states for cloud in clouds)]).astype(np.int16),
    )


def summarize(found: Localization, pool: MapPool) -> dict[str, Any]:
    """What was found, as numbers and as sentences."""
    verdicts = Counter(row.verdict for row in found.health)
    n_updates = max(len(found.health), 1)
    n_scans = int(found.trajectory.stamps_ns.size)
    shares = {verdict: verdicts[verdict] / n_updates for verdict in VERDICTS}
    words = [f"{100 * shares['tracking']:.0f} % tracking"]
    if verdicts["changed"]:
        words.append(f"{100 * shares['changed']:.0f} % in changed surroundings")
    words.append(f"{100 * shares['lost']:.0f} % lost" if verdicts["lost"] else "never lost")
    if found.searches:
        times = "once" if len(found.searches) == 1 else f"{len(found.searches)} times"
        words.append(f"searched for in the whole map {times}")
    first_ns = int(found.trajectory.stamps_ns[0]) if n_scans else 0
    lines = [f"{n_scans} scans: {', '.join(words)}"]
    lines += [
        f"sub-map {pool.submaps[number].submap_id}: {history}"
        for number in range(len(pool.submaps))
        if (history := _history([row for row in found.states if row.submap == number], pool, first_ns))
    ]
    return {
        "scans": n_scans,
        "updates": len(found.health),
        "path_m": round(found.trajectory.length_m(), 3),
        **{verdict: round(share, 4) for verdict, share in shares.items()},
        "searches": len(found.searches),
        "submaps_seen": len({row.submap for row in found.states}),
        "lines": lines,
    }


def _history(rows: Sequence[StateRow], pool: MapPool, first_ns: int) -> str:
    """States of one sub-map in the order in which they were believed, with the times of the changes."""
    words: list[str] = []
    current = None
    for row in rows:
        state = int(np.argmax(row.belief))
        if state == current or row.belief[state] < SURE:
            continue
        patch_id = pool.submaps[row.submap].patch_ids[state]
        if current is None:
            words.append(f"state {patch_id}")
        else:
            words.append(f"-> {patch_id}, seen from t = {(row.stamp_ns - first_ns) * 1e-9:.1f} s")
        current = state
    if current is None:
        return "seen, its state stayed open" if rows else ""
    return " ".join(words) + f" ({rows[-1].belief.max():.2f})"


def _patch_sets(context: StageContext) -> tuple[PatchSet, ...]:
    """The patch map of the run; a plain map_server map has none."""
    if context.map_yaml is not None:
        return ()
    from dynmap_cli.files.patch_archive import read_patches

    return read_patches(context.run_dir / "patches" / "patches.zip")


STAGE = Stage(
    name="localize",
    title="localizing",
    section="localization",
    folder="",
    reads=("scans/", "map/", "patches/"),
    writes=("trajectory.tum", "states.csv", "health.csv"),
    run=run,
    seeded=True,
)
