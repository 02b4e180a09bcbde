"""Values of a document that somebody else may have written: what is expected, or a `ValueError` that says where.

Each function takes what was found and the words for where it stands, and complains as `<where> is <found>, not <what is
allowed>`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

_LONGEST = 60
_NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*", re.ASCII)


def said(value: object) -> str:
    """A value as it may stand in a message: short, in one line, without the words of Python."""
    if value is None:
        return "empty"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Mapping):
        return f"{len(value)} `key: value` lines"
    if isinstance(value, list | tuple):
        shown = ", ".join(said(one) for one in value[:5])
        more = f", ... ({len(value)} values)" if len(value) > 5 else ""
        return f"[{_cut(shown)}{more}]"
    return _cut(repr(value[: 2 * _LONGEST] if isinstance(value, str) else value))


def _cut(words: str) -> str:
    return words if len(words) <= _LONGEST else f"{words[:_LONGEST]}..."


def mapping_at(value: object, where: str) -> dict[str, Any]:
    """Keys with values."""
    if not isinstance(value, dict):
        msg = f"{where} is {said(value)}, not `key: value` lines"
        raise ValueError(msg)
    return value


def list_at(value: object, where: str) -> list[Any]:
    """Values in a row."""
    if not isinstance(value, list):
        msg = f"{where} is {said(value)}, not a list"
        raise ValueError(msg)
    return value


def item_of(entry: Mapping[str, Any], key: str, where: str) -> Any:
    """The value of a key that must be there; raises ValueError."""
    if key not in entry:
        msg = f"{where} has no {key}"
        raise ValueError(msg)
    return entry[key]


def whole_at(value: object, where: str, least: int, most: int) -> int:
    """A whole number from *least* to *most*."""
    if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= most:
        msg = f"{where} is {said(value)}, not a whole number from {least} to {most}"
        raise ValueError(msg)
    return value


def number_at(value: object, where: str, least: float = -math.inf, most: float = math.inf) -> float:
    """A finite number from *least* to *most*."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not (is_number and math.isfinite(value) and least <= value <= most):  # type: ignore[arg-type, operator]
        limits = "" if math.isinf(least) and math.isinf(most) else f" from {least:g} to {most:g}"
        msg = f"{where} is {said(value)}, not a finite number{limits}"
        raise ValueError(msg)
    return float(value)  # type: ignore[arg-type]


def numbers_at(
    value: object, where: str, least: float = -math.inf, most: float = math.inf
) -> tuple[float, ...]:
    """Finite numbers in a row."""
    return tuple(number_at(one, f"{where}[{k}]", least, most) for k, one in enumerate(list_at(value, where)))


def text_at(value: object, where: str) -> str:
    """Printable characters in one line."""
    if not isinstance(value, str) or not value.isprintable():
        msg = f"{where} is {said(value)}, not printable characters in one line"
        raise ValueError(msg)
    return value


def distinct(numbers: list[int], what: str) -> None:
    """Refuse numbers of which one is there twice."""
    seen: set[int] = set()
    for number in numbers:
        if number in seen:
            msg = f"{what} {number} is there twice"
            raise ValueError(msg)
        seen.add(number)


def number_in(word: str) -> float:
    """A number as people write it: no underscores between digits, no digits of other scripts, not nan or inf.

    Raises
    ------
    ValueError
        If it is none.
    """
    value = float(word) if _NUMBER.fullmatch(word) else math.nan
    if not math.isfinite(value):
        msg = f"{said(word)} is not a finite number"
        raise ValueError(msg)
    return value
