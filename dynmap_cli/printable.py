"""Words of others that go to a terminal or into a table: one line of characters that can be shown."""

from __future__ import annotations


def printable(text: str) -> str:
    """The text with ? for line ends, control codes and broken characters."""
    return text if text.isprintable() else "".join(one if one.isprintable() else "?" for one in text)
