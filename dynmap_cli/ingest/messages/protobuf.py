"""Protocol Buffers messages by the descriptors that stand beside them: no generated code, no library.

A message is a chain of fields: number and wire type in one varint, then the value (Protocol Buffers documentation,
"Encoding"). An MCAP schema of encoding "protobuf" is a FileDescriptorSet (google/protobuf/descriptor.proto), itself
such a message, whose field numbers are fixed: they are the only ones that stand here.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_MOST_VARINT_BYTES = 10
_DEEPEST = 16

# google.protobuf.FieldDescriptorProto.Type -> little-endian NumPy type, where the wire carries one.
_FIXED_TYPES = {1: "<f8", 2: "<f4", 6: "<u8", 7: "<u4", 15: "<i4", 16: "<i8"}
_STRING, _MESSAGE, _BYTES_TYPE = 9, 11, 12
_ZIGZAG_TYPES, _SIGNED_TYPES = {17, 18}, {3, 5, 14}
_REPEATED = 3


@dataclass(frozen=True, slots=True)
class _Field:
    """A field of a message type: `type_name` has its package, and is "" but for messages and enumerations."""

    name: str
    kind: int
    is_repeated: bool
    type_name: str


Types = dict[str, dict[int, _Field]]


def decode(data: bytes, schema: bytes, name: str) -> Any:
    """A message as attributes, nested messages likewise; repeated numbers are arrays, what is absent has its default.

    Parameters
    ----------
    data : bytes
        The message.
    schema : bytes
        FileDescriptorSet.
    name : str
        Of its type, with package.

    Raises
    ------
    ValueError, LookupError, TypeError
        If message or schema are broken.
    """
    return _message(memoryview(data), _types(schema), name, 0)


def _message(data: memoryview, types: Types, name: str, depth: int) -> Any:
    """One message of a type."""
    if depth > _DEEPEST:
        msg = f"messages nested more than {_DEEPEST} times"
        raise ValueError(msg)
    fields = types[name]
    found: dict[int, list[Any]] = {}
    for number, wire, value in _fields(data):
        if number in fields:
            found.setdefault(number, []).extend(_values(fields[number], wire, value, types, depth))
    content = SimpleNamespace()
    for number, field in fields.items():
        values = found.get(number, [])
        if field.is_repeated:
            setattr(content, field.name, _joined(values, field))
        else:
            setattr(content, field.name, values[-1] if values else _default(field))
    return content


def _values(field: _Field, wire: int, value: Any, types: Types, depth: int) -> list[Any]:
    """What one entry on the wire holds: one value, or an array of a packed field."""
    if field.kind == _MESSAGE and wire == _BYTES:
        return [_message(value, types, field.type_name, depth + 1)]
    if field.kind == _STRING and wire == _BYTES:
        return [bytes(value).decode()]
    if field.kind == _BYTES_TYPE and wire == _BYTES:
        return [bytes(value)]
    if field.kind in _FIXED_TYPES:
        numbers = np.frombuffer(value, dtype=_FIXED_TYPES[field.kind])
        return [numbers] if field.is_repeated else [numbers[0].item()]
    if wire == _BYTES:
        return [_integer(field, number) for number in _packed(value)]
    return [_integer(field, value)]


def _joined(values: list[Any], field: _Field) -> Any:
    """All values of a repeated field."""
    if field.kind in _FIXED_TYPES:
        return np.concatenate(values) if values else np.zeros(0, dtype=_FIXED_TYPES[field.kind])
    return values


def _default(field: _Field) -> Any:
    """What a field is that the wire does not have; None for a message."""
    if field.kind == _MESSAGE:
        return None
    return {_STRING: "", _BYTES_TYPE: b""}.get(field.kind, 0)


def _integer(field: _Field, value: int) -> int:
    """An integer from its varint."""
    if field.kind in _ZIGZAG_TYPES:
        return (value >> 1) ^ -(value & 1)
    return value - (1 << 64) if field.kind in _SIGNED_TYPES and value >> 63 else value


def _packed(data: memoryview) -> Iterator[int]:
    """The varints of a packed field."""
    at = 0
    while at < len(data):
        value, at = _varint(data, at)
        yield value


def _fields(data: memoryview) -> Iterator[tuple[int, int, Any]]:
    """Number, wire type and value of each field: an int for a varint, else its bytes."""
    at = 0
    while at < len(data):
        key, at = _varint(data, at)
        number, wire = key >> 3, key & 7
        if wire == _VARINT:
            value, at = _varint(data, at)
            yield number, wire, value
            continue
        if wire == _BYTES:
            size, at = _varint(data, at)
        elif wire in {_FIXED64, _FIXED32}:
            size = 8 if wire == _FIXED64 else 4
        else:
            msg = f"wire type {wire}"
            raise ValueError(msg)
        if size > len(data) - at:
            msg = f"a field of {size} bytes in {len(data)}"
            raise ValueError(msg)
        yield number, wire, data[at : at + size]
        at += size


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    """An unsigned number, seven bits a byte, the lowest first; and where it ends."""
    value = 0
    for number in range(_MOST_VARINT_BYTES):
        byte = data[at + number]
        value |= (byte & 0x7F) << (7 * number)
        if byte < 0x80:
            return value & (1 << 64) - 1, at + number + 1
    msg = "a number without end"
    raise ValueError(msg)


@functools.lru_cache(maxsize=64)
def _types(schema: bytes) -> Types:
    """All message types of a FileDescriptorSet, by name with package."""
    types: Types = {}
    for number, _, file in _fields(memoryview(schema)):
        if number == 1:
            parts = list(_fields(file))
            package = next((_text(value) for at, _, value in parts if at == 2), "")
            for at, _, value in parts:
                if at == 4:
                    _add_type(types, value, package, 0)
    return types


def _add_type(types: Types, descriptor: memoryview, within: str, depth: int) -> None:
    """Add a DescriptorProto, and those inside it: name 1, field 2, nested_type 3."""
    if depth > _DEEPEST:
        msg = f"types nested more than {_DEEPEST} times"
        raise ValueError(msg)
    parts = list(_fields(descriptor))
    own = next((_text(value) for at, _, value in parts if at == 1), "")
    name = f"{within}.{own}" if within else own
    types[name] = dict(_field(value) for at, _, value in parts if at == 2)
    for at, _, value in parts:
        if at == 3:
            _add_type(types, value, name, depth + 1)


def _field(descriptor: memoryview) -> tuple[int, _Field]:
    """Number and field of a FieldDescriptorProto: name 1, number 3, label 4, type 5, type_name 6."""
    found = {at: value for at, _, value in _fields(descriptor)}
    words = [_text(found.get(at, b"")) for at in (1, 6)]
    return found[3], _Field(words[0], found[5], found.get(4) == _REPEATED, words[1].lstrip("."))


def _text(value: Any) -> str:
    """A string field; a number, of which bytes() would make as many zeros, is none."""
    if isinstance(value, int):
        msg = "a number instead of a name"
        raise ValueError(msg)
    return bytes(value).decode()
