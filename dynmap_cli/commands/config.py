"""`dynmap config show`: the settings in effect."""

from __future__ import annotations

import click

from dynmap_cli.commands.options import Shared, shared_options
from dynmap_cli.standard_output import echo


@click.group("config", short_help="Show all settings.")
def command() -> None:
    """Show settings; sections and keys are those of --config and --set."""


@command.command("show")
@shared_options
def show(shared: Shared) -> None:
    """Print the settings in effect as YAML, with what each means and where it came from."""
    import json

    from dynmap_cli.config import as_commented_yaml

    if shared.as_json:
        echo(json.dumps(shared.config.model_dump(mode="json"), indent=2) + "\n")
    else:
        echo(as_commented_yaml(shared.loaded))
