"""What is in a .zip, also in one that was cut off and so lost the list of its members at the end."""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from dynmap_cli.files.damage import reason
from dynmap_cli.ingest.containers.streams import DECODING_ERRORS, DamagedStreamError, unpacked_part

_MAGIC = b"PK\x03\x04"
_LOCAL = struct.Struct("<4s5H3I2H")
_STORED = 0
_METHODS = {8: "deflate", 12: "bzip2", 93: "zstd"}
_ENCRYPTED, _SIZES_FOLLOW = 1, 8
_IN_64_BITS = 0xFFFF_FFFF
_BLOCK_BYTES = 1 << 12
"""Of a member that fails its checksum zipfile keeps back the last block."""
_ZIP64_EXTRA = 1
_SIZES_64 = struct.Struct("<QQ")
_LARGEST_STEP = 1 << 20
_NAMELESS = "nameless"


@dataclass(frozen=True, slots=True)
class Member:
    """A file in an archive.

    Attributes
    ----------
    name : str
        As it stands there; not to be trusted.
    blocks : callable
        Gives its content; raises DamagedStreamError behind what can be read.
    """

    name: str
    blocks: Callable[[], Iterator[bytes]]


def members_of(archive: zipfile.ZipFile, path: Path) -> list[Member]:
    """Files that a whole archive lists.

    Raises
    ------
    zipfile.BadZipFile
        If the list points to where no file begins.
    """
    found = []
    with path.open("rb") as stream:
        for info in archive.infolist():
            # Of an empty name zipfile cannot tell whether it is that of a folder.
            if not info.filename.endswith("/"):
                found.append(Member(info.filename or _NAMELESS, _reader_of(archive, info, path, stream)))
    return found


def _reader_of(
    archive: zipfile.ZipFile, info: zipfile.ZipInfo, path: Path, stream: IO[bytes]
) -> Callable[[], Iterator[bytes]]:
    """Content of a member that is listed; zipfile reads what is encrypted or compressed in an unusual way."""
    head = b""
    if 0 <= info.header_offset < path.stat().st_size:
        stream.seek(info.header_offset)
        head = stream.read(_LOCAL.size)
    if len(head) < _LOCAL.size or not head.startswith(_MAGIC):
        msg = "the list of files points beside them"
        raise zipfile.BadZipFile(msg)
    is_usual = info.compress_type == _STORED or info.compress_type in _METHODS
    if info.flag_bits & _ENCRYPTED or not is_usual:
        return lambda: _listed(archive, info)
    *_, name_bytes, extra_bytes = _LOCAL.unpack(head)
    start = info.header_offset + _LOCAL.size + name_bytes + extra_bytes
    return _reader(path, start, info.compress_size, info.compress_type, info.CRC)


def _listed(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> Iterator[bytes]:
    """Content of a member."""
    try:
        with archive.open(info) as stream:
            while block := stream.read(_BLOCK_BYTES):
                yield block
    except (*DECODING_ERRORS, zipfile.BadZipFile) as err:
        raise DamagedStreamError(reason(err).partition(" for file")[0]) from err


def members_without_list(path: Path) -> list[Member]:
    """Files of an archive one after the other as they lie in it; the last may be cut off.

    Raises
    ------
    RuntimeError, NotImplementedError
        If a member is encrypted, or compressed in a way that is not known.
    """
    found = []
    with path.open("rb") as stream:
        at: int | None = 0
        while at is not None:
            stream.seek(at)
            head = stream.read(_LOCAL.size)
            if len(head) < _LOCAL.size or not head.startswith(_MAGIC):
                break
            _, _, flags, method, _, _, checksum, packed, whole, name_bytes, extra_bytes = _LOCAL.unpack(head)
            name = stream.read(name_bytes).decode("utf-8", "replace")
            extra = stream.read(extra_bytes)
            start = at + _LOCAL.size + name_bytes + extra_bytes
            if flags & _ENCRYPTED:
                msg = f"'{name}' is encrypted"
                raise RuntimeError(msg)
            if method != _STORED and method not in _METHODS:
                msg = f"'{name}' is compressed in a way that is not known"
                raise NotImplementedError(msg)
            size: int | None = packed
            if _IN_64_BITS in {packed, whole}:
                size = _packed_64(extra)
            if flags & _SIZES_FOLLOW:
                size, checksum = None, 0
            if not name.endswith("/"):
                found.append(Member(name, _reader(path, start, size, method, checksum)))
            at = _next_head(stream, start) if size is None else start + size
    return found


def _packed_64(extra: bytes) -> int | None:
    """Packed size of a member beyond 4 GiB, from its extra fields."""
    at = 0
    while at + 4 <= len(extra):
        kind, size = struct.unpack_from("<HH", extra, at)
        if kind == _ZIP64_EXTRA and size >= _SIZES_64.size and at + 4 + size <= len(extra):
            return int(_SIZES_64.unpack_from(extra, at + 4)[1])
        at += 4 + size
    return None


def _next_head(stream: IO[bytes], start: int) -> int | None:
    """Where the next member begins, behind one that does not say how long it is."""
    stream.seek(start)
    before, kept = b"", start
    while block := stream.read(_LARGEST_STEP):
        text = before + block
        if (at := text.find(_MAGIC)) >= 0:
            return kept + at
        before = text[-(len(_MAGIC) - 1) :]
        kept += len(text) - len(before)
    return None


def _reader(
    path: Path, start: int, size: int | None, method: int, checksum: int
) -> Callable[[], Iterator[bytes]]:
    """Content of a member that lies at *start*."""

    def blocks() -> Iterator[bytes]:
        found, n_bytes = 0, 0
        with path.open("rb") as stream:
            stream.seek(start)
            parts = unpacked_part(stream, _METHODS[method], size) if method else _stored(stream, size)
            for part in parts:
                found, n_bytes = zlib.crc32(part, found), n_bytes + len(part)
                yield part
        if method == _STORED and size is not None and n_bytes < size:
            msg = "it ends in the middle"
            raise DamagedStreamError(msg)
        if checksum not in {0, found}:
            msg = "Bad CRC-32"
            raise DamagedStreamError(msg)

    return blocks


def _stored(stream: IO[bytes], size: int | None) -> Iterator[bytes]:
    """Bytes that are not compressed."""
    left = size
    while block := stream.read(_BLOCK_BYTES if left is None else min(_BLOCK_BYTES, left)):
        left = None if left is None else left - len(block)
        yield block
