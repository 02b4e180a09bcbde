"""`dynmap segment`: map -> submaps."""

from __future__ import annotations

from pathlib import Path

import click

from dynmap_cli.commands.options import PATH, Shared, run_single_stage, shared_options


@click.command("segment", short_help="Find the areas that change (stage 3 of build).")
@click.argument("run_dir", metavar="RUN", type=PATH)
@click.option("--force", is_flag=True, help="Run also when up to date.")
@shared_options
def command(run_dir: Path, force: bool, shared: Shared) -> None:
    """Find the areas that change (third stage of build)."""
    run_single_stage("segment", run_dir, shared, force=force)
