"""Files taken apart and put together again, so that what they hold is damaged and not their frames and checksums."""

from __future__ import annotations

import io
import sqlite3
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

_MCAP_MAGIC = b"\x89MCAP0\r\n"
_FRAME = struct.Struct("<BQ")
_SCHEMA, _DATA_END, _FOOTER = 3, 15, 2
_LOCAL, _CENTRAL, _END = struct.Struct("<4s5H3I2H"), struct.Struct("<4s6H3I5H2I"), struct.Struct("<4s4H2IH")
_COLUMNS = {
    "schema": "schema_version, ros_distro",
    "metadata": "id, metadata_version, metadata",
    "topics": "id, name, type, serialization_format, offered_qos_profiles, type_description_hash",
    "message_definitions": "id, topic_type, encoding, encoded_message_definition, type_description_hash",
    "messages": "id, topic_id, timestamp, data",
}


class Parts(NamedTuple):
    """How a kind of file is taken apart.

    Attributes
    ----------
    suffixes : tuple of str
        Of the files that are.
    take : callable
        Bytes of a file -> its parts by name.
    put : callable
        The way back.
    """

    suffixes: tuple[str, ...]
    take: Callable[[bytes], dict[str, bytes]]
    put: Callable[[Mapping[str, bytes]], bytes]


