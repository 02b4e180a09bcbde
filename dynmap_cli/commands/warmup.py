"""`dynmap warmup`."""

from __future__ import annotations

import click


@click.command("warmup")
def command() -> None:
    """Not there yet."""
    raise NotImplementedError
