"""Lines of text logs that do not parse: how many, and what is wrong with the first of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from dynmap_cli.ingest.raw.plausible import FARTHEST_M, LATEST_NS, are_coordinates, stamp_of_word
from dynmap_cli.ingest.raw.recording import RawRecording, file_name
from dynmap_cli.ingest.text.decimals import parse_decimals
from dynmap_cli.ingest.text.text_lines import LONGEST_BYTES

_LONGEST_SHOWN = 30


@dataclass(slots=True)
class _Lost:
    """Lines of one kind: how many, and the first of them."""

    count: int
    number: int
    line: bytes


class LostLines:
    """Counts lines that do not parse.

    Parameters
    ----------
    fault_of : callable
        What is wrong with a line, in words; asked once for each kind, as it may take its time.
    """

    def __init__(self, fault_of: Callable[[bytes], str]) -> None:
        self._fault_of = fault_of
        self._kinds: dict[str, _Lost] = {}

    def add(self, kind: str, number: int, line: bytes) -> None:
        """Count a line, of which the number in the file is given; they may come in any order."""
        lost = self._kinds.setdefault(kind, _Lost(0, number, line))
        lost.count += 1
        if number < lost.number:
            lost.number, lost.line = number, line

    def tell(self, recording: RawRecording) -> None:
        """Put counts and reasons into the recording."""
        for kind, lost in self._kinds.items():
            recording.drop_broken(
                f"{kind} line that does not parse; the first is line {lost.number} of {file_name(recording.name)}: "
                f"{self._fault_of(lost.line)}",
                lost.count,
            )


def shown(word: bytes) -> str:
    """A word of a file in quotes, shortened, without characters that a terminal would obey."""
    text = ascii(word[:_LONGEST_SHOWN].decode("latin-1"))
    return f"{text} and so on" if len(word) > _LONGEST_SHOWN else text


def count_of(word: bytes) -> int | None:
    """How many words are announced; None where that is no number, or more than a line can hold."""
    try:
        count = int(word)
    except ValueError:
        return None
    return count if 0 <= count <= LONGEST_BYTES else None


def fault_of_time(word: bytes) -> str:
    """What is wrong with a time in seconds; "" where nothing is."""
    try:
        stamp_of_word(word)
    except ValueError:
        return f"time {shown(word)}; seconds from 0 to {LATEST_NS // 10**9} are allowed"
    return ""


def fault_of_pose(words: Sequence[bytes]) -> str:
    """What is wrong with the first wrong number of poses; "" where nothing is."""
    for word in words:
        if not _is_coordinate(word):
            return f"pose with {shown(word)}; numbers from {-FARTHEST_M:g} to {FARTHEST_M:g} are allowed"
    return ""


def fault_of_readings(words: Sequence[bytes]) -> str:
    """What is wrong with the first reading that is no number; "" where nothing is."""
    if _are_numbers(words):
        return ""
    low, high = 0, len(words)
    while high - low > 1:
        middle = (low + high) // 2
        if _are_numbers(words[low:middle]):
            low = middle
        else:
            high = middle
    allowed = "decimal points, not commas," if b"," in words[low] else "numbers"
    return f"reading {low + 1} is {shown(words[low])}; {allowed} are allowed"


def _is_coordinate(word: bytes) -> bool:
    """Whether a word is a number that a pose may hold."""
    try:
        return _are_numbers([word]) and are_coordinates((float(word),))
    except ValueError:
        return False


def _are_numbers(words: Sequence[bytes]) -> bool:
    """Whether all words are numbers."""
    try:
        return parse_decimals(b" ".join(words)).size == len(words)
    except ValueError:
        return False
