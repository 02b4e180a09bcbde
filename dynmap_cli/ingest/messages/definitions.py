"""Definitions of message types that a bag brings: which of them can be believed, and which are the usual ones."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

MOST_CHARACTERS = 1 << 18
"""Of one definition that is parsed, which takes as long as it is; that of a standard type has less than 30 000."""


def check_size(kind: str, definition: str) -> None:
    """Refuse a definition that is longer than any that people write.

    Raises
    ------
    ValueError
    """
    if len(definition) > MOST_CHARACTERS:
        msg = f"its definition of {kind} has {len(definition)} characters (at most {MOST_CHARACTERS})"
        raise ValueError(msg)


def check_definitions(own: Typestore, standard: Typestore, used: Iterable[str]) -> None:
    """Refuse types that contain themselves, and standard types that are used, or inside those, that lack fields.

    Parameters
    ----------
    own, standard : Typestore
        Types as the bag defines them, and as they should be.
    used : iterable of str
        Types of messages that are used.

    Raises
    ------
    ValueError
    """
    _check_nesting(own.fielddefs)
    waiting = list(used)
    seen: set[str] = set()
    while waiting:
        kind = waiting.pop()
        if kind in seen or kind not in standard.fielddefs:
            continue
        seen.add(kind)
        names = {name for name, _ in own.fielddefs[kind][1]}
        for name, _ in standard.fielddefs[kind][1]:
            if name not in names:
                msg = f"its definition of {kind} has no field {name}"
                raise ValueError(msg)
        waiting += _types_inside(standard.fielddefs[kind][1])


def is_usual(own: Typestore, standard: Typestore, kind: str) -> bool:
    """Whether a bag defines a type, and those inside it, as the standard does."""
    waiting, seen = [kind], set()
    while waiting:
        name = waiting.pop()
        if name in seen:
            continue
        seen.add(name)
        if name not in standard.fielddefs or name not in own.fielddefs:
            return False
        fields = standard.fielddefs[name][1]
        if own.fielddefs[name][1] != fields:
            return False
        waiting += _types_inside(fields)
    return True


def _check_nesting(types: Mapping[str, Any]) -> None:
    """Refuse types of which one contains itself, at whatever depth: no message of it has an end."""
    inside = {kind: set(_types_inside(fields)) for kind, (_, fields) in types.items()}
    try:
        TopologicalSorter(inside).prepare()
    except CycleError as err:
        msg = f"its definition of {err.args[1][0]} contains itself"
        raise ValueError(msg) from err


def _types_inside(fields: Iterable[Any]) -> Iterator[str]:
    """Names of the types of fields that are messages, or arrays of messages."""
    for _, (node, detail) in fields:
        inner = detail[0] if node in {Nodetype.ARRAY, Nodetype.SEQUENCE} else (node, detail)
        if inner[0] == Nodetype.NAME:
            yield str(inner[1])
