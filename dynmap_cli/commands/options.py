"""Options that several verbs share, defined once."""

from __future__ import annotations

import functools
import json
import logging
import math
import os
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dynmap_cli.files.plain_values import number_in
from dynmap_cli.printable import for_people
from dynmap_cli.standard_output import echo

if TYPE_CHECKING:
    from dynmap_cli.config import Config, LoadedConfig
    from dynmap_cli.runs.pipeline import StageResult

Function = Callable[..., Any]


class _NamedPath(click.Path):
    """A path that has a name: an empty one, as from a shell variable that is not set, would be the current folder."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path as given."""
        if str(value) == "":
            self.fail("the path is empty; for the current folder give `.`", param, ctx)
        return super().convert(value, param, ctx)


PATH = _NamedPath(path_type=Path)
MAX_THREADS = 1024
MAX_SEED = 2**63 - 1

_WARNING = re.compile(r"(\w+: )?warning: ")


@dataclass(frozen=True, slots=True)
class Shared:
    """What the shared options said.

    Attributes
    ----------
    loaded : LoadedConfig
        Settings in effect, with where each came from.
    threads : int
    as_json : bool
    """

    loaded: LoadedConfig
    threads: int
    as_json: bool

    @property
    def config(self) -> Config:
        """The settings in effect."""
        return self.loaded.config


threads_option = click.option(
    "--threads",
    metavar="N",
    type=click.IntRange(0, MAX_THREADS),
    default=0,
    help="Threads to use; 0 = all cores.",
)


def output_option(folder: str) -> Callable[[Function], Function]:
    """-o of a verb that writes into a folder of the run."""
    return click.option(
        "-o",
        "--output",
        "out_dir",
        metavar="OUT",
        type=PATH,
        help=f"Where to write (default: RUN/{folder}/NAME, NAME as that of LOG).",
    )


def shared_options(function: Function) -> Function:
    """Add --config, --set, --seed, --threads, --json, -v and -q; the verb gets one `shared` argument."""

    @click.option(
        "--config",
        "config_path",
        type=PATH,
        help="YAML file with settings, or a parameter file of nav2 or AMCL.",
    )
    @click.option(
        "--set",
        "assignments",
        multiple=True,
        metavar="KEY=VALUE",
        help="One setting, as map.resolution_m=0.1; may be repeated.",
    )
    @click.option(
        "--seed", metavar="N", type=click.IntRange(0, MAX_SEED), help="Seed of everything random (default 0)."
    )
    @threads_option
    @click.option("--json", "as_json", is_flag=True, help="Write the summary as JSON to stdout.")
    @click.option("-v", "--verbose", count=True, help="More lines on stderr.")
    @click.option(
        "-q", "--quiet", is_flag=True, help="Only warnings and errors on stderr; stdout stays as it is."
    )
    @functools.wraps(function)
    def wrapper(
        *args: Any,
        config_path: Path | None,
        assignments: tuple[str, ...],
        seed: int | None,
        threads: int,
        as_json: bool,
        verbose: int,
        quiet: bool,
        **kwargs: Any,
    ) -> None:
        from dynmap_cli.config import load_config, parse_assignments

        set_up_logging(verbose, quiet=quiet)
        words = parse_assignments(assignments)
        words.update({key: value for key, value in kwargs.pop("settings", {}).items() if value is not None})
        if seed is not None:
            words["seed"] = seed
        loaded = load_config(config_path, words)
        for note in loaded.notes:
            logging.getLogger("dynmap_cli").info(note)
        shared = Shared(loaded, threads or os.cpu_count() or 1, as_json)
        function(*args, shared=shared, **kwargs)

    return wrapper


def reading_options(function: Function) -> Function:
    """Add --json, -v and -q to a verb that reads a finished run; its settings are those the run was made with."""

    @click.option("--json", "as_json", is_flag=True, help="Write the summary as JSON to stdout.")
    @click.option("-v", "--verbose", count=True, help="More lines on stderr.")
    @click.option(
        "-q", "--quiet", is_flag=True, help="Only warnings and errors on stderr; stdout stays as it is."
    )
    @functools.wraps(function)
    def wrapper(*args: Any, verbose: int, quiet: bool, **kwargs: Any) -> None:
        set_up_logging(verbose, quiet=quiet)
        function(*args, **kwargs)

    return wrapper


