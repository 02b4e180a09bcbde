"""trajectory.tum: `stamp x y z qx qy qz qw`, seconds with nine decimals, metres."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dynmap_cli.domain.poses import Trajectory, wrap_angle
from dynmap_cli.errors import ArtifactError


def format_stamp(stamp_ns: int) -> str:
    """Seconds with nine decimals, exact."""
    sign = "-" if stamp_ns < 0 else ""
    return f"{sign}{abs(stamp_ns) // 10**9}.{abs(stamp_ns) % 10**9:09d}"


def parse_stamp(text: str) -> int:
    """Nanoseconds from decimal seconds, exact to the ninth decimal."""
    whole, _, decimals = text.strip().lstrip("+-").partition(".")
    if "e" in text.lower():
        return round(float(text) * 1e9)
    value = int(whole or "0") * 10**9 + int((decimals + "000000000")[:9])
    return -value if text.strip().startswith("-") else value


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write one line per pose."""
    lines = []
    for stamp, (x, y, yaw) in zip(trajectory.stamps_ns.tolist(), trajectory.poses.tolist(), strict=True):
        qz, qw = np.sin(yaw / 2.0), np.cos(yaw / 2.0)
        lines.append(f"{format_stamp(stamp)} {x:.6f} {y:.6f} 0 0 0 {qz:.9f} {qw:.9f}\n")
    path.write_text("".join(lines), encoding="ascii")


def read_tum(path: Path) -> Trajectory:
    """Read a planar trajectory; lines that start with # are comments.

    Raises
    ------
    ArtifactError
        If the file is missing or a line has not eight numbers.
    """
    stamps: list[int] = []
    rows: list[list[float]] = []
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as err:
        msg = f"{path}: not a readable trajectory ({err}). Expected lines of 'stamp x y z qx qy qz qw'."
        raise ArtifactError(msg) from err
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            stamp, values = parse_stamp(words[0]), [float(word) for word in words[1:]]
        except ValueError:
            values = []
        if len(values) != 7:
            msg = f"{path}:{number}: expected 'stamp x y z qx qy qz qw', found {line[:60]!r}"
            raise ArtifactError(msg)
        stamps.append(stamp)
        rows.append(values)
    table = np.array(rows, dtype=np.float64).reshape(-1, 7)
    qx, qy, qz, qw = table[:, 3], table[:, 4], table[:, 5], table[:, 6]
    yaw = np.arctan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy**2 + qz**2))
    poses = np.column_stack([table[:, 0], table[:, 1], wrap_angle(yaw)])
    return Trajectory(np.array(stamps, dtype=np.int64), poses)
