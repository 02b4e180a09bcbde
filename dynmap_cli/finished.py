"""What is read from a finished run: a map for planners, the history of its sub-maps, why one of them is there."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from dynmap_cli.clustering.stage import STAGE as CLUSTER
from dynmap_cli.history import stage as history
from dynmap_cli.ingest.stage import STAGE as INGEST
from dynmap_cli.mapping.stage import STAGE as MAP
from dynmap_cli.pipeline import finished_run
from dynmap_cli.planner import stage as planner
from dynmap_cli.planner.choice import StateRule
from dynmap_cli.segmentation.stage import STAGE as SEGMENT


def export_map(run_dir: Path, out_dir: Path, rule: StateRule, *, force: bool) -> dict[str, Any]:
    """Write the map with each sub-map in the state of a rule, and the mask of all sub-maps."""
    with finished_run(run_dir, (MAP, SEGMENT, CLUSTER)):
        planner.check_output(out_dir, force=force)
        return planner.export_map(run_dir, out_dir, rule)


def write_timeline(run_dir: Path, out_dir: Path) -> dict[str, Any]:
    """Write which state each sub-map was seen in, and when."""
    with finished_run(run_dir, (SEGMENT, CLUSTER)):
        return history.write_timeline(run_dir, out_dir)


def explain(run_dir: Path, submap_id: int) -> dict[str, Any]:
    """Tell why an area is a sub-map, who saw what of it, and which states that makes."""
    with finished_run(run_dir, (INGEST, MAP, SEGMENT, CLUSTER)):
        return history.explain(run_dir, submap_id)
