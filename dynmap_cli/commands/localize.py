"""`dynmap localize`: pose and state of the world over time, for a recording in the maps of a run."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import click

from dynmap_cli.commands.options import (
    PATH,
    Function,
    Shared,
    print_summary,
    recording_options,
    shared_options,
    three_numbers,
)


def _start_option(function: Function) -> Function:
    """Add --start, which stands for the setting `localization.start`."""

    @click.option(
        "--start",
        metavar="X,Y,YAW",
        help="Pose at the first scan, metres and radians (default: found on its own).",
    )
    @functools.wraps(function)
    def wrapper(*args: Any, start: str | None, settings: dict[str, Any], **kwargs: Any) -> None:
        pose = None if start is None else three_numbers("--start", start)
        function(*args, settings={**settings, "localization.start": pose}, **kwargs)

    return wrapper


@click.command("localize")
@click.argument("paths", metavar="[RUN] LOG...", nargs=-1, required=True, type=PATH)
@click.option("-o", "--output", "out_dir", metavar="OUT", type=PATH, help="Default: RUN/localization/NAME.")
@click.option(
    "--map",
    "map_yaml",
    metavar="MAP",
    type=PATH,
    help="Localize in this map_server map (its YAML), or in CMU's wean.dat, without RUN.",
)
@click.option(
    "--force", is_flag=True, help="Run also when up to date, and replace results of other recordings."
)
@recording_options
@_start_option
@shared_options
def command(
    paths: tuple[Path, ...], out_dir: Path | None, map_yaml: Path | None, force: bool, shared: Shared
) -> None:
    """Track pose and state of the world through LOG, in the maps of RUN or in --map."""
    from dynmap_cli.finished import localize

    run_dir = None if map_yaml else paths[0]
    recordings = paths if map_yaml else paths[1:]
    if not recordings:
        msg = "give RUN and a recording: dynmap localize RUN LOG"
        raise click.UsageError(msg)
    if out_dir is None:
        if run_dir is None:
            msg = "--map needs --output OUT"
            raise click.UsageError(msg)
        out_dir = run_dir / "localization" / recordings[0].name.split(".")[0]
    results = localize(
        run_dir, recordings, out_dir, shared.config, threads=shared.threads, force=force, map_yaml=map_yaml
    )
    summary = {result.stage: result.manifest.summary for result in results}
    lines = [
        f"{result.stage}: {line}" for result in results for line in result.manifest.summary.get("lines", ())
    ]
    lines += [f"trajectory  {out_dir / 'trajectory.tum'}", f"states      {out_dir / 'states.csv'}"]
    lines += [f"health      {out_dir / 'health.csv'}"]
    print_summary({"output": str(out_dir), "stages": summary}, lines, as_json=shared.as_json)
