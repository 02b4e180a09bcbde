"""`dynmap update`: more recordings for a run."""

from __future__ import annotations

import os
from pathlib import Path

import click

from dynmap_cli.commands.options import PATH, print_results, reading_options, threads_option
from dynmap_cli.commands.order import check_order
from dynmap_cli.commands.piped import LogPath


@click.command("update", short_help="Add LOG to the map of RUN.")
@click.argument("run_dir", metavar="RUN", type=PATH)
@click.argument("recordings", metavar="LOG...", nargs=-1, required=True, type=LogPath())
@threads_option
@reading_options
def command(run_dir: Path, recordings: tuple[Path, ...], threads: int, as_json: bool) -> None:
    """Add LOG to RUN: sub-maps and states keep their numbers, their counts grow, new ones are added.

    Recordings that are in RUN are not read again, and its settings stay. A LOG that does not fit is refused, and RUN
    stays as it is.
    """
    from dynmap_cli.runs.update import update

    check_order(run_dir, recordings)
    results = update(run_dir, recordings, threads=threads or os.cpu_count() or 1)
    print_results(run_dir, results, as_json=as_json)
