"""The door of the room."""

from __future__ import annotations

from typing import Any

from dynmap_cli.files.scan_log import SCAN_FILES, write_scan_log
from dynmap_cli.stage import Stage, StageContext


def run(context: StageContext) -> dict[str, Any]:
    """Read the recordings, write the columns of their scans."""
    from dynmap_cli.ingest.reading import read_recordings

    log, report = read_recordings(context.recordings, context.config.ingest)
    write_scan_log(context.out_dir, log)
    return report.summary()


STAGE = Stage(
    name="ingest",
    title="reading the recording",
    section="ingest",
    folder="scans",
    reads=(),
    writes=SCAN_FILES,
    run=run,
)
