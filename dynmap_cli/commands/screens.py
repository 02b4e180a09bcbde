"""One screen on a drive for people: what it holds, what would be used of it and why, what is wrong with it."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Iterable
from datetime import UTC, datetime

from dynmap_cli.commands.tables import table
from dynmap_cli.ingest.choices.track_quality import TrackQuality
from dynmap_cli.ingest.messages.kinds import POSE_TYPES, USED_TYPES
from dynmap_cli.ingest.raw.recording import Topic
from dynmap_cli.ingest.report import IngestReport, LaserReport
from dynmap_cli.printable import printable

_WIDTH, _LABEL_WIDTH = 110, 16
_BEFORE_UNIT = re.compile(r"(?<=\d) (?=(?:%|s|m|m2|mm|cm|deg|m/s|times|per s)(?![\w/]))|(?<=\d per) (?=s\b)")
"""Where no line ends: a number stays with its unit."""
_FIRST_CLOCK_S = 315_532_800  # 1980: what is earlier counts from the start of a robot, not of an epoch
_MOST_OTHERS = 12
_LASER_HEADER = (
    "laser",
    "frame",
    "scans",
    "beams",
    "view deg",
    "reach m",
    "per s",
    "longest gap s",
    "x m",
    "y m",
    "yaw deg",
    "used",
)


def screen(report: IngestReport) -> list[str]:
    """Lines on one drive."""
    topics = [topic for found in report.recordings for topic in found.topics]
    times = [f"{laser.name}: {_times(laser)}" for laser in report.lasers if laser.used]
    return [
        _title(report),
        *labelled("apart", [f"a drive of its own: {report.why_apart}"] if report.why_apart else []),
        *table(_LASER_HEADER, [_laser_row(laser) for laser in report.lasers]),
        *labelled("lasers", (f"{laser.name}: {_choice(laser)}" for laser in report.lasers)),
        *labelled("free space", (f"{one.name}: {one.no_return_line}" for one in report.lasers if one.used)),
        *labelled("masked", (f"{one.name}: {one.masked}" for one in report.lasers if one.masked)),
        *labelled("time", times),
        *labelled("transforms", _transforms(report)),
        *labelled("odometry", _odometry(report)),
        *labelled("left out", (f"{count} x {reason}" for reason, count in sorted(report.dropped.items()))),
        *labelled("other topics", _others(topics, report)),
        *labelled("note", report.notes),
        *labelled("warning", report.warnings),
    ]


def labelled(label: str, sentences: Iterable[str]) -> list[str]:
    """Sentences beside a label, broken into lines; nothing where there are none."""
    lines: list[str] = []
    for sentence in sentences:
        whole = _BEFORE_UNIT.sub("\N{NO-BREAK SPACE}", sentence)
        broken = textwrap.wrap(whole, _WIDTH - _LABEL_WIDTH, break_long_words=False, break_on_hyphens=False)
        lines += [line.replace("\N{NO-BREAK SPACE}", " ") for line in broken]
    heads = [label, *[""] * len(lines)]
    return [f"  {head:{_LABEL_WIDTH - 2}}{line}" for head, line in zip(heads, lines, strict=False)]


def topic_lines(topics: Iterable[Topic]) -> list[str]:
    """Everything in a recording that cannot be used."""
    return table(("topic", "type", "count"), [(one.name, one.kind, str(one.count)) for one in topics])


def _title(report: IngestReport) -> str:
    """Names, formats, length and date."""
    names = ", ".join(f"{printable(found.name)} ({found.kind})" for found in report.recordings)
    date = ""
    if report.first_stamp_ns >= _FIRST_CLOCK_S * 10**9:
        began = datetime.fromtimestamp(report.first_stamp_ns // 10**9, UTC)
        date = f" from {began:%Y-%m-%d %H:%M:%S} UTC"
    return f"{names}: {report.scans} scans over {report.span_s:.1f} s{date}"


def _laser_row(laser: LaserReport) -> tuple[str, ...]:
    """One laser in numbers."""
    pose = ("-", "-", "-")
    if laser.pose is not None:
        x, y, yaw = laser.pose
        pose = (f"{x:.3f}", f"{y:.3f}", f"{math.degrees(yaw):.1f}")
    return (
        laser.name,
        laser.frame or "-",
        str(laser.scans),
        "-".join(str(count) for count in sorted(set(laser.beams))),
        f"{laser.field_of_view_deg:.1f}",
        "-" if laser.reach_m is None else f"{laser.reach_m:g}",
        f"{laser.rate_hz:.1f}",
        f"{laser.timing.longest_gap_s:.2f}",
        *pose,
        "yes" if laser.used else "no",
    )


def _choice(laser: LaserReport) -> str:
    """Why a laser is used or not."""
    turned = "; upside down" if laser.upside_down else ""
    return f"{'used' if laser.used else 'not used'}, {laser.why}{turned}"


def _times(laser: LaserReport) -> str:
    """Order and gaps."""
    timing = laser.timing
    order = "in order"
    if timing.backward:
        by = f"by up to {timing.most_backward_s:.2f} s"
        order = f"{timing.backward} scans stamped before their predecessor, {by}; sorted"
    if not timing.is_steady:
        return f"{order}; not at a steady rate, so missing scans cannot be told"
    if not timing.missing:
        return f"{order}; steady, none missing"
    where = "one gap" if timing.gaps == 1 else f"{timing.gaps} gaps"
    share = timing.missing / (laser.scans + timing.missing)
    return f"{order}; steady but for {where} into which {timing.missing} scans would fit ({100 * share:.1f} % of all)"


def _transforms(report: IngestReport) -> list[str]:
    """Which of the transforms that are needed are there."""
    lost = [laser for laser in report.lasers if not laser.is_pose_known]
    if not report.frames:
        where = "unknown" if lost else "stated by the log or set"
        return [f"none in the recording; place of the laser on the robot: {where}"]
    base = report.base_frame or "the robot"
    missing = [f"{base} -> {laser.frame or 'a laser without a frame'} (of {laser.name})" for laser in lost]
    if missing:
        return [f"missing: {', '.join(missing)}; frames here: {', '.join(report.frames[:_MOST_OTHERS])}"]
    complete = f"complete from {base} to each laser ({len(report.frames)} frames)"
    sources = (report.odometry, *report.odometry_rejected)
    if report.odometry_why != "as set" and not any(source.startswith("tf ") for source in sources):
        return [f"{complete}, but no odometry frame above {base}"]
    return [complete]


def _odometry(report: IngestReport) -> list[str]:
    """Which odometry, and how good it is as far as that shows before scans are registered."""
    rejected = [f"not used: {'; '.join(report.odometry_rejected)}"] if report.odometry_rejected else []
    if report.odometry == "none":
        return [f"none, {report.odometry_why}; scans alone will say where the robot is", *rejected]
    found = (
        f"{report.odometry} ({report.odometry_why}): {report.odometry_path_m:.1f} m, "
        f"{report.odometry_rate_hz:.1f} per s, longest gap {report.odometry_longest_gap_s:.2f} s"
    )
    quality = [] if report.odometry_quality is None else [_quality(report.odometry_quality)]
    return [found, *quality, *rejected]


def _quality(quality: TrackQuality) -> str:
    """What speaks for and against an odometry."""
    still = f"moves in all {quality.moving} half seconds in which the ranges change"
    if quality.moving == 0:
        still = "untested, as the ranges hardly ever change"
    elif quality.frozen:
        still = f"stands still in {quality.frozen} of the {quality.moving} half seconds in which the ranges change"
    return (
        f"covers {100 * quality.covered:.1f} % of the scans; turns {math.degrees(quality.turned_rad):.0f} deg in all, "
        f"fastest {quality.fastest_mps:.2f} m/s; {still}"
    )


def _others(topics: Iterable[Topic], report: IngestReport) -> list[str]:
    """What is not read at all, and poses that are no odometry."""
    named = {laser.name for laser in report.lasers} | {report.odometry}
    named |= {source.partition(" (")[0] for source in report.odometry_rejected}
    others = [
        f"{one.name} ({one.kind.rpartition('/')[2]})"
        for one in topics
        if one.kind not in {*(USED_TYPES - POSE_TYPES), "line"} and one.name not in named
    ]
    more = f" and {len(others) - _MOST_OTHERS} more" if len(others) > _MOST_OTHERS else ""
    return [", ".join(others[:_MOST_OTHERS]) + more] if others else []
