"""`dynmap simulate`: a scenario becomes a recording, with its truth beside it."""

from __future__ import annotations

from pathlib import Path

import click

from dynmap_cli.commands.options import PATH, Shared, print_summary, shared_options


@click.command("simulate", short_help="Make a recording with known truth.")
@click.argument("scenario", metavar="SCENARIO.yaml", type=PATH)
@click.option(
    "-o",
    "--output",
    "recording",
    metavar="LOG",
    required=True,
    type=PATH,
    help="The recording; its suffix says which kind: .mcap, .bag, .log or .clf. The truth goes to LOG.truth/.",
)
@click.option("--force", is_flag=True, help="Replace a recording that is there.")
@shared_options
def command(scenario: Path, recording: Path, force: bool, shared: Shared) -> None:
    """Write the recording that the robot of SCENARIO would make, and what was really there.

    A scenario says which walls, doors, people and lasers there are: see configs/worlds in the clone. --seed replaces
    the seed of the scenario. The same scenario and seed give the same bytes.
    """
    from dynmap_cli.simulation.stage import simulate_to_files

    seed = shared.config.seed if "seed" in shared.loaded.origins else None
    summary = simulate_to_files(scenario, recording, seed=seed, force=force)
    print_summary(summary, summary["lines"], as_json=shared.as_json)
