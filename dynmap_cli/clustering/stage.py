"""The door of the room."""

from __future__ import annotations

from typing import Any

from dynmap_cli.stage import Stage, StageContext


def run(context: StageContext) -> dict[str, Any]:
    """Read, call, write."""
    raise NotImplementedError(context)


STAGE = Stage(
    name="cluster",
    title="learning the states of each area",
    section="clustering",
    folder="patches",
    reads=("scans/", "map/", "submaps/"),
    writes=("patches/patches.zip",),
    run=run,
)
