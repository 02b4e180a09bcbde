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
    output_option,
    print_summary,
    recording_options,
    shared_options,
    start_option,
)
from dynmap_cli.commands.order import check_no_run, check_order
from dynmap_cli.commands.piped import LogPath


def _smooth_option(function: Function) -> Function:
    """Add --smooth, which stands for the setting `localization.smooth`."""

    @click.option(
        "--smooth",
        is_flag=True,
        help="Look back as well: poses and states that know the whole recording, in OUT/smoothed/.",
    )
    @functools.wraps(function)
    def wrapper(*args: Any, smooth: bool, settings: dict[str, Any], **kwargs: Any) -> None:
        function(*args, settings={**settings, "localization.smooth": smooth or None}, **kwargs)

    return wrapper


@click.command("localize", short_help="Find the robot of LOG in the map of RUN.")
@click.argument("paths", metavar="[RUN] LOG...", nargs=-1, required=True, type=LogPath())
@output_option("localization")
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
@_smooth_option
@start_option
@shared_options
def command(
    paths: tuple[Path, ...], out_dir: Path | None, map_yaml: Path | None, force: bool, shared: Shared
) -> None:
    """Track pose and state of the world through LOG, in the maps of RUN or in --map.

    Exit code 0 says that all results are written, not that they can be trusted: with --json,
    `stages.localize.another_place` is true if LOG was not made in the place of the map; `tracking`, `changed` and
    `lost` beside it are shares of its updates.
    """
    from dynmap_cli.runs.finished import localize
    from dynmap_cli.runs.outdated import outdated_results

    run_dir = None if map_yaml else paths[0]
    recordings = paths if map_yaml else paths[1:]
    if not recordings:
        msg = "give RUN and a recording: dynmap localize RUN LOG"
        raise click.UsageError(msg)
    if run_dir is None:
        check_no_run(recordings)
    else:
        check_order(run_dir, recordings)
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
    lines += [f"trajectory  {out_dir / 'trajectory.tum'}", f"poses       {out_dir / 'poses.csv'}"]
    if map_yaml is None:
        lines += [f"states      {out_dir / 'states.csv'}", f"objects     {out_dir / 'objects.csv'}"]
    lines += [f"health      {out_dir / 'health.csv'}"]
    if shared.config.localization.smooth:
        lines += [f"smoothed    {out_dir / 'smoothed'}/"]
    picture = out_dir / "localization.png"
    lines += [f"picture     {picture}"]
    outdated = outdated_results(run_dir) if run_dir else []
    print_summary(
        {"output": str(out_dir), "picture": str(picture), "stages": summary, "outdated": outdated},
        [*lines, *outdated],
        as_json=shared.as_json,
    )