def _unzipped(data: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {member: archive.read(member) for member in archive.namelist()}


def _zipped(members: Mapping[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return stream.getvalue()


def _listed(data: bytes) -> dict[str, bytes]:
    """Members of a .zip: the name of each, method and flags, and content."""
    found = {}
    for number, (name, content) in enumerate(_unzipped(data).items()):
        found |= {
            f"{number}.name": name.encode(),
            f"{number}.how": b"\x00\x00\x00\x00",
            f"{number}.data": content,
        }
    return found


def _put_listed(parts: Mapping[str, bytes]) -> bytes:
    """A .zip, written by hand: libraries would write none with odd names, methods and flags."""
    local, central = b"", b""
    numbers = sorted({int(name.split(".")[0]) for name in parts})
    for number in numbers:
        name, content = parts[f"{number}.name"][:60_000], parts[f"{number}.data"]
        method, flags = struct.unpack("<HH", parts[f"{number}.how"].ljust(4, b"\x00")[:4])
        packed = zlib.compress(content)[2:-4] if method == zipfile.ZIP_DEFLATED else content
        middle = (method, 0, 0, zlib.crc32(content), len(packed), len(content), len(name), 0)
        central += _CENTRAL.pack(b"PK\x01\x02", 20, 20, flags, *middle, 0, 0, 0, 0, len(local)) + name
        local += _LOCAL.pack(b"PK\x03\x04", 20, flags, *middle) + name + packed
    end = _END.pack(b"PK\x05\x06", 0, 0, len(numbers), len(numbers), len(central), len(local), 0)
    return local + central + end


def _records(data: bytes) -> dict[str, bytes]:
    """Records of an MCAP file by number: kind and content."""
    found, at = {}, len(_MCAP_MAGIC)
    while at < len(data) - len(_MCAP_MAGIC):
        kind, size = _FRAME.unpack_from(data, at)
        found[f"{len(found):04d}"] = bytes([kind]) + data[at + _FRAME.size : at + _FRAME.size + size]
        at += _FRAME.size + size
    return found


def _put_records(parts: Mapping[str, bytes]) -> bytes:
    """The file with whole frames; the footer says where the summary lies, and has no checksum."""
    out, summary_start = _MCAP_MAGIC, 0
    for _, record in sorted(parts.items()):
        kind, content = (record or b"\x00")[0], record[1:]
        if kind == _FOOTER and len(content) == 20:
            content = struct.pack("<Q", summary_start) + content[8:16] + bytes(4)
        out += _FRAME.pack(kind, len(content)) + content
        if kind == _DATA_END:
            summary_start = len(out)
    return out + _MCAP_MAGIC


def _rows(data: bytes) -> dict[str, bytes]:
    """Values in the tables of a .db3 by table, row and column: kind and content."""
    found = {}
    with closing(sqlite3.connect(":memory:")) as connection:
        connection.deserialize(data)
        for table, columns in _COLUMNS.items():
            for number, row in enumerate(connection.execute(f"SELECT {columns} FROM {table}")):
                for column, value in enumerate(row):
                    kind = {int: b"i", str: b"t", bytes: b"b"}.get(type(value), b"n")
                    content = value if isinstance(value, bytes) else str(value).encode()
                    found[f"{table}/{number:04d}/{column}"] = kind + content
    return found


def _put_rows(parts: Mapping[str, bytes]) -> bytes:
    """A .db3 whose tables take any value."""
    with closing(sqlite3.connect(":memory:")) as connection:
        for table, columns in _COLUMNS.items():
            connection.execute(
                f"CREATE TABLE {table}({columns.replace('id,', 'id INTEGER PRIMARY KEY,', 1)})"
            )
        connection.execute("CREATE INDEX timestamp_idx ON messages (timestamp ASC)")
        rows: dict[tuple[str, str], list[bytes]] = {}
        for name, value in sorted(parts.items()):
            table, number, _ = name.split("/")
            rows.setdefault((table, number), []).append(value)
        for (table, _), values in rows.items():
            marks = ",".join("CAST(? AS TEXT)" if value[:1] == b"t" else "?" for value in values)
            bound = [_value(value) for value in values]
            try:
                connection.execute(f"INSERT INTO {table} VALUES ({marks})", bound)
            except sqlite3.Error:
                # A number that is none, or is there already: another one.
                connection.execute(f"INSERT INTO {table} VALUES ({marks})", [None, *bound[1:]])
        connection.commit()
        return bytes(connection.serialize())


def _value(part: bytes) -> int | float | bytes | None:
    """A value from its kind and content; text is bound as bytes, for it may be none."""
    kind, content = part[:1], part[1:]
    if kind in {b"t", b"b"}:
        return content
    try:
        number = float(content) if kind == b"f" else int(content)
    except ValueError:
        return None
    return number if abs(number) < 1 << 63 else float(number % 1e300)


def _definitions(data: bytes) -> dict[str, bytes]:
    """Records of an MCAP file, those of schemas in four parts; their copies in the summary only by their number."""
    found, known = {}, {}
    for name, record in _records(data).items():
        if record[0] != _SCHEMA:
            found[name] = record
        elif record in known:
            found[f"{name}.same"] = known[record].encode()
        else:
            known[record] = name
            found |= {f"{name}.{place}": part for place, part in enumerate(_strings(record))}
    return found


def _strings(record: bytes) -> list[bytes]:
    """Number, name, encoding and definition of a schema."""
    found, at = [record[1:3]], 3
    for _ in range(3):
        (size,) = struct.unpack_from("<I", record, at)
        found.append(record[at + 4 : at + 4 + size])
        at += 4 + size
    return found


def _put_definitions(parts: Mapping[str, bytes]) -> bytes:
    """The file with these schemas, in its data and in its summary."""
    records = {name: part for name, part in parts.items() if "." not in name}
    for name in (name.removesuffix(".0") for name in parts if name.endswith(".0")):
        first, *texts = (parts[f"{name}.{place}"] for place in range(4))
        written = b"".join(struct.pack("<I", len(text)) + text for text in texts)
        records[name] = bytes([_SCHEMA]) + first.ljust(2, b"\x00")[:2] + written
    for name, number in parts.items():
        if name.endswith(".same"):
            records[name.removesuffix(".same")] = records.get(number.decode("latin-1"), bytes([_SCHEMA]))
    return _put_records(records)


PARTS = {
    "inside": Parts((".zip", ".npz"), _unzipped, _zipped),
    "members": Parts((".zip",), _listed, _put_listed),
    "records": Parts((".mcap",), _records, _put_records),
    "definitions": Parts((".mcap",), _definitions, _put_definitions),
    "rows": Parts((".db3",), _rows, _put_rows),
}


def taken_apart(kind: str, name: str, data: bytes) -> dict[str, bytes]:
    """Parts of a file as `file!part`; the file itself where it is not of that kind."""
    if not kind or Path(name).suffix not in PARTS[kind].suffixes:
        return {name: data}
    return {f"{name}!{part}": content for part, content in PARTS[kind].take(data).items()}
