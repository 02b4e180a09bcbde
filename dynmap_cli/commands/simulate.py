"""`dynmap simulate`."""

from __future__ import annotations

import click


@click.command("simulate")
def command() -> None:
    """Not there yet."""
    raise NotImplementedError
