"""A zip archive that somebody else may have written, or a `ValueError` that names the member.

Members are read in memory and nowhere else, so that no name leads out of the archive; still an archive with such names,
or with two members of one name, was not made by dynmap and is refused.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import IO

from dynmap_cli.files.plain_values import said

_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_MOST_MEMBERS = 100_000
_MOST_UNPACKED_PER_BYTE = 1100
"""Deflate cannot do more; a file that says so lies."""
_SHORT_BYTES = 4096
_DAMAGE = (zipfile.BadZipFile, zlib.error, EOFError, struct.error, RuntimeError)


class ZipArchive:
    """An open archive whose members have been looked over.

    Raises
    ------
    OSError, ValueError
        If it is missing, no zip archive, or holds members of a kind that dynmap does not write.
    """

    def __init__(self, path: Path) -> None:
        try:
            self._archive = zipfile.ZipFile(path)
        except (
            zipfile.BadZipFile,
            struct.error,
            NotImplementedError,
            UnicodeDecodeError,
            OverflowError,
        ) as err:
            msg = "it is no zip archive, or its list of members is cut off or damaged"
            raise ValueError(msg) from err
        try:
            self._members = _checked(self._archive.infolist())
        except ValueError:
            self._archive.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._archive.close()

    def member(self, name: str, max_bytes: int) -> bytes:
        """Content of a member of at most so many bytes; raises ValueError."""
        with self.stream(name, max_bytes) as (stream, size):
            content = stream.read(size + 1)
        if len(content) != size:
            msg = f"{name} unpacks to {len(content)} bytes, the archive says {size}"
            raise ValueError(msg)
        return content

    @contextmanager
    def stream(self, name: str, max_bytes: int) -> Iterator[tuple[IO[bytes], int]]:
        """A member of at most so many bytes to read from, and its size; raises ValueError."""
        info = self._members.get(name)
        if info is None:
            msg = f"{said(name)} is missing in it"
            raise ValueError(msg)
        most = min(max_bytes, _MOST_UNPACKED_PER_BYTE * info.compress_size + _SHORT_BYTES)
        if info.file_size > most:
            msg = f"{name} unpacks to {info.file_size} bytes, at most {most} are allowed"
            raise ValueError(msg)
        try:
            with self._archive.open(info) as stream:
                yield stream, info.file_size
        except _DAMAGE as err:
            msg = f"{name} is damaged: its bytes do not unpack to what its checksum says"
            raise ValueError(msg) from err

    def names(self) -> list[str]:
        """Names of the members, in their order."""
        return list(self._members)

    def __contains__(self, name: str) -> bool:
        """Whether there is such a member."""
        return name in self._members


def _checked(members: list[zipfile.ZipInfo]) -> dict[str, zipfile.ZipInfo]:
    """Members by name; refuses what dynmap does not write."""
    if len(members) > _MOST_MEMBERS:
        msg = f"it has {len(members)} members, at most {_MOST_MEMBERS} are allowed"
        raise ValueError(msg)
    found: dict[str, zipfile.ZipInfo] = {}
    for info in members:
        name = info.filename
        complaint = _complaint(info)
        if name in found:
            complaint = "is there twice"
        if complaint:
            msg = f"member {said(name)} {complaint}"
            raise ValueError(msg)
        found[name] = info
    return found


def _complaint(info: zipfile.ZipInfo) -> str | None:
    """What a member is that none may be."""
    name = info.filename
    if not name.isprintable() or "\\" in name:
        return "has a name with control characters or backslashes"
    if PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts:
        return "has a name that leads out of the archive"
    if info.flag_bits & 0x1:
        return "is encrypted"
    if info.compress_type not in _METHODS:
        return f"is packed by method {info.compress_type}, only stored and deflated ones are read"
    return None
