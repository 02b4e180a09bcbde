"""Words of others that go to a terminal or into a table: one line of characters that can be shown."""

from __future__ import annotations

STANDARD_INPUT = "/dev/stdin"
"""Where a recording that comes through a pipe is read from, and the name that results have it by."""


def printable(text: str) -> str:
    """The text with ? for line ends, control codes and broken characters."""
    return text if text.isprintable() else "".join(one if one.isprintable() else "?" for one in text)


def for_people(text: str) -> str:
    """The text as it is said to people: line by line printable, and standard input by its name."""
    return "\n".join(map(printable, text.split("\n"))).replace(STANDARD_INPUT, "standard input")
