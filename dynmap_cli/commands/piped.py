"""A recording that comes through a pipe: `-`."""

from __future__ import annotations

import os
import shutil
import stat
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click

from dynmap_cli.printable import STANDARD_INPUT

_BLOCK_BYTES = 1 << 20


class LogPath(click.Path):
    """A path of a recording; `-` is what comes through the pipe, put by in a private folder until the verb is done."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path as given, or that of standard input once it can be read as a file."""
        if str(value) != "-" or ctx is None:
            return super().convert(value, param, ctx)
        if sys.stdin is None or sys.stdin.isatty():
            self.fail("`-` reads a recording from a pipe, and nothing is piped", param, ctx)
        if not stat.S_ISREG(os.fstat(0).st_mode):
            _put_by(ctx)
        # Results name it so, whatever the private folder is called.
        return Path(STANDARD_INPUT)


def _put_by(ctx: click.Context) -> None:
    """Copy standard input into a file, and let it stand for standard input.

    Of what begins like no recording only the first bytes are copied, for it may never end.
    """
    from dynmap_cli.errors import LogError
    from dynmap_cli.ingest.containers.formats import HEAD_BYTES, kind_of_head

    folder = TemporaryDirectory(prefix="dynmap-")
    ctx.call_on_close(folder.cleanup)
    with (Path(folder.name) / "stdin").open("xb+") as target:
        is_known = False
        while block := os.read(0, _BLOCK_BYTES):
            if shutil.disk_usage(folder.name).free < 2 * _BLOCK_BYTES:
                remedy = "Copy the recording into a file, or set TMPDIR."
                msg = f"standard input: larger than {folder.name} has place for. {remedy}"
                raise LogError(msg)
            target.write(block)
            if not is_known and target.tell() >= HEAD_BYTES:
                target.seek(0)
                head = target.read(HEAD_BYTES)
                target.seek(0, os.SEEK_END)
                try:
                    kind_of_head(head, "")
                except LogError:
                    break
                is_known = True
        target.flush()
        os.dup2(target.fileno(), 0)
