"""The floor plan: the stages, in order, and whose files each of them reads."""

from __future__ import annotations

from dynmap_cli.clustering.stage import STAGE as CLUSTER
from dynmap_cli.ingest.stage import STAGE as INGEST
from dynmap_cli.mapping.stage import STAGE as MAP
from dynmap_cli.report.stage import STAGE as REPORT
from dynmap_cli.segmentation.stage import STAGE as SEGMENT
from dynmap_cli.stage import Stage

STAGES = (INGEST, MAP, SEGMENT, CLUSTER, REPORT)
"""What `dynmap build` runs, in this order; each reads only what earlier ones wrote."""
STAGE_PLACES = tuple((stage.folder, stage.name) for stage in STAGES)
"""Folder and name of each, as `finish_swap` wants them."""


def read_by(stage: Stage) -> list[Stage]:
    """The earlier stages whose files a stage reads."""
    return [
        earlier
        for earlier in STAGES
        if earlier.folder and any(path.startswith(f"{earlier.folder}/") for path in stage.reads)
    ]
