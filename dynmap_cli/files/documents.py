"""YAML and JSON that somebody else may have written: plain values of bounded size, or a `ValueError`.

No anchors and aliases (a few lines of them expand to gigabytes), no key twice, no integer beyond 64 bits.
"""

from __future__ import annotations

import json
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import yaml

MAX_DOCUMENT_BYTES = 20_000_000
MAX_TABLE_BYTES = 500_000_000
_MAX_INTEGER = 2**63
_DEEPEST = 64


def read_text(path: Path, max_bytes: int = MAX_DOCUMENT_BYTES) -> str:
    """Read a file as UTF-8.

    Raises
    ------
    OSError, ValueError
        If it cannot be read, is longer than *max_bytes*, or is not UTF-8.
    """
    with path.open("rb") as stream:
        content = stream.read(max_bytes + 1)
    if len(content) > max_bytes:
        msg = f"more than {max_bytes} bytes, the most that are read"
        raise ValueError(msg)
    return as_text(content, "it")


def as_text(content: bytes, name: str) -> str:
    """UTF-8 as text; raises ValueError, in which *name* is named."""
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as err:
        msg = f"{name} is not text in UTF-8, byte {err.start} is 0x{content[err.start]:02x}"
        raise ValueError(msg) from err


def parse_yaml(text: str) -> Any:
    """Turn one YAML document into plain values.

    Raises
    ------
    ValueError
        With one line that says what is wrong and where.
    """
    try:
        return _PlainLoader(text).get_single_data()
    except yaml.YAMLError as err:
        raise ValueError(_explain(err)) from err
    except (ArithmeticError, LookupError, TypeError, AttributeError, RecursionError) as err:
        msg = "nested too deeply" if isinstance(err, RecursionError) else f"not YAML: {err}"
        raise ValueError(msg) from err


def parse_json(text: str) -> Any:
    """Turn a JSON document into plain values.

    Raises
    ------
    ValueError
        With one line that says what is wrong and where.
    """
    try:
        return json.loads(text, parse_int=_bounded_integer, object_pairs_hook=_distinct_keys)
    except RecursionError as err:
        msg = "nested too deeply"
        raise ValueError(msg) from err
    except json.JSONDecodeError as err:
        msg = f"not JSON from line {err.lineno}, column {err.colno} on"
        raise ValueError(msg) from err


def _distinct_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Refuse a key that is there twice."""
    content = dict(pairs)
    if len(content) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in content if keys.count(key) > 1)
        msg = f"the key {twice[:60]!r} is there twice"
        raise ValueError(msg)
    return content


def _bounded_integer(digits: str) -> int:
    """Read an integer of 64 bits."""
    value = int(digits) if len(digits) <= 20 else _MAX_INTEGER
    if abs(value) >= _MAX_INTEGER:
        msg = f"the integer {digits[:30]} is beyond 64 bits"
        raise ValueError(msg)
    return value


class _PlainLoader(yaml.SafeLoader):
    """The safe loader without what a file of plain values does not need."""

    _depth = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Refuse anchors and aliases."""
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None) is not None:
            problem = f"anchors and aliases (here '{event.anchor}') are not read, write the value out"
            raise yaml.composer.ComposerError(None, None, problem, event.start_mark)
        self._depth += 1
        if self._depth > _DEEPEST:
            # Long before Python's own limit: the cost of a token grows with the depth.
            raise yaml.composer.ComposerError(None, None, "nested too deeply", event.start_mark)
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """Refuse a key that is there twice."""
        seen: set[tuple[str, str]] = set()
        for key, _ in node.value if isinstance(node, yaml.MappingNode) else ():
            if isinstance(key, yaml.ScalarNode):
                if (key.tag, key.value) in seen:
                    problem = f"the key '{key.value}' is there twice"
                    raise yaml.constructor.ConstructorError(None, None, problem, key.start_mark)
                seen.add((key.tag, key.value))
        return super().construct_mapping(node, deep=deep)

    def construct_scalar(self, node: yaml.ScalarNode | yaml.MappingNode) -> str:
        """Refuse halves of characters, which no file and no terminal can show."""
        value: str = super().construct_scalar(node)
        if any("\ud800" <= character <= "\udfff" for character in value):
            problem = f"half a character in {ascii(value)[:60]}"
            raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark)
        return value

    def construct_bounded_int(self, node: yaml.ScalarNode) -> int:
        """Refuse integers beyond 64 bits."""
        value = self.construct_yaml_int(node)
        if abs(value) >= _MAX_INTEGER:
            problem = f"the integer {node.value[:30]} is beyond 64 bits"
            raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark)
        return value


_PlainLoader.add_constructor("tag:yaml.org,2002:int", _PlainLoader.construct_bounded_int)


def _explain(error: yaml.YAMLError) -> str:
    """One line: what is wrong, in which line."""
    mark, problem = getattr(error, "problem_mark", None), getattr(error, "problem", None)
    if problem is None or mark is None:
        return f"not YAML: {' '.join(str(error).split())}"
    context = getattr(error, "context", None)
    words = f"{context} {problem}" if context else problem
    return f"not YAML: {words}, line {mark.line + 1}"
