"""RESULTS.md and the short form in the README: what is written anew, and what is kept from earlier runs."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from tests.bench import machine
from tests.bench.tables import Table

RESULTS = Path(__file__).with_name("RESULTS.md")
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


def rewrite_short_form(readme: Path, tables: Sequence[Table]) -> None:
    """Replace what is between the markers in the README."""
    text = readme.read_text(encoding="utf-8")
    rows = [pair for table in tables for pair in table.short]
    lines = ["| what | result |", "|---|---|", *(f"| {what} | {result} |" for what, result in rows)]
    if _BEGIN not in text or _END not in text:
        text += f"\n## Measured\n\n{_BEGIN}\n{_END}\n"
    head, _, rest = text.partition(_BEGIN)
    _, _, tail = rest.partition(_END)
    readme.write_text("\n".join([head + _BEGIN, *lines, _END + tail]), encoding="utf-8")


def _measured_on(minutes: float, *, is_quick: bool = False) -> list[str]:
    return [
        *machine.describe(),
        f"- it ran {minutes:.1f} min{', quick' if is_quick else ''}; two processes side by side with one thread "
        "each, so times are CPU seconds of the whole process, not wall time",
        "",
    ]
