"""Recordings of robots without a date: every clock starts near zero, so stamps cannot tell which drive came first."""

from __future__ import annotations

from collections.abc import Sequence

from dynmap_cli.ingest.raw.recording import RawRecording

UNDATED_BEFORE_NS = 10 * 365 * 86_400 * 10**9
"""Robots whose clock shows a time before 1980 do not know the date."""
_APART_S = 1.0


def part_clocks(recordings: Sequence[RawRecording], max_gap_s: float) -> None:
    """Move the stamps of recordings without a date that overlap: each comes after those given before it.

    Parameters
    ----------
    recordings : sequence of RawRecording
        In the order given; a warning is added to those that are moved.
    max_gap_s : float
        So long, and a little, lies between them, so that they are drives of their own.
    """
    before: tuple[str, int] | None = None
    for recording in recordings:
        first, last = recording.span_ns
        if first >= UNDATED_BEFORE_NS:
            continue
        if before is not None and first <= before[1]:
            shift = before[1] - first + round((max_gap_s + _APART_S) * 1e9)
            _move(recording, shift)
            recording.warnings.append(
                f"{recording.name}: its stamps have no date and overlap with those of {before[0]}; taken as made after "
                f"it, as given: {shift * 1e-9:.3f} s were added to its stamps"
            )
            last += shift
        before = recording.name, max(last, before[1] if before else last)


def _move(recording: RawRecording, shift_ns: int) -> None:
    """Add a time to all stamps of a recording."""
    for laser in recording.lasers.values():
        laser.stamps_ns = laser.stamps_ns + shift_ns
        laser.logged_ns = laser.logged_ns + shift_ns
    for odometry in recording.odometry.values():
        odometry.stamps_ns = odometry.stamps_ns + shift_ns
    for transform in recording.transforms.values():
        transform.stamps_ns = transform.stamps_ns + shift_ns
