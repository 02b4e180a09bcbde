"""`dynmap ingest`: recordings -> scans/."""

from __future__ import annotations

from pathlib import Path

import click

from dynmap_cli.commands.options import PATH, Shared, print_summary, recording_options, shared_options
from dynmap_cli.commands.piped import LogPath


@click.command("ingest", short_help="Read LOG into columns of scans (stage 1 of build).")
@click.argument("recordings", metavar="LOG...", nargs=-1, required=True, type=LogPath())
@click.option("-o", "--output", "run_dir", metavar="RUN", required=True, type=PATH, help="The run directory.")
@click.option(
    "--force", is_flag=True, help="Run also when up to date, and replace scans of other recordings."
)
@recording_options
@shared_options
def command(recordings: tuple[Path, ...], run_dir: Path, force: bool, shared: Shared) -> None:
    """Read LOG into columns of scans (first stage of build)."""
    from dynmap_cli.runs.pipeline import run_one

    result = run_one(
        run_dir, "ingest", shared.config, threads=shared.threads, force=force, recordings=recordings
    )
    print_summary(result.manifest.summary, result.manifest.summary.get("lines", []), as_json=shared.as_json)
