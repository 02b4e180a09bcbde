"""`dynmap map`: scans -> map."""

from __future__ import annotations

from pathlib import Path

import click

from dynmap_cli.commands.options import PATH, Shared, run_single_stage, shared_options


@click.command("map", short_help="Find path, map and moving beams (stage 2 of build).")
@click.argument("run_dir", metavar="RUN", type=PATH)
@click.option("--force", is_flag=True, help="Run also when up to date.")
@shared_options
def command(run_dir: Path, force: bool, shared: Shared) -> None:
    """Find path, map and moving beams (second stage of build)."""
    run_single_stage("map", run_dir, shared, force=force)
