"""`dynmap build`: from recordings to a patch map."""

from __future__ import annotations

from pathlib import Path

import click

from dynmap_cli.commands.options import PATH, Shared, print_results, recording_options, shared_options
from dynmap_cli.commands.piped import LogPath

STAGE_NAMES = ("ingest", "map", "segment", "cluster", "report")


@click.command("build", short_help="Make a map from LOG: all stages and the report.")
@click.argument("recordings", metavar="LOG...", nargs=-1, required=True, type=LogPath())
@click.option("-o", "--output", "run_dir", metavar="RUN", required=True, type=PATH, help="The run directory.")
@click.option("--force", is_flag=True, help="Run every stage, and replace a RUN of other recordings.")
@click.option(
    "--from", "force_from", type=click.Choice(STAGE_NAMES), help="Run this stage and all later ones."
)
@recording_options
@shared_options
def command(
    recordings: tuple[Path, ...], run_dir: Path, force: bool, force_from: str | None, shared: Shared
) -> None:
    """Read LOG, find path, map and moving beams, the areas that change and the states they take.

    Several LOG become one map. What is up to date is not done again. RUN/report.html shows what was found.
    """
    from dynmap_cli.runs.pipeline import build

    results = build(
        run_dir,
        recordings,
        shared.config,
        threads=shared.threads,
        force=force,
        force_from=force_from,
    )
    print_results(run_dir, results, as_json=shared.as_json)
