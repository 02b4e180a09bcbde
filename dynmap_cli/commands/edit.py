"""`dynmap edit`: corrections by hand that last."""

from __future__ import annotations

import os
import re
from pathlib import Path

import click

from dynmap_cli.commands.options import PATH, print_results, print_summary, reading_options, threads_option

NUMBER = click.IntRange(min=0)


@click.command("edit", short_help="Correct sub-maps and states of RUN by hand.")
@click.argument("run_dir", metavar="RUN", type=PATH)
@click.option(
    "--merge",
    "merges",
    multiple=True,
    metavar="ID:STATE,STATE",
    help="These states of sub-map ID are one.",
)
@click.option(
    "--drop",
    "drops",
    multiple=True,
    type=NUMBER,
    metavar="ID",
    help="Sub-map ID is no area that changes: leave it out.",
)
@click.option(
    "--name", "names", multiple=True, type=(NUMBER, str), metavar="ID NAME", help="What sub-map ID is called."
)
@click.option(
    "--polygon",
    "polygons",
    multiple=True,
    type=(click.Choice(["add"]), PATH),
    metavar="add FILE",
    help="A sub-map of its own: FILE has a corner per line, `x,y` in metres in the map frame.",
)
@click.option("--undo", type=click.IntRange(min=1), metavar="N", help="Take correction N of --list back.")
@click.option("--list", "only_list", is_flag=True, help="Only say which corrections there are.")
@threads_option
@reading_options
def command(
    run_dir: Path,
    merges: tuple[str, ...],
    drops: tuple[int, ...],
    names: tuple[tuple[int, str], ...],
    polygons: tuple[tuple[str, Path], ...],
    undo: int | None,
    only_list: bool,
    threads: int,
    as_json: bool,
) -> None:
    """Correct sub-maps and states of RUN; later runs and updates of RUN keep to it.

    `dynmap timeline RUN` lists the IDs of sub-maps and their states. Corrections are written to RUN/edits.yaml, and
    the stages that depend on them are run. Options may be repeated; they are taken up in the order undo, polygon,
    merge, name, drop.
    """
    from dynmap_cli.runs.edit import Wishes, corrections_of, edit, list_lines

    wishes = Wishes(undo, tuple(path for _, path in polygons), tuple(map(_merge, merges)), names, drops)
    if only_list:
        if wishes != Wishes():
            msg = "--list changes nothing; leave it out, or the corrections"
            raise click.UsageError(msg)
        lines = list_lines(corrections_of(run_dir))
        print_summary({"run": str(run_dir), "corrections": lines}, lines, as_json=as_json)
        return
    _, results = edit(run_dir, wishes, threads=threads or os.cpu_count() or 1)
    print_results(run_dir, results, as_json=as_json)


def _merge(text: str) -> tuple[int, tuple[int, ...]]:
    """Read SUBMAP:STATE,STATE,..."""
    if not re.fullmatch(r"[0-9]{1,9}:[0-9]{1,9}(,[0-9]{1,9})+", text):
        msg = f"--merge {text}: expected ID:STATE,STATE, for instance 3:0,2"
        raise click.UsageError(msg)
    submap, _, states = text.partition(":")
    return int(submap), tuple(int(state) for state in states.split(","))
