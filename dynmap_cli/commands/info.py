"""`dynmap info`."""

from __future__ import annotations

import click


@click.command("info")
def command() -> None:
    """Not there yet."""
    raise NotImplementedError
