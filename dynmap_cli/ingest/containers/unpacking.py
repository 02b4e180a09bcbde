"""Blocks of compressed messages: as much of them as can be had, and never more than is sane."""

from __future__ import annotations

import bz2
import mmap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lz4.frame
import zstandard

_PIECE_BYTES = 1 << 10
MOST_UNPACKED = 1 << 28
"""Small pieces, for a few bytes can unpack to millions, and no more than a recorder puts into a block."""
HELD_BYTES = 1 << 26
"""As much of a file is read before it is given back."""
_DECODERS: dict[str, Callable[[], Any]] = {
    "bz2": bz2.BZ2Decompressor,
    "lz4": lz4.frame.LZ4FrameDecompressor,
    "zstd": lambda: zstandard.ZstdDecompressor().decompressobj(),
}


_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


def view_of(path: Path) -> memoryview:
    """The bytes of a file, which are not read before they are looked at."""
    with path.open("rb") as stream:
        # An empty file cannot be mapped.
        is_empty = path.stat().st_size == 0
        return memoryview(b"" if is_empty else mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ))


def give_back(view: memoryview) -> None:
    """Take what was read of a file out of memory; it is read again where it is looked at."""
    if isinstance(view.obj, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
        view.obj.madvise(mmap.MADV_DONTNEED)


def unpacked_message(data: bytes) -> bytes:
    """A message as it was sent: rosbag2 may compress each by itself, and only the metadata of the folder say so.

    No message in CDR begins as zstd does, for its first byte is 0.
    """
    if bytes(data[: len(_ZSTD_MAGIC)]) != _ZSTD_MAGIC:
        return data
    content, is_whole = unpack(memoryview(data), "zstd")
    return bytes(content) if is_whole else data


def unpack_whole(data: bytes, compression: str) -> bytes:
    """The content of a whole block, of bounded size; as fast as the libraries are.

    Raises
    ------
    ValueError
        If it is larger, or not whole.
    """
    if compression == "zstd" and 0 <= zstandard.frame_content_size(data) <= MOST_UNPACKED:
        return zstandard.ZstdDecompressor().decompress(data)
    if compression in {"bz2", "lz4"}:
        decoder = _DECODERS[compression]()
        content = bytes(decoder.decompress(bytes(data), MOST_UNPACKED))
        is_whole = bool(decoder.eof)
    else:
        view, is_whole = unpack(memoryview(data), compression)
        content = bytes(view if is_whole else b"")
    if not is_whole:
        msg = f"a block of messages is not whole, or unpacks to more than {MOST_UNPACKED >> 20} MiB"
        raise ValueError(msg)
    return content


def unpack(data: memoryview, compression: str) -> tuple[memoryview, bool]:
    """The content of a block, and whether it is whole; what was unpacked before a fault is kept.

    Raises
    ------
    ValueError
        If the compression is not known.
    """
    if compression in {"", "none"}:
        return data, True
    if compression not in _DECODERS:
        msg = f"unknown compression '{compression[:20]}'"
        raise ValueError(msg)
    decoder = _DECODERS[compression]()
    content = bytearray()
    for start in range(0, len(data), _PIECE_BYTES):
        if decoder.eof:
            break
        try:
            piece = bytes(data[start : start + _PIECE_BYTES])
            # The decoder of zstd knows no bound; one KiB of it unpacks to 32 MiB at most.
            bound = () if compression == "zstd" else (MOST_UNPACKED + 1 - len(content),)
            content += decoder.decompress(piece, *bound)
        except (OSError, RuntimeError, EOFError, ValueError, MemoryError, zstandard.ZstdError):
            return memoryview(content).toreadonly(), False
        if len(content) > MOST_UNPACKED:
            return memoryview(content).toreadonly(), False
    return memoryview(content).toreadonly(), bool(decoder.eof)
