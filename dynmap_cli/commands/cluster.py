"""`dynmap cluster`: submaps -> patches."""

from __future__ import annotations

from pathlib import Path

import click

from dynmap_cli.commands.options import PATH, Shared, run_single_stage, shared_options


@click.command("cluster", short_help="Learn the states of each area (stage 4 of build).")
@click.argument("run_dir", metavar="RUN", type=PATH)
@click.option("--force", is_flag=True, help="Run also when up to date.")
@shared_options
def command(run_dir: Path, force: bool, shared: Shared) -> None:
    """Learn the states of each area (fourth stage of build)."""
    run_single_stage("cluster", run_dir, shared, force=force)
