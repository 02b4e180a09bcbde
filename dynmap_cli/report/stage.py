"""The door of the room."""

from __future__ import annotations

from typing import Any

from dynmap_cli.stage import Stage, StageContext


def run(context: StageContext) -> dict[str, Any]:
    """Read, draw, write."""
    raise NotImplementedError(context)


STAGE = Stage(
    name="report",
    title="drawing the report",
    section="report",
    folder="",
    reads=("scans/", "map/", "submaps/", "patches/"),
    writes=("report.html", "figures/"),
    run=run,
)
