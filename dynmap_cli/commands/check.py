"""`dynmap check`: what is in recordings, what would be used of them, and whether `build` will work."""

from __future__ import annotations

import json
import shlex
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dynmap_cli.commands.options import PATH, Shared, print_summary, recording_options, shared_options
from dynmap_cli.commands.piped import LogPath
from dynmap_cli.printable import STANDARD_INPUT

if TYPE_CHECKING:
    from dynmap_cli.checking import Check, Refusal


@click.command("check", short_help="Say what is in LOG, and whether build will work.")
@click.argument("recordings", metavar="LOG...", nargs=-1, required=True, type=LogPath())
@click.option(
    "--salvage",
    "salvage_path",
    metavar="OUT.mcap",
    type=PATH,
    help="Write what can be read of LOG, message by message, to this MCAP file.",
)
@click.option("--force", is_flag=True, help="Replace a file that is there.")
@recording_options
@shared_options
def command(recordings: tuple[Path, ...], salvage_path: Path | None, force: bool, shared: Shared) -> None:
    """Say what LOG holds, what would be used of it and why, and whether `build` will work.

    One screen for each drive: lasers with rates, gaps and places on the robot, order of the stamps, transforms that are
    missing, odometry, what beams without return mean, what was left out. Nothing is mapped, so it takes seconds. Exit
    code 0 = `build` will work, 4 = it will not.
    """
    from dynmap_cli.checking import check_recordings
    from dynmap_cli.errors import DynmapError, LogError

    if salvage_path is not None:
        from dynmap_cli.export.stage import check_output

        check_output(salvage_path, recordings, force=force)
    found = check_recordings(recordings, shared.config)
    lines, summary = _lines(found, recordings, shared), _summary(found)
    failure = None
    if salvage_path is not None:
        from dynmap_cli.export.salvaging import write_salvaged

        as_far_as_whole = shared.config.ingest.model_copy(update={"strict": False})
        try:
            salvaged = write_salvaged(recordings, salvage_path, as_far_as_whole)
        except DynmapError as err:
            failure = err
        else:
            lines += ["", *salvaged.lines()]
            summary["salvaged"] = salvaged.summary()
    print_summary(summary, lines, as_json=shared.as_json)
    if failure is not None:
        raise failure
    if found.refusals:
        raise LogError("; ".join(refusal.why for refusal in found.refusals))


def _summary(found: Check) -> dict[str, Any]:
    """The same for programs."""
    return {
        "build_works": not found.refusals,
        "drives": [asdict(drive) for drive in found.drives],
        "refusals": [asdict(refusal) for refusal in found.refusals],
        "advice": [asdict(advised) for advised in found.advice],
    }


def _lines(found: Check, recordings: tuple[Path, ...], shared: Shared) -> list[str]:
    """A screen for each drive, and the verdict on all."""
    from dynmap_cli.commands.screens import labelled, screen

    lines: list[str] = []
    for drive in found.drives:
        lines += [*screen(drive), ""]
    for refusal in found.refusals:
        lines += [*_refused(refusal), ""]
    if found.refusals:
        return [*lines, "build will not work"]
    names = " ".join("-" if str(path) == STANDARD_INPUT else shlex.quote(str(path)) for path in recordings)
    options = [*_options(shared), *dict.fromkeys(one.option for one in found.advice)]
    lines.append(" ".join([f"build will work: dynmap build {names} -o RUN", *options]))
    lines += labelled("for", (f"{one.option}: {one.why}" for one in found.advice))
    if len(found.drives) > 1:
        lines.append(f"  (whether the {len(found.drives)} drives fit on one map shows only when it is made)")
    return lines


def _options(shared: Shared) -> list[str]:
    """The settings that were given on the command line, for another one."""
    values = shared.config.model_dump(mode="json")
    options = []
    for key, origin in sorted(shared.loaded.origins.items()):
        if origin == "command line":
            value = values
            for name in key.split("."):
                value = value[name]
            text = value if isinstance(value, str) else json.dumps(value)
            options.append(f"--set {shlex.quote(f'{key}={text}')}")
    return options


def _refused(refusal: Refusal) -> list[str]:
    """What is in recordings that cannot be used, and why they cannot."""
    from dynmap_cli.commands.screens import labelled, topic_lines

    lines = []
    for name, kind, topics in refusal.topics:
        lines += [f"{name}: {kind}", *topic_lines(topics)]
    return [*(lines or [", ".join(refusal.names)]), *labelled("refused", [refusal.why])]
