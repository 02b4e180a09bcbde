"""Lasers and odometry that are stamped by clocks which differ: put on the clock of the laser by the times of recording.

Between its stamp and its recording each message takes about as long as the one before. Where that delay differs by more
than a second between two sources, and hardly varies within each, one clock is not that of the other; a few seconds may
also be a slow program, so there the turns of the sweeps decide.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dynmap_cli.arrays import I64
from dynmap_cli.ingest.choices.robot_frames import GLOBAL_FRAMES, last_name
from dynmap_cli.ingest.choices.tracks import Track, moving_tracks, yaws_at
from dynmap_cli.ingest.raw.laser import RawLaser
from dynmap_cli.ingest.raw.recording import RawRecording, file_name
from dynmap_cli.ingest.seen_motion.agreement import Agreement, agreement
from dynmap_cli.ingest.seen_motion.turns import ReferenceLaser, ScanTurns

Source = RawLaser | Track
_LEAST_APART_S = 1.0
_MOST_SPREAD_S, _SPREAD_QUANTILES = 1.0, (0.1, 0.9)
_MOST_DELAYS = 1 << 17
_CLEARLY = 0.7


def align_clocks(recording: RawRecording, reference: ReferenceLaser) -> None:
    """Move the stamps of lasers, odometry and transforms whose clock is not that of the reference laser."""
    laser = reference.laser
    delay_s = _delay_s(laser.stamps_ns, laser.logged_ns)
    if delay_s is None:
        return
    moved: dict[str, float] = {}
    for name, source in stamped_sources(recording):
        own_s = _delay_s(source.stamps_ns, source.logged_ns)
        if source is laser or own_s is None or abs(own_s - delay_s) < _LEAST_APART_S:
            continue
        shift_s = own_s - delay_s
        shift_ns = round(shift_s * 1e9)
        if not isinstance(source, RawLaser) and _fits_better_as_stamped(source, reference.turns, shift_ns):
            continue
        source.stamps_ns = source.stamps_ns + shift_ns
        moved[name] = shift_s
    if moved:
        told = ", ".join(f"{name} by {shift_s:+.3f} s" for name, shift_s in moved.items())
        recording.warnings.append(
            f"{file_name(recording.name)}: not all clocks are that of {laser.name}; by the times of recording the "
            f"stamps of these were moved to it: {told}"
        )


def stamped_sources(recording: RawRecording) -> Iterator[tuple[str, Source]]:
    """Yield all that has stamps that matter; poses in a map are stamped ahead by those who find them."""
    yield from recording.lasers.items()
    yield from moving_tracks(recording, lambda parent: last_name(parent) not in GLOBAL_FRAMES)


def _delay_s(stamps_ns: I64, logged_ns: I64) -> float | None:
    """Median time from stamp to recording; None where it varies, or there is too little to tell."""
    if stamps_ns.size < 2:
        return None
    delay_ns, spread_s = delay_of(stamps_ns, logged_ns)
    return delay_ns * 1e-9 if spread_s < _MOST_SPREAD_S else None


def delay_of(stamps_ns: I64, logged_ns: I64) -> tuple[int, float]:
    """Median time from stamp to recording, nanoseconds, and how far the middle eight tenths of it spread, seconds.

    Of very many messages some, evenly spread, tell.
    """
    every = -(-stamps_ns.size // _MOST_DELAYS)
    delays_ns = logged_ns[::every] - stamps_ns[::every]
    low, high = np.quantile(delays_ns, _SPREAD_QUANTILES) * 1e-9
    # Of whole numbers as large as clocks may differ by, a mean of two is not exact.
    return int(delays_ns[0]) + int(np.median(delays_ns - delays_ns[0])), float(high - low)


def _fits_better_as_stamped(source: Track, turns: ScanTurns, shift_ns: int) -> bool:
    """Whether the sweeps turn with a source where its stamps are, and not where the times of recording put it."""
    as_stamped, as_logged = agreement_moved(source, turns, 0), agreement_moved(source, turns, shift_ns)
    return off_rad(as_stamped) < _CLEARLY * off_rad(as_logged)


def agreement_moved(source: Track, turns: ScanTurns, shift_ns: int) -> Agreement:
    """How the turns of a source agree with those of the sweeps, if its stamps are moved."""
    yaws_rad = tuple(yaws_at(source, stamps_ns - shift_ns) for stamps_ns in (turns.first_ns, turns.second_ns))
    return agreement(turns, (yaws_rad[0], yaws_rad[1]))


def off_rad(found: Agreement) -> float:
    """What is left of the turns, whichever way up the laser is."""
    return min(found.same_rad, found.opposite_rad)
