"""Small damages to a file: wrong bytes, cuts, holes, repeated parts, numbers and words that nobody expects."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from hypothesis import strategies as st

_WORD = re.compile(rb"[A-Za-z_][\w./-]*|-?\d[\d.eE+-]*")
ODD_WORDS = (
    b"nan", b"inf", b"-inf", b".nan", b".inf", b"1e308", b"1e999", b"-1", b"0", b"1e-320", b"99999999999999999999",
    b"9223372036854775807", b"4294967296", b"0.0000001", b"1e9", b"null", b"~", b"true", b"[]", b"{}", b"[[1]]", b"''",
    b"&a [*a]", b"!!python/object:os.system", b"- -", b": :", b"2020-01-01", b"../../x", b"/dev/zero", b"\xff\xfe",
    b"\xed\xa0\x80", b"\x00", b"\n", b"(((((", b"[" * 2000, b"9" * 5000,
    b"\xef\xbb\xbf", b"\r\n", b"\nsensor_msgs/LaserScan[] more\n", b"\nLaserScan[3] more\n", b"float64[4294967296]",
    b"\n" + b"=" * 80 + b"\nMSG: std_msgs/Header\nstd_msgs/Header[] more\n", b"int32 A=1\n" * 900, b"string<=5",
)  # fmt: skip
ODD_NUMBERS = (
    0,
    1,
    0x7F,
    0x80,
    0xFF,
    0x7FFF,
    0xFFFF,
    0x7FFF_FFFF,
    0x8000_0000,
    0xFFFF_FFFF,
    1 << 40,
    (1 << 63) - 1,
)


class Edit(NamedTuple):
    """One damage.

    Attributes
    ----------
    kind : str
        "flip", "write", "cut", "insert", "delete", "copy", "zeros" or "word".
    at : int
        Where, in bytes; for "word" which of the words and numbers of the text.
    data : bytes
        What is written; for "flip" the bits that change.
    length : int
        How many bytes are taken away, repeated or zeroed.
    """

    kind: str
    at: int
    data: bytes = b""
    length: int = 0


def damaged(data: bytes, edits: Sequence[Edit]) -> bytes:
    """The bytes after all damages, one after the other."""
    for edit in edits:
        data = _damaged_once(data, edit)
    return data


def _damaged_once(data: bytes, edit: Edit) -> bytes:
    """The bytes after one damage; places beyond the end count from the start again."""
    if not data:
        return edit.data
    if edit.kind == "word":
        words = list(_WORD.finditer(data)) or [re.match(b"", data)]
        word = words[edit.at % len(words)]
        return data[: word.start()] + edit.data + data[word.end() :]
    at = edit.at % len(data)
    after = data[at:]
    changed = {
        "flip": lambda: bytes([after[0] ^ edit.data[0]]) + after[1:],
        "write": lambda: edit.data + after[len(edit.data) :],
        "cut": bytes,
        "insert": lambda: edit.data + after,
        "delete": lambda: after[edit.length :],
        "copy": lambda: after[: edit.length] + after,
        "zeros": lambda: bytes(min(edit.length, len(after))) + after[edit.length :],
    }
    return data[:at] + changed[edit.kind]()


def edits(n_bytes: int) -> st.SearchStrategy[list[Edit]]:
    """One to four damages of a file of that size."""
    at = st.integers(0, max(n_bytes - 1, 0))
    length = st.integers(1, 64) | st.integers(1, max(n_bytes, 1))
    numbers = st.builds(
        lambda value, width, order: (value % (1 << 8 * width)).to_bytes(width, order),
        st.sampled_from(ODD_NUMBERS),
        st.sampled_from((1, 2, 4, 8)),
        st.sampled_from(("little", "big")),
    )
    mask = st.sampled_from([bytes([1 << bit]) for bit in range(8)]) | st.just(b"\xff")
    data = numbers | st.binary(min_size=1, max_size=16)
    one = st.one_of(
        st.builds(lambda at, mask: Edit("flip", at, mask), at, mask),
        st.builds(lambda at, data: Edit("write", at, data), at, data),
        st.builds(lambda at: Edit("cut", at), at),
        st.builds(lambda at, data: Edit("insert", at, data), at, data),
        st.builds(lambda at, length: Edit("delete", at, b"", length), at, length),
        st.builds(lambda at, length: Edit("copy", at, b"", length), at, length),
        st.just(Edit("copy", 0, b"", max(n_bytes, 1))),
        st.builds(lambda at, length: Edit("zeros", at, b"", length), at, length),
        st.builds(lambda at, word: Edit("word", at, word), at, st.sampled_from(ODD_WORDS)),
    )
    return st.lists(one, min_size=1, max_size=4)
