"""RESULTS.md and its short form, in docs/measured.md and in part in the README: what is written, and what is kept."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from tests.bench import machine
from tests.bench.tables import Table

RESULTS = Path(__file__).with_name("RESULTS.md")
HEADLINES = (
    "Intel, odometry as recorded",
    "fr079, odometry as recorded",
    "CSAIL, odometry as recorded",
    "CSAIL, odometry made worse",
    "a third of the beams on people, ATE, worst of worlds and seeds",
    "patrol of two hours, ATE",
    "Intel and Seattle, beams called dynamic, worst",
    "beams in 20 worlds, mean, dynmap",
    "beams in 20 worlds, mean, plain counting map",
    "beams in 20 worlds, mean, the paper to the letter",
    "ATE in 20 worlds",
    "states, office_days",
    "several drives in one map",
    "localization, only_doors",
    "localization, office_days",
    "localization, Intel, mapped from the first half",
    "peer: yag-slam, Intel and others",
    "peer: amcl, two_doors, 1 and others",
)
"""Rows of the short form that the README shows too, good and bad ones."""
_BEGIN, _END = "<!-- bench:begin -->", "<!-- bench:end -->"
_SECTION = re.compile(r"<!-- (?P<name>[a-z]+):begin -->\n.*?<!-- (?P=name):end -->\n", re.DOTALL)


def page(tables: Sequence[Table], minutes: float, *, is_quick: bool = False) -> str:
    """All tables of one run, with what they were measured on."""
    lines = [
        "# Measured",
        "",
        "Written by `make bench`; numbers as they came out, good or bad.",
        "",
        *_measured_on(minutes, is_quick=is_quick),
    ]
    return "\n".join([*lines, *(line for table in tables for line in table.lines())]) + "\n"


def section(name: str, tables: Sequence[Table], minutes: float) -> str:
    """Tables that are measured on their own, with what they were measured on."""
    lines = [
        f"<!-- {name}:begin -->",
        f"# Measured on its own: `run.py --only {name}`",
        "",
        *_measured_on(minutes),
        *(line for table in tables for line in table.lines()),
        f"<!-- {name}:end -->",
    ]
    return "\n".join(lines) + "\n"


def with_sections_of(new: str, old: str) -> str:
    """A new page, followed by the sections of the old one."""
    kept = [match.group() for match in _SECTION.finditer(old)]
    return "\n".join([new.rstrip("\n") + "\n", *kept])


def with_section(old: str, name: str, new: str) -> str:
    """A page with one section replaced or added; the others keep their place."""
    names = [match["name"] for match in _SECTION.finditer(old)]
    if name not in names:
        return "\n".join([old.rstrip("\n") + "\n", new]) if old else new
    return _SECTION.sub(lambda match: new if match["name"] == name else match.group(), old)


def rewrite_short_forms(project: Path, tables: Sequence[Table]) -> None:
    """Replace what is between the markers: all rows in docs/measured.md, those that matter most in the README."""
    rows = [pair for table in tables for pair in table.short]
    rewrite_between_markers(project / "docs" / "measured.md", rows)
    rewrite_between_markers(project / "README.md", [row for row in rows if row[0] in HEADLINES])


def rewrite_between_markers(page_path: Path, rows: Sequence[tuple[str, str]]) -> None:
    """Replace the table of a page that is kept by hand but for it."""
    text = page_path.read_text(encoding="utf-8")
    lines = ["| what | result |", "|---|---|", *(f"| {what} | {result} |" for what, result in rows)]
    head, _, rest = text.partition(_BEGIN)
    _, _, tail = rest.partition(_END)
    page_path.write_text("\n".join([head + _BEGIN, *lines, _END + tail]), encoding="utf-8")


def short_rows(page_path: Path) -> list[tuple[str, str]]:
    """Rows of the table of a page: what was measured, and the result."""
    _, _, rest = page_path.read_text(encoding="utf-8").partition(_BEGIN)
    lines = rest.partition(_END)[0].strip().splitlines()[2:]
    pairs = [line.strip("| ").split(" | ", 1) for line in lines]
    return [(what, result) for what, result in pairs]


def _measured_on(minutes: float, *, is_quick: bool = False) -> list[str]:
    return [
        *machine.describe(),
        f"- it ran {minutes:.1f} min{', quick' if is_quick else ''}; two processes side by side with one thread "
        "each, so times are CPU seconds of the whole process, not wall time",
        "",
    ]
