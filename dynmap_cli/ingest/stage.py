"""The door of the room: recordings -> the columns of their scans."""

from __future__ import annotations

from typing import Any

from dynmap_cli.files.manifest import read_manifest
from dynmap_cli.files.scan_log import SCAN_FILES, read_scan_log, write_scan_log
from dynmap_cli.files.space import check_space
from dynmap_cli.stage import Stage, StageContext


def run(context: StageContext) -> dict[str, Any]:
    """Read the recordings, write the columns of their scans, after those that are there already."""
    from dynmap_cli.ingest.choices.merging import add_drives
    from dynmap_cli.ingest.reading import read_recordings

    log, report = read_recordings(context.recordings, context.config.ingest, context.out_dir)
    summary = report.summary()
    if context.earlier_scans is not None:
        earlier = read_scan_log(context.earlier_scans)
        n_scans = earlier.n_scans + log.n_scans
        # Once while they are joined, and once as columns.
        needed = 2 * 4 * n_scans * max(earlier.n_beams, log.n_beams)
        check_space("ingest", f"{n_scans} scans, with those of before,", needed, context.out_dir)
        log = add_drives(earlier, log, context.out_dir)
        said = read_manifest(context.earlier_scans, STAGE.name)
        summary["earlier_lines"] = (
            said.summary.get("earlier_lines", []) + said.summary["lines"] if said else []
        )
        summary["lines"].append(
            f"added to {earlier.n_scans} scans of {', '.join(earlier.recordings)}, which were not read again"
        )
    write_scan_log(context.out_dir, log)
    return summary


STAGE = Stage(
    name="ingest",
    title="reading the recording",
    section="ingest",
    folder="scans",
    reads=(),
    writes=SCAN_FILES,
    run=run,
    has_kernels=False,
)
