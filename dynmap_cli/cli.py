"""The door: the group of verbs. Each verb is imported when it is asked for, numpy and numba inside its body."""

from __future__ import annotations

import importlib
import io
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

import click

from dynmap_cli import __version__
from dynmap_cli.errors import DynmapError
from dynmap_cli.printable import for_people
from dynmap_cli.standard_output import is_of_output, unwritable

VERBS = (
    "check",
    "build",
    "update",
    "edit",
    "ingest",
    "map",
    "segment",
    "cluster",
    "localize",
    "compare",
    "export",
    "timeline",
    "explain",
    "clean",
    "simulate",
    "evaluate",
    "config",
    "warmup",
)

EPILOG = """\b
Exit codes:
    0  done; what that means for localize, its --help says
    1  internal error: a bug, with its traceback
    2  usage
    3  settings, scenario, or what RUN does not have
    4  recording
    5  files between stages, or an output that cannot be written
  130  interrupted
"""


class DynmapGroup(click.Group):
    """Load verbs on demand and print expected failures as one line, with their exit code."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Name the verbs in the order of the work."""
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import the module of the verb."""
        if cmd_name not in VERBS:
            return None
        module = importlib.import_module(f"dynmap_cli.commands.{cmd_name}")
        command: click.Command = module.command
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the verb; of a word that is none, name the one that is nearest."""
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError as err:
            import difflib

            near = difflib.get_close_matches(args[0], VERBS, n=1)
            if not near:
                raise
            msg = f"{err.message} Did you mean '{near[0]}'?"
            raise click.UsageError(msg, ctx) from err

    def main(self, *args: Any, **kwargs: Any) -> Any:
        """Let no name of a file break an output that cannot show it."""
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(errors="backslashreplace")
        return super().main(*args, **kwargs)

    def make_context(self, *args: Any, **kwargs: Any) -> click.Context:
        """Take the words before the verb, of which --help and --version write."""
        with _writing():
            return super().make_context(*args, **kwargs)

    def invoke(self, ctx: click.Context) -> object:
        """Run the chosen verb."""
        try:
            with _writing():
                return super().invoke(ctx)
        except DynmapError as err:
            _fail(err)
        except KeyboardInterrupt:
            click.echo("dynmap: interrupted; finished stages are kept", err=True)
            sys.exit(130)


@contextmanager
def _writing() -> Iterator[None]:
    """Say where stdout takes no help, before click ends in silence at a pipe that nobody reads."""
    try:
        yield
    except OSError as err:
        # The help of click goes to stdout by itself; any other failure is a bug.
        if not is_of_output(err):
            raise
        _fail(unwritable(err))


def _fail(err: DynmapError) -> NoReturn:
    """Say in one line what failed, and end with its exit code."""
    click.echo(f"dynmap: {for_people(' '.join(str(err).splitlines()))}", err=True)
    sys.exit(err.exit_code)


ABOUT = """Turn recorded robot logs into maps of places that change, and localize later recordings in them.

\b
Start with
  dynmap check LOG          what is in a recording, and whether it can be used
  dynmap build LOG -o RUN   map it; then open RUN/report.html
  dynmap localize RUN LOG   find another recording in this map

LOG is a recording: CARMEN text, a ROS 1 or ROS 2 bag or an MCAP file, also compressed; `-` = through a pipe. RUN
is the folder of a map. A sub-map is an area that changes; its ID is a number, which `dynmap timeline RUN` lists.
"""


@click.group(
    cls=DynmapGroup,
    help=ABOUT,
    epilog=EPILOG,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(__version__, prog_name="dynmap")
def main() -> None:
    """Run the command that is named."""
