"""`dynmap clean`: a recording without the beams that hit something that moves."""

from __future__ import annotations

from pathlib import Path

import click

from dynmap_cli.commands.options import PATH, Shared, print_summary, recording_options, shared_options
from dynmap_cli.commands.piped import LogPath


@click.command("clean", short_help="Write LOG again without beams on what moves.")
@click.argument("recordings", metavar="LOG...", nargs=-1, required=True, type=LogPath())
@click.option(
    "-o",
    "--output",
    "out_path",
    metavar="CLEAN.mcap",
    required=True,
    type=PATH,
    help="The MCAP file to write.",
)
@click.option(
    "--run",
    "run_dir",
    metavar="RUN",
    type=PATH,
    help="Take the labels from this run of LOG (default: map LOG first).",
)
@click.option(
    "--keep",
    type=click.Choice(["quasi-static"]),
    help="Keep beams on doors and boxes in any state that was recognised.",
)
@click.option(
    "--label",
    "is_label",
    is_flag=True,
    help="Leave the scans as they are; add static probabilities as intensities on TOPIC/static_probability.",
)
@click.option("--force", is_flag=True, help="Replace a recording that is there.")
@recording_options
@shared_options
def command(
    recordings: tuple[Path, ...],
    out_path: Path,
    run_dir: Path | None,
    keep: str | None,
    is_label: bool,
    force: bool,
    shared: Shared,
) -> None:
    """Write LOG again with NaN for beams that hit something that moves, for any other mapping program.

    All other messages stay byte for byte as they are: ROS 2 bags and MCAP files become MCAP of the same profile, ROS 1
    bags MCAP of profile ros1; text logs become LaserScan, Odometry and tf of ROS 2. Of a damaged recording what is
    whole is written, and one line says what was lost.
    """
    from dynmap_cli.runs.finished import clean

    summary = clean(
        recordings,
        out_path,
        shared.config,
        run_dir=run_dir,
        keep_changing=keep is not None,
        is_label=is_label,
        force=force,
        threads=shared.threads,
    )
    print_summary(summary, summary["lines"], as_json=shared.as_json)
