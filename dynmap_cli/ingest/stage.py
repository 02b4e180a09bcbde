"""The door of the room."""

from __future__ import annotations

from typing import Any

from dynmap_cli.files.scan_log import SCAN_FILES
from dynmap_cli.stage import Stage, StageContext


def run(context: StageContext) -> dict[str, Any]:
    """Read, call, write."""
    raise NotImplementedError(context)


STAGE = Stage(
    name="ingest",
    title="reading the recording",
    section="ingest",
    folder="scans",
    reads=(),
    writes=SCAN_FILES,
    run=run,
)
