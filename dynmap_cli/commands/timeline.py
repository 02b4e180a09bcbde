"""`dynmap timeline`: which state each sub-map was seen in, and when."""

from __future__ import annotations

from pathlib import Path

import click

from dynmap_cli.commands.options import PATH, print_summary, reading_options


@click.command("timeline", short_help="Say when each area of RUN was in which state.")
@click.argument("run_dir", metavar="RUN", type=PATH)
@click.option(
    "-o", "--output", "out_dir", metavar="OUT", type=PATH, help="Where to write (default: RUN/timeline)."
)
@reading_options
def command(run_dir: Path, out_dir: Path | None, as_json: bool) -> None:
    """Write the visits of all sub-maps of RUN as a table and a figure, and say how often states changed."""
    from dynmap_cli.runs.finished import write_timeline

    summary = write_timeline(run_dir, out_dir or run_dir / "timeline")
    lines = [*summary["lines"], f"table   {summary['table']}", f"figure  {summary['figure']}"]
    print_summary(summary, lines, as_json=as_json)
