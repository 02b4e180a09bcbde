"""trajectory.tum: `stamp x y z qx qy qz qw`, seconds with nine decimals, metres."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from dynmap_cli.arrays import F64, I64
from dynmap_cli.domain.poses import Trajectory, wrap_angle
from dynmap_cli.errors import ArtifactError
from dynmap_cli.files.damage import reason
from dynmap_cli.files.documents import MAX_TABLE_BYTES, read_text

_TOO_LATE_NS = 2**63
_LINES_AT_ONCE, _CHARACTERS_AT_ONCE = 10_000, 1_000_000
_MAX_STAMP_S = 1e10
_FARTHEST = 1e9


def format_stamp(stamp_ns: int) -> str:
    """Seconds with nine decimals, exact."""
    sign = "-" if stamp_ns < 0 else ""
    return f"{sign}{abs(stamp_ns) // 10**9}.{abs(stamp_ns) % 10**9:09d}"


def parse_stamp(text: str) -> int:
    """Nanoseconds from decimal seconds, exact to the ninth decimal.

    Raises
    ------
    ValueError
        If the text is no number, or the stamp does not fit into 64 bits.
    """
    whole, _, decimals = text.partition(".")
    if not text.isascii() or "_" in text:
        msg = f"{text[:30]!r} is no time in seconds"
        raise ValueError(msg)
    if whole.isdecimal() and decimals.isdecimal():
        value = int(whole) * 10**9 + int((decimals + "000000000")[:9])
    else:
        value = _parse_unusual_stamp(text)
    if abs(value) >= _TOO_LATE_NS:
        msg = f"stamp {text[:30]} does not fit into 64 bits of nanoseconds"
        raise ValueError(msg)
    return value


def _parse_unusual_stamp(text: str) -> int:
    """Nanoseconds from decimal seconds with a sign, an exponent or blanks, or without decimals."""
    whole, _, decimals = text.strip().lstrip("+-").partition(".")
    if "e" in text.lower():
        seconds = float(text)
        return round(seconds * 1e9) if abs(seconds) < _MAX_STAMP_S else _TOO_LATE_NS
    value = int(whole or "0") * 10**9 + int((decimals + "000000000")[:9])
    return -value if text.strip().startswith("-") else value


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write one line per pose."""
    with path.open("w", encoding="ascii") as stream:
        for first in range(0, trajectory.stamps_ns.size, _LINES_AT_ONCE):
            rows = slice(first, first + _LINES_AT_ONCE)
            stamps, poses = trajectory.stamps_ns[rows].tolist(), trajectory.poses[rows]
            halves = np.column_stack([np.sin(poses[:, 2] / 2.0), np.cos(poses[:, 2] / 2.0)])
            for stamp, (x, y), (qz, qw) in zip(stamps, poses[:, :2].tolist(), halves.tolist(), strict=True):
                stream.write(f"{format_stamp(stamp)} {x:.6f} {y:.6f} 0 0 0 {qz:.9f} {qw:.9f}\n")


def read_tum(path: Path) -> Trajectory:
    """Read a planar trajectory; lines that start with # are comments.

    Raises
    ------
    ArtifactError
        If the file is missing or a line has not eight numbers; NaN says that there is no pose.
    """
    try:
        text = read_text(path, MAX_TABLE_BYTES)
    except (OSError, ValueError) as err:
        msg = (
            f"{path}: not a readable trajectory ({reason(err)}). Expected lines of 'stamp x y z qx qy qz qw'."
        )
        raise ArtifactError(msg) from err
    parts, n_lines = [], 0
    for lines in _blocks_of_lines(text):
        parts.append(_parsed(path, lines, n_lines))
        n_lines += len(lines)
    stamps_ns = np.concatenate([stamps for stamps, _ in parts] or [np.zeros(0, dtype=np.int64)])
    return Trajectory(stamps_ns, np.concatenate([poses for _, poses in parts] or [np.zeros((0, 3))]))


def _blocks_of_lines(text: str) -> Iterator[list[str]]:
    """Some lines of a text at a time, for a long one has millions."""
    start = 0
    while start < len(text):
        end = text.find("\n", start + _CHARACTERS_AT_ONCE) + 1 or len(text)
        yield text[start:end].splitlines()
        start = end


def _parsed(path: Path, lines: list[str], first: int) -> tuple[I64, F64]:
    """Stamps (n,) and poses (n, 3) of some lines, the first of which has that number."""
    stamps: list[int] = []
    values: list[float] = []
    numbers: list[int] = []
    for number, line in enumerate(lines):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            if "_" in line or not line.isascii():
                raise _not_a_pose(path, number, line)
            stamps.append(parse_stamp(words[0]))
            values.extend(map(float, words[1:]))
        except ValueError:
            values.clear()
        numbers.append(number)
        if len(values) != 7 * len(numbers):
            raise _not_a_pose(path, first + number, line)
    table = np.array(values, dtype=np.float64).reshape(-1, 7)
    too_far = np.flatnonzero((np.abs(table) > _FARTHEST).any(axis=1))
    if too_far.size:
        number = numbers[too_far[0]]
        raise _not_a_pose(path, first + number, lines[number])
    qx, qy, qz, qw = table[:, 3], table[:, 4], table[:, 5], table[:, 6]
    yaw = np.arctan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy**2 + qz**2))
    poses = np.column_stack([table[:, 0], table[:, 1], wrap_angle(yaw)])
    return np.array(stamps, dtype=np.int64), poses


def _not_a_pose(path: Path, number: int, line: str) -> ArtifactError:
    """What is wrong with a line; lines count from 0 here, from 1 in the message."""
    return ArtifactError(f"{path}:{number + 1}: expected 'stamp x y z qx qy qz qw', found {line[:80]!r}")
