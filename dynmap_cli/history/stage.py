"""The door of the room: a finished run -> timeline.csv and timeline.png; what is known of one sub-map."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.errors import ArtifactError, ConfigError
from dynmap_cli.files.atomic import replacing
from dynmap_cli.files.damage import refusing_damage
from dynmap_cli.files.manifest import manifest_path, read_manifest
from dynmap_cli.files.patch_archive import read_patches, read_visits
from dynmap_cli.files.registered import TRAJECTORY, read_registered
from dynmap_cli.files.submaps import read_submaps
from dynmap_cli.files.trajectory import format_stamp, read_tum
from dynmap_cli.history.timeline import History, as_csv, describe, histories_of
from dynmap_cli.segmentation.settings import SegmentationSettings

TABLE_NAME, FIGURE_NAME = "timeline.csv", "timeline.png"


def write_timeline(run_dir: Path, out_dir: Path) -> dict[str, Any]:
    """Write the table of all visits and the figure of states over time; say what they show.

    Parameters
    ----------
    run_dir : Path
        A run that is done up to `cluster`.
    out_dir : Path
        Made if it is missing.
    """
    from dynmap_cli.report.curves import draw_visits

    submaps = read_submaps(run_dir / "submaps")
    archive = run_dir / "patches" / "patches.zip"
    visits = read_visits(archive)
    first_ns = int(read_tum(run_dir / "map" / TRAJECTORY).stamps_ns[0])
    stay = {patch_set.submap_id: patch_set.stay_probability for patch_set in read_patches(archive)}
    histories = histories_of(submaps, visits, stay)
    with replacing(out_dir / TABLE_NAME) as part:
        part.write_bytes(as_csv(visits))
    with replacing(out_dir / FIGURE_NAME) as part:
        part.write_bytes(draw_visits(visits, submaps, first_ns))
    lines = [describe(history, submap.place) for history, submap in zip(histories, submaps, strict=True)]
    return {
        "visits": len(visits),
        "submaps": [
            _summary(history, submap.name) for history, submap in zip(histories, submaps, strict=True)
        ],
        "table": str(out_dir / TABLE_NAME),
        "figure": str(out_dir / FIGURE_NAME),
        "lines": lines or ["no sub-map: nothing was seen in two states"],
    }


def explain(run_dir: Path, submap_id: int) -> dict[str, Any]:
    """Collect what is known of one sub-map; its evidence is counted again, as segmentation was run.

    Parameters
    ----------
    run_dir : Path
        A run that is done up to `cluster`, with its scans.
    submap_id : int
    """
    from dynmap_cli.history.evidence import evidence_of
    from dynmap_cli.history.explanation import explanation_of
    from dynmap_cli.segmentation.finding import evidence_params

    submap = _submap_of(run_dir, submap_id)
    archive = run_dir / "patches" / "patches.zip"
    visits = [visit for visit in read_visits(archive) if visit.submap_id == submap_id]
    patch_sets = {patch_set.submap_id: patch_set for patch_set in read_patches(archive)}
    settings, windows_needed = _segmentation_of(run_dir)
    log, trajectory = read_registered(run_dir / "scans", run_dir / "map")
    evidence = evidence_of(log, trajectory.poses, submap, settings.window_s, evidence_params(settings))
    found = explanation_of(submap, evidence, visits, patch_sets.get(submap_id))
    found["recordings"] = _recordings_of(log)
    found["evidence"].update(window_s=settings.window_s, windows_needed=windows_needed)
    return found


def _recordings_of(log: ScanLog) -> list[dict[str, str]]:
    """Names of the recordings and the stamps of their first scans, in time order."""
    indices, firsts = np.unique(log.recording_index, return_index=True)
    by_time = sorted(zip(firsts.tolist(), indices.tolist(), strict=True))
    return [
        {"name": log.recordings[index], "start_s": format_stamp(int(log.stamps_ns[first]))}
        for first, index in by_time
    ]


def _submap_of(run_dir: Path, submap_id: int) -> SubMap:
    """The sub-map of this number."""
    submaps = {submap.submap_id: submap for submap in read_submaps(run_dir / "submaps")}
    if submap_id not in submaps:
        there = f"there are {', '.join(map(str, submaps))}" if submaps else "nothing was seen in two states"
        msg = f"{run_dir}: no sub-map {submap_id}; {there}. `dynmap timeline {run_dir}` lists them."
        raise ConfigError(msg)
    return submaps[submap_id]


def _segmentation_of(run_dir: Path) -> tuple[SegmentationSettings, int]:
    """Settings with which segmentation was run, and in how many windows a cell had to be seen in either state."""
    folder = run_dir / "submaps"
    manifest = read_manifest(folder, "segment")
    remedy = "Run `dynmap segment` again with --force."
    with refusing_damage(
        f"{folder}: the manifest of 'segment' does not say how it was run", remedy, ArtifactError
    ):
        if manifest is None:
            raise FileNotFoundError(manifest_path(folder, "segment"))
        settings = SegmentationSettings.model_validate(manifest.settings)
        return settings, int(manifest.summary["windows_needed"])


def _summary(history: History, name: str) -> dict[str, Any]:
    """The same as numbers."""
    return {
        "submap": history.submap_id,
        "name": name or None,
        "visits": len(history.visits),
        "seen": {str(state): count for state, count in history.seen.items()},
        "open": history.open_visits,
        "transitions": [
            {"from": before, "to": after, "count": count}
            for (before, after), count in history.transitions.items()
        ],
        "stay_probability": history.stay_probability,
    }
