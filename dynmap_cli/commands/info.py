"""`dynmap info`: what is in a recording, and what would be used of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dynmap_cli.commands.options import PATH, Shared, print_summary, recording_options, shared_options
from dynmap_cli.commands.tables import table

if TYPE_CHECKING:
    from dynmap_cli.ingest.raw import RawRecording
    from dynmap_cli.ingest.report import IngestReport, LaserReport


@click.command("info")
@click.argument("recordings", metavar="LOG...", nargs=-1, required=True, type=PATH)
@recording_options
@shared_options
def command(recordings: tuple[Path, ...], shared: Shared) -> None:
    """Say what LOG holds: topics, lasers, frames, odometry; what would be used of it, and why."""
    from dynmap_cli.errors import LogError
    from dynmap_cli.ingest.reading import load_recordings, merge_recordings

    found = load_recordings(recordings, shared.config.ingest)
    topics = [line for recording in found for line in _topic_lines(recording)]
    try:
        _, report = merge_recordings(found, shared.config.ingest)
    except LogError:
        if not shared.as_json:
            print_summary({}, topics, as_json=False)
        raise
    lines = [
        *topics,
        *_laser_lines(report.lasers),
        *_frame_lines(report),
        "",
        "what would be used",
        *_why(report),
    ]
    print_summary(report.summary(), lines, as_json=shared.as_json)


def _topic_lines(recording: RawRecording) -> list[str]:
    """Name, type and count of everything in a recording."""
    rows = [(topic.name, topic.kind, str(topic.count)) for topic in recording.topics]
    return [f"{recording.name}: {recording.kind}", *table(("topic", "type", "count"), rows), ""]


def _laser_lines(lasers: Sequence[LaserReport]) -> list[str]:
    """All lasers, used or not."""
    header = (
        "laser",
        "frame",
        "scans",
        "beams",
        "view deg",
        "reach m",
        "per s",
        "x m",
        "y m",
        "yaw rad",
        "used",
    )
    rows = []
    for laser in lasers:
        pose = ("-", "-", "-") if laser.pose is None else tuple(f"{value:.3f}" for value in laser.pose)
        beams = "-".join(str(count) for count in sorted(set(laser.beams)))
        reach = "-" if laser.reach_m is None else f"{laser.reach_m:g}"
        what = (
            laser.name,
            laser.frame or "-",
            str(laser.scans),
            beams,
            f"{laser.field_of_view_deg:.1f}",
            reach,
        )
        rows.append((*what, f"{laser.rate_hz:.1f}", *pose, "yes" if laser.used else "no"))
    return [*table(header, rows), ""]


def _frame_lines(report: IngestReport) -> list[str]:
    """Span and frames."""
    frames = ", ".join(report.frames) if report.frames else "none"
    return [
        f"span    {report.span_s:.1f} s",
        f"robot   {report.base_frame or 'no frame'}",
        f"frames  {frames}",
    ]


def _why(report: IngestReport) -> list[str]:
    """The decisions, indented."""
    return [f"  {line}" for line in report.lines()]
