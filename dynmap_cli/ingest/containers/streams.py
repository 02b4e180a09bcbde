"""Compressed files, block by block: what can be unpacked of a damaged one comes before the complaint."""

from __future__ import annotations

import bz2
import lzma
import shutil
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

import zstandard

from dynmap_cli.errors import LogError
from dynmap_cli.files.damage import reason

STREAM_KINDS = ("gzip", "bzip2", "xz", "zstd")
DECODING_ERRORS = (
    OSError,
    EOFError,
    ValueError,
    MemoryError,
    zlib.error,
    lzma.LZMAError,
    zstandard.ZstdError,
)
_PIECE_BYTES, _BLOCK_BYTES = 1 << 14, 1 << 16
_PIECE_ZSTD_BYTES = 1 << 10
"""One KiB of zstd unpacks to 32 MiB at most; the others give no more than is asked for at a time."""
_WATCHED_BYTES = 1 << 20
_MOST_XZ_BYTES = 1 << 28
"""Memory for the dictionary; `xz -9` asks for 65 MiB."""
_GZIP, _RAW_DEFLATE = 16 + zlib.MAX_WBITS, -zlib.MAX_WBITS
_DECODERS: dict[str, Callable[[], Any]] = {
    "gzip": lambda: zlib.decompressobj(_GZIP),
    "deflate": lambda: zlib.decompressobj(_RAW_DEFLATE),
    "bzip2": bz2.BZ2Decompressor,
    "xz": lambda: lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=_MOST_XZ_BYTES),
    "zstd": lambda: zstandard.ZstdDecompressor().decompressobj(),
}


class DamagedStreamError(Exception):
    """A stream that is cut off or has wrong bytes; what could be unpacked was passed on before."""


class CutStreamError(DamagedStreamError):
    """A stream that ends in the middle."""


def unpacked_file(path: Path, kind: str) -> Iterator[bytes]:
    """Content of a file of one of `STREAM_KINDS`, also of several streams one behind the other.

    Raises
    ------
    DamagedStreamError
        At the end, if it is cut off or damaged.
    """
    with path.open("rb") as stream:
        yield from _unpacked(stream, kind, None, is_single=False)


def packed_head(path: Path, kind: str, n_bytes: int) -> bytes:
    """The first bytes that a file of one of `STREAM_KINDS` unpacks to; as many as can be had of a damaged one."""
    head = b""
    with suppress(DamagedStreamError):
        for block in unpacked_file(path, kind):
            head += block
            if len(head) >= n_bytes:
                break
    return head[:n_bytes]


def unpacked_part(stream: IO[bytes], kind: str, n_bytes: int | None) -> Iterator[bytes]:
    """Content of one compressed stream (also "deflate") inside a file, of *n_bytes*, or up to its own end."""
    yield from _unpacked(stream, kind, n_bytes, is_single=True)


def _unpacked(stream: IO[bytes], kind: str, n_bytes: int | None, *, is_single: bool) -> Iterator[bytes]:
    """Content of a stream from where the file stands."""
    start = stream.tell()
    given = taken = 0
    try:
        for n_taken, block in _blocks(_pieces(stream, kind, n_bytes), kind, is_single=is_single):
            taken = n_taken
            given += len(block)
            yield block
    except CutStreamError:
        raise
    except DamagedStreamError:
        # A decoder keeps back what came out of the piece with the fault: once more, that piece byte by byte.
        stream.seek(start)
        at = 0
        for _, block in _blocks(_pieces(stream, kind, n_bytes, fine_from=taken), kind, is_single=is_single):
            yield block[max(given - at, 0) :]
            at += len(block)
        raise


def _pieces(
    stream: IO[bytes], kind: str, n_bytes: int | None, fine_from: int | None = None
) -> Iterator[bytes]:
    """Bytes of a file in small pieces, from *fine_from* on one piece long byte by byte."""
    size = _PIECE_ZSTD_BYTES if kind == "zstd" else _PIECE_BYTES
    at = 0
    while True:
        piece = stream.read(size if n_bytes is None else min(size, n_bytes - at))
        if not piece:
            return
        if fine_from is None or at < fine_from:
            yield piece
        else:
            yield from (piece[k : k + 1] for k in range(len(piece)))
        at += len(piece)


def _blocks(pieces: Iterator[bytes], kind: str, *, is_single: bool) -> Iterator[tuple[int, bytes]]:
    """How many bytes were taken before a piece, and the blocks that come out of it."""
    decoder = _DECODERS[kind]()
    taken = 0
    try:
        for piece in pieces:
            rest = piece
            while rest:
                if decoder.eof:
                    # Between streams there may be zeros.
                    rest = b"" if is_single else rest.lstrip(b"\0")
                    if not rest:
                        break
                    decoder = _DECODERS[kind]()
                for block in _decoded(decoder, rest, kind):
                    yield taken, block
                rest = decoder.unused_data if decoder.eof else b""
            if is_single and decoder.eof:
                return
            taken += len(piece)
    except DECODING_ERRORS as err:
        raise DamagedStreamError(reason(err)) from err
    if not decoder.eof:
        msg = "it ends in the middle"
        raise CutStreamError(msg)


def _decoded(decoder: Any, piece: bytes, kind: str) -> Iterator[bytes]:
    """What a piece unpacks to, in blocks of bounded size."""
    if kind == "zstd":
        yield decoder.decompress(piece)
        return
    block = decoder.decompress(piece, _BLOCK_BYTES)
    yield block
    if kind in {"gzip", "deflate"}:
        while not decoder.eof and (decoder.unconsumed_tail or len(block) == _BLOCK_BYTES):
            block = decoder.decompress(decoder.unconsumed_tail, _BLOCK_BYTES)
            yield block
        return
    while not (decoder.eof or decoder.needs_input):
        yield decoder.decompress(b"", _BLOCK_BYTES)


def copy_limited(blocks: Iterator[bytes], target: Path, limit_bytes: int, name: str) -> tuple[int, str]:
    """Copy blocks to a file; stops at the limit and before the disk is full.

    Returns how many bytes there were, and what is wrong with the blocks, "" where they are whole.
    """
    copied = watched = 0
    free = shutil.disk_usage(target.parent).free
    with target.open("wb") as out:
        try:
            for block in blocks:
                copied += len(block)
                watched += len(block)
                if watched >= _WATCHED_BYTES:
                    free, watched = shutil.disk_usage(target.parent).free, 0
                if copied > limit_bytes or free < _WATCHED_BYTES:
                    msg = (
                        f"{name}: unpacks to more than {limit_bytes / 2**30:.1f} GiB or than the disk holds. "
                        "Unpack it yourself or raise ingest.max_unpacked_gib."
                    )
                    raise LogError(msg)
                out.write(block)
        except DamagedStreamError as err:
            return copied, str(err)
    return copied, ""
