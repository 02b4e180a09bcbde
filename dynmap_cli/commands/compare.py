"""`dynmap compare`: one recording in the patch map, and in maps without it."""

from __future__ import annotations

from pathlib import Path

import click

from dynmap_cli.commands.options import (
    PATH,
    Shared,
    output_option,
    print_summary,
    recording_options,
    shared_options,
    start_option,
)
from dynmap_cli.commands.order import check_order
from dynmap_cli.commands.piped import LogPath

MOST_STATES = 20


@click.command("compare", short_help="Localize LOG with and without the states of RUN.")
@click.argument("run_dir", metavar="RUN", type=PATH)
@click.argument("recordings", metavar="LOG...", nargs=-1, required=True, type=LogPath())
@output_option("comparison")
@click.option("--truth", metavar="FILE.tum", type=PATH, help="True poses of LOG; errors are measured then.")
@click.option(
    "--map-truth",
    metavar="FILE.tum",
    type=PATH,
    help="True poses of the recording that RUN was made of, where those of LOG are not in the frame of the map.",
)
@click.option(
    "--states",
    "most_states",
    type=click.IntRange(0, MOST_STATES),
    default=3,
    show_default=True,
    help="Maps of one state at most; each costs one more localization.",
)
@click.option(
    "--force", is_flag=True, help="Run also when up to date, and replace results of other recordings."
)
@recording_options
@start_option
@shared_options
def command(
    run_dir: Path,
    recordings: tuple[Path, ...],
    out_dir: Path | None,
    truth: Path | None,
    map_truth: Path | None,
    most_states: int,
    force: bool,
    shared: Shared,
) -> None:
    """Localize LOG in the patch map of RUN and in maps without it, from the same start.

    These are the map of all beams, the filtered map, the union of all states, and the map in single states. Draws
    errors (with --truth), spread and states over time (Fig. 1.13 and 1.15 of the paper).
    """
    from dynmap_cli.comparison.stage import TruthFiles
    from dynmap_cli.runs.finished import compare
    from dynmap_cli.runs.outdated import outdated_results

    check_order(run_dir, recordings)
    if map_truth is not None and truth is None:
        msg = "--map-truth needs --truth"
        raise click.UsageError(msg)
    out_dir = out_dir or run_dir / "comparison" / recordings[0].name.split(".")[0]
    results = compare(
        run_dir,
        recordings,
        out_dir,
        shared.config,
        TruthFiles(truth, map_truth),
        most_states=most_states,
        threads=shared.threads,
        force=force,
    )
    summary = dict(results[-1].manifest.summary)
    files = {name: str(out_dir / name) for name in sorted(results[-1].manifest.outputs)}
    warnings = [line for line in results[0].manifest.summary.get("lines", ()) if line.startswith("warning")]
    lines = [*(f"ingest: {line}" for line in warnings), *summary["lines"]]
    lines += [f"{Path(name).stem:12}{path}" for name, path in files.items()]
    outdated = outdated_results(run_dir)
    print_summary(
        {**summary, "files": files, "outdated": outdated}, [*lines, *outdated], as_json=shared.as_json
    )
