"""The order of RUN and LOG on the command line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click


def check_order(run_dir: Path, recordings: Sequence[Path]) -> None:
    """Refuse arguments in the wrong order, which would be read as a run that is not there.

    Raises
    ------
    click.UsageError
        If a run stands among the recordings, or a file in the place of the run.
    """
    verb = click.get_current_context().info_name
    if _is_run(run_dir):
        return
    for path in recordings:
        if _is_run(path):
            msg = f"{path} is a run directory and {run_dir} is none: RUN comes first, `dynmap {verb} {path} {run_dir}`"
            raise click.UsageError(msg)
    if run_dir.is_file():
        msg = f"{run_dir} is a file, not a run directory: `dynmap {verb} RUN LOG`"
        raise click.UsageError(msg)


def check_no_run(recordings: Sequence[Path]) -> None:
    """Refuse a run beside --map, which would be read as a recording.

    Raises
    ------
    click.UsageError
        If there is one.
    """
    for path in recordings:
        if _is_run(path):
            msg = f"{path} is a run directory, and --map is another map: leave out one of the two"
            raise click.UsageError(msg)


def _is_run(path: Path) -> bool:
    """Whether a stage of dynmap ran here."""
    return (path / "run.yaml").is_file()
