"""The door of the room."""

from __future__ import annotations

from typing import Any

from dynmap_cli.stage import Stage, StageContext


def run(context: StageContext) -> dict[str, Any]:
    """Read, call, write."""
    raise NotImplementedError(context)


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
