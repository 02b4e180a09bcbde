"""The door of the room: a run and its recordings -> a clean recording."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dynmap_cli.arrays import B1, F32
from dynmap_cli.domain.mapped import copied_rows, give_back
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.errors import ArtifactError
from dynmap_cli.export.labels import DYNAMIC_BELOW, LABEL_SUFFIX, BeamLabels, hits_known_state
from dynmap_cli.files.counting_map import read_beams, read_unknown
from dynmap_cli.files.manifest import read_manifest
from dynmap_cli.files.patch_archive import read_patches
from dynmap_cli.files.scan_log import read_scan_log
from dynmap_cli.files.space import nearest_folder
from dynmap_cli.files.tables import new_table
from dynmap_cli.files.trajectory import read_tum
from dynmap_cli.given import check_apart
from dynmap_cli.ingest.settings import IngestSettings

if TYPE_CHECKING:
    from dynmap_cli.export.cleaning import Cleaned

_SCANS_AT_ONCE = 1024


def check_output(out_path: Path, recordings: Sequence[Path], *, force: bool) -> None:
    """Refuse an output that other tools would not know as MCAP, or that would replace something."""
    if out_path.suffix != ".mcap":
        msg = f"{out_path}: what is written is an MCAP file; its name must end in .mcap"
        raise ArtifactError(msg)
    check_apart(out_path, recordings)
    if out_path.exists() and not force:
        msg = f"{out_path}: exists already. Pass --force to replace it, or choose another output."
        raise ArtifactError(msg)


def clean_to_file(
    run_dir: Path,
    recordings: Sequence[Path],
    out_path: Path,
    settings: IngestSettings,
    *,
    keep_changing: bool,
    is_label: bool,
) -> dict[str, Any]:
    """Write *recordings* without the beams that the run calls dynamic.

    Parameters
    ----------
    run_dir : Path
        A run of these recordings, done up to `map`, or up to `cluster` with *keep_changing*.
    recordings : sequence of Path
    out_path : Path
    settings : IngestSettings
    keep_changing : bool
        Keep beams that end on a known state of a sub-map: doors and boxes, however rarely they stood there.
    is_label : bool
        Leave the scans as they are and add the labels beside them.
    """
    from dynmap_cli.export.cleaning import write_clean
    from dynmap_cli.export.text_logs import TextChoices

    log = read_scan_log(run_dir / "scans")
    shape, beams = (log.n_scans, log.n_beams), run_dir / "map" / "beams.npz"
    folder = nearest_folder(out_path)
    static_probability = read_beams(beams, shape, folder)
    kept, is_kept = 0, None
    if keep_changing:
        is_kept = new_table(*shape, folder, np.bool_)
        kept = _keep_known_states(run_dir, log, static_probability, is_kept)
    ingested = read_manifest(run_dir / "scans", "ingest")
    text = TextChoices(
        str(ingested.summary.get("odometry", "")) if ingested else "", float(log.range_limits_m[:, 1].max())
    )
    labels = BeamLabels(log, static_probability, read_unknown(beams, shape, folder), is_kept)
    done = write_clean(recordings, out_path, labels, text=text, is_label=is_label, settings=settings)
    return {
        "scans": dict(done.scans),
        "beams": done.beams,
        "removed_beams": done.removed,
        "kept_on_changing_things": kept,
        "other_scans": dict(done.other_scans),
        "other_messages": done.other_messages,
        "losses": done.losses,
        "output": str(out_path),
        "lines": _lines(done, kept, out_path, is_label=is_label),
    }


def _keep_known_states(run_dir: Path, log: ScanLog, static_probability: F32, out: B1) -> int:
    """Write which removed beams end on a known state of a sub-map, and count them."""
    poses = read_tum(run_dir / "map" / "trajectory.tum").poses
    patch_sets = read_patches(run_dir / "patches" / "patches.zip")
    kept = 0
    for first in range(0, log.n_scans, _SCANS_AT_ONCE):
        rows = slice(first, first + _SCANS_AT_ONCE)
        is_removed = copied_rows(static_probability, rows) < DYNAMIC_BELOW
        on_state = hits_known_state(log.select(rows), poses[rows], is_removed, patch_sets)
        out[rows] = on_state
        kept += int(on_state.sum())
        for table in (out, log.ranges_m):
            give_back(table)
    return kept


def _lines(done: Cleaned, kept: int, out_path: Path, *, is_label: bool) -> list[str]:
    """What was written, as sentences."""
    what = "are called dynamic" if is_label else "are NaN now"
    scans = ", ".join(f"{count} scans on {topic}" for topic, count in sorted(done.scans.items()))
    lines = [
        f"{scans}: {done.removed} of {done.beams} beams with a return hit something that moves and {what}"
    ]
    if is_label:
        lines.append(f"labels are the intensities of the scans on TOPIC{LABEL_SUFFIX}")
    if kept:
        lines.append(f"{kept} beams that end on a known state of a sub-map were kept")
    if done.other_scans:
        others = ", ".join(f"{count} on {topic}" for topic, count in sorted(done.other_scans.items()))
        lines.append(f"scans that the map does not use, as they were: {others}")
    lines.append(f"{done.other_messages} other messages, as they were")
    return [*lines, *done.losses, f"recording  {out_path}"]
