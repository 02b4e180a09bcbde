"""The door of the room."""

from __future__ import annotations

from typing import Any

from dynmap_cli.stage import Stage, StageContext


def run(context: StageContext) -> dict[str, Any]:
    """Read, call, write."""
    raise NotImplementedError(context)


STAGE = Stage(
    name="segment",
    title="finding areas that change",
    section="segmentation",
    folder="submaps",
    reads=("scans/", "map/"),
    writes=("submaps/",),
    run=run,
)
