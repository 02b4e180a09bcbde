"""The door of the room."""

from __future__ import annotations

from typing import Any

from dynmap_cli.stage import Stage, StageContext


def run(context: StageContext) -> dict[str, Any]:
    """Read, call, write."""
    raise NotImplementedError(context)


STAGE = Stage(
    name="map",
    title="finding path, map and moving beams",
    section="map",
    folder="map",
    reads=("scans/",),
    writes=(
        "map/map.pgm",
        "map/map.yaml",
        "map/reflectance.npz",
        "map/trajectory.tum",
        "map/beams.npz",
        "map/em.csv",
    ),
    run=run,
)