def recording_options(function: Function) -> Function:
    """Add --scan-topic, --odom, --laser-pose, --mask-sector and --strict: settings of the section `ingest`."""

    @click.option("--scan-topic", help="Topic of the laser scans (default: the laser that sees most).")
    @click.option("--odom", help="Odometry: a topic, 'tf' or 'none' (default: found on its own).")
    @click.option(
        "--laser-pose", metavar="X,Y,YAW", help="Pose of the laser on the robot, metres and radians."
    )
    @click.option(
        "--mask-sector",
        "mask_sectors",
        multiple=True,
        metavar="FROM,TO[,LASER]",
        help="Leave out beams from FROM counter-clockwise to TO, degrees in the robot's frame; may be repeated.",
    )
    @click.option(
        "--strict", is_flag=True, help="Refuse a damaged recording instead of using what is whole in it."
    )
    @functools.wraps(function)
    def wrapper(
        *args: Any,
        scan_topic: str | None,
        odom: str | None,
        laser_pose: str | None,
        mask_sectors: tuple[str, ...],
        strict: bool,
        **kwargs: Any,
    ) -> None:
        settings = {
            "ingest.scan_topic": scan_topic,
            "ingest.odom": odom,
            "ingest.laser_pose": None if laser_pose is None else three_numbers("--laser-pose", laser_pose),
            "ingest.mask_sectors": [_sector(text) for text in mask_sectors] or None,
            "ingest.strict": strict or None,
        }
        function(*args, settings=settings, **kwargs)

    return wrapper


def start_option(function: Function) -> Function:
    """Add --start, which stands for the setting `localization.start`."""

    @click.option(
        "--start",
        metavar="X,Y,YAW",
        help="Pose at the first scan, metres and radians (default: found on its own).",
    )
    @functools.wraps(function)
    def wrapper(*args: Any, start: str | None, settings: dict[str, Any], **kwargs: Any) -> None:
        pose = None if start is None else three_numbers("--start", start)
        function(*args, settings={**settings, "localization.start": pose}, **kwargs)

    return wrapper


class _ForPeople(logging.Formatter):
    """Log lines that no name of others can break."""

    def format(self, record: logging.LogRecord) -> str:
        """One record as it is said to people."""
        return for_people(super().format(record))


def set_up_logging(verbose: int, *, quiet: bool) -> None:
    """Send log lines to stderr; -q leaves warnings and errors, -v adds details."""
    level = logging.WARNING if quiet else logging.DEBUG if verbose else logging.INFO
    logger = logging.getLogger("dynmap_cli")
    logger.setLevel(level)
    logger.handlers.clear()
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_ForPeople("%(message)s"))
    logger.addHandler(handler)


def print_summary(summary: dict[str, Any], lines: list[str], *, as_json: bool) -> None:
    """Write the result of a verb to stdout: JSON for programs, lines for people; warnings go to stderr.

    Programs find them under `warnings` as well, without the word.
    """
    warnings = [line for line in lines if _WARNING.match(line)]
    if as_json:
        summary = {**summary, "warnings": [_WARNING.sub(r"\1", line) for line in warnings]}
        echo(json.dumps(_as_json(summary), indent=2, sort_keys=True, allow_nan=False) + "\n")
    else:
        echo("".join(f"{for_people(line)}\n" for line in lines if line not in warnings))
    for line in warnings:
        click.echo(for_people(line), err=True)


def print_results(run_dir: Path, results: Sequence[StageResult], *, as_json: bool) -> None:
    """Write what the stages of a run found, and where its files are."""
    from dynmap_cli.runs.outdated import outdated_results

    lines = [
        f"{result.stage}: {line}" for result in results for line in result.manifest.summary.get("lines", ())
    ]
    lines += [f"map      {run_dir / 'map/map.yaml'}", f"patches  {run_dir / 'patches/patches.zip'}"]
    lines += [f"report   {run_dir / 'report.html'}", f"figures  {run_dir / 'figures'}/"]
    outdated = outdated_results(run_dir)
    summary = {result.stage: {**result.manifest.summary, "ran": result.ran} for result in results}
    print_summary(
        {"run": str(run_dir), "stages": summary, "outdated": outdated}, [*lines, *outdated], as_json=as_json
    )


def _as_json(value: Any) -> Any:
    """The same with null for NaN and infinity, which JSON does not know."""
    if isinstance(value, dict):
        return {str(key): _as_json(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_as_json(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def three_numbers(option: str, text: str) -> tuple[float, ...]:
    """Read x,y,yaw as an option gives it."""
    try:
        values = tuple(number_in(word) for word in text.split(","))
    except ValueError:
        values = ()
    if len(values) != 3:
        msg = f"{option} {text}: expected x,y,yaw in metres and radians, for instance 0.2,0,0"
        raise click.UsageError(msg)
    return values


def _sector(text: str) -> list[float | str]:
    """Read from,to or from,to,laser as --mask-sector gives it."""
    start, _, rest = text.partition(",")
    end, _, laser = rest.partition(",")
    try:
        limits = [number_in(start), number_in(end)]
    except ValueError as err:
        msg = f"--mask-sector {text}: expected from,to in degrees, for instance 150,210 or 150,210,/scan"
        raise click.UsageError(msg) from err
    return [*limits, laser] if laser else [*limits]


def run_single_stage(name: str, run_dir: Path, shared: Shared, *, force: bool) -> None:
    """Run one stage of a run directory and print what it found."""
    from dynmap_cli.runs.pipeline import run_one

    summary = run_one(run_dir, name, shared.config, threads=shared.threads, force=force).manifest.summary
    print_summary(summary, summary.get("lines", []), as_json=shared.as_json)
