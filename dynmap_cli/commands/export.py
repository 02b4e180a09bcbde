"""`dynmap export`: a plain map for planners, with every area that changes in a chosen state."""

from __future__ import annotations

from pathlib import Path

import click

from dynmap_cli.commands.options import PATH, print_summary, reading_options


@click.command("export", short_help="Write a map for planners, in a chosen state.")
@click.argument("run_dir", metavar="RUN", type=PATH)
@click.option(
    "--state",
    metavar="STATE",
    default="latest",
    show_default=True,
    help="latest, most-likely, open (free where any state is), union (occupied where any state is), or at=TIME "
    "(seconds since the epoch, or ISO 8601 in UTC).",
)
@click.option("-o", "--output", "out_dir", metavar="DIR", required=True, type=PATH, help="Where to write.")
@click.option("--force", is_flag=True, help="Replace an exported map that is there.")
@reading_options
def command(run_dir: Path, state: str, out_dir: Path, force: bool, as_json: bool) -> None:
    """Write map.yaml with a state of each sub-map of RUN painted in, and mask.yaml of all sub-maps.

    Both are maps for map_server: the first for planners, the second for the costmap filters of nav2.
    """
    from dynmap_cli.planner.choice import parse_rule
    from dynmap_cli.runs.finished import export_map

    try:
        rule = parse_rule(state)
    except ValueError as err:
        msg = f"--state {state}: {err}"
        raise click.UsageError(msg) from err
    summary = export_map(run_dir, out_dir, rule, force=force)
    lines = [*summary["lines"], f"map   {summary['map']}", f"mask  {summary['mask']}"]
    print_summary(summary, lines, as_json=as_json)
