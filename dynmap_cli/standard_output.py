"""Results that go to stdout: all of it is written, or it is said why not."""

from __future__ import annotations

import errno
import os
import sys
import traceback
from contextlib import suppress

import click

from dynmap_cli.errors import ArtifactError


def echo(text: str) -> None:
    """Write a result to stdout, all of it.

    Raises
    ------
    ArtifactError
        If stdout takes nothing.
    """
    try:
        if sys.stdout is None:
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))
        click.echo(text, nl=False)
    except OSError as err:
        raise unwritable(err) from err


def is_of_output(err: OSError) -> bool:
    """Whether an error came from writing words, as click does with its help, and not from the work."""
    return any(frame.f_code is click.echo.__code__ for frame, _ in traceback.walk_tb(err.__traceback__))


def unwritable(err: OSError) -> ArtifactError:
    """What to say of a stdout that takes nothing; what it still holds is given up."""
    with suppress(OSError, AttributeError):
        # What is still in the buffer would fail once more at the end of the process.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return ArtifactError(
        f"stdout: cannot be written ({err.strerror}). Choose another output or free the place."
    )
