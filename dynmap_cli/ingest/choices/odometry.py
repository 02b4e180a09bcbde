"""Which odometry is used: the best that is there, and that is believed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dynmap_cli.arrays import F64, I64
from dynmap_cli.domain.poses import compose, inverse, wrap_angle
from dynmap_cli.errors import LogError
from dynmap_cli.ingest.choices.frames import FrameTree
from dynmap_cli.ingest.choices.odometry_sources import NONE_WORDS, Candidates, Odometry, from_track
from dynmap_cli.ingest.choices.track_quality import known_jumps_m
from dynmap_cli.ingest.raw.columns import known_rows, spans
from dynmap_cli.ingest.raw.recording import RawRecording
from dynmap_cli.ingest.seen_motion.agreement import agreement_at
from dynmap_cli.ingest.seen_motion.laid_sweeps import speak_for
from dynmap_cli.ingest.seen_motion.pairs import rows_at
from dynmap_cli.ingest.seen_motion.turns import TURNING_RAD, ScanTurns
from dynmap_cli.ingest.settings import IngestSettings

_LEAST_COVER = 0.9
_LEAST_PATH_M = 0.02
_MOST_CUT, _ALWAYS_CUT = 0.05, 2
_MOST_JUMPING = 0.1
_LEAST_PAIRS, _NO_BETTER = 8, 0.8
_OFTEN = 0.05


def find_odometry(
    recording: RawRecording,
    tree: FrameTree,
    base: str,
    known: Candidates,
    stamps_ns: I64,
    turns: ScanTurns,
    settings: IngestSettings,
) -> Odometry:
    """Robot pose at each sweep, from the best source there is.

    tf is taken if it covers the sweeps and moves, else an odometry topic or the pose fields of a text log.

    Parameters
    ----------
    recording : RawRecording
    tree : FrameTree
    base : str
        Robot frame; "" where there is none.
    known : Candidates
    stamps_ns : (n,) int64
        Times of the sweeps, ascending.
    turns : ScanTurns
        Of one of the lasers, as the robot turned.
    settings : IngestSettings
    """
    if settings.odom == NONE_WORDS:
        return _nowhere("as set", stamps_ns)
    candidates, rejected = list(known.found), list(known.rejected)
    if settings.odom is not None:
        return _as_wished(recording.name, candidates, recording, base, tree, stamps_ns, settings.odom)
    if not candidates:
        return _nowhere("the recording holds no odometry", stamps_ns, rejected)
    apart = [found for found in candidates if _cover(found.poses) == 0.0]
    rejected += [f"{found.source} (its times are not those of the scans)" for found in apart]
    candidates = [found for found in candidates if _cover(found.poses) > 0.0]
    if not candidates:
        return _nowhere("no odometry has the times of the scans", stamps_ns, rejected)
    faults = [
        _always_jumps(stamps_ns, found.poses) or _turns_otherwise(turns, stamps_ns, found.poses)
        for found in candidates
    ]
    rejected += [f"{found.source} ({why})" for found, why in zip(candidates, faults, strict=True) if why]
    candidates = [found for found, why in zip(candidates, faults, strict=True) if not why]
    if not candidates:
        return _nowhere("no odometry is that of a robot", stamps_ns, rejected)
    moving = [found for found in candidates if _path_m(found.poses) >= _LEAST_PATH_M]
    covering = [found for found in moving if _cover(found.poses) >= _LEAST_COVER]
    chosen = (covering or moving or candidates)[0]
    if not covering and moving:
        chosen = max(moving, key=lambda found: _cover(found.poses))
    for other in candidates:
        if other is not chosen:
            rejected.append(f"{other.source} ({_why_not(other, chosen)})")
    return replace(chosen, rejected=tuple(rejected))


SECOND_CHOICE = "second choice"
"""Begins why a source was not taken that nothing speaks against."""


def _nowhere(why: str, stamps_ns: I64, rejected: Sequence[str] = ()) -> Odometry:
    """No odometry, with the reason."""
    return Odometry("none", why, np.full((stamps_ns.size, 3), np.nan), 0.0, 0.0, tuple(rejected))


def _why_not(other: Odometry, chosen: Odometry) -> str:
    """Why another source comes second."""
    if _path_m(other.poses) < _LEAST_PATH_M <= _path_m(chosen.poses):
        return "it stands still"
    if _cover(other.poses) < min(_LEAST_COVER, _cover(chosen.poses)):
        return f"it covers {100 * _cover(other.poses):.0f} % of the sweeps"
    if chosen.source.startswith("tf "):
        return f"{SECOND_CHOICE}, as sound transforms come before topics"
    return f"{SECOND_CHOICE} after {chosen.source}, which is nearer to the robot's frame or first by name"


def _always_jumps(stamps_ns: I64, poses: F64) -> str:
    """Says so where over a tenth of the steps between sweeps are longer than anything drives, as in millimetres."""
    found_m = known_jumps_m(stamps_ns, poses)
    if found_m.size <= max(_MOST_JUMPING * np.count_nonzero(known_rows(poses)), _ALWAYS_CUT):
        return ""
    return f"it jumps {found_m.size} times between scans, by up to {found_m.max():.1f} m"


def _turns_otherwise(turns: ScanTurns, stamps_ns: I64, poses: F64) -> str:
    """Says so where the headings of an odometry have nothing to do with how the laser turned, either way up.

    Sweeps may seem to turn otherwise than they do; so the odometry is heard before it is not believed. A laser that
    repeats one and the same sweep says nothing.
    """
    if np.array_equal(turns.pairs.before_m, turns.pairs.after_m, equal_nan=True):
        return ""
    found = agreement_at(turns, stamps_ns, poses)
    if found.n_pairs < _LEAST_PAIRS:
        return ""
    # Pairs in which an odometry turns most are looked for: where it alone turns, and seldom, they are slips of wheels.
    if found.still_rad < TURNING_RAD and _turning_share(turns, stamps_ns, poses) < _OFTEN:
        return ""
    if min(found.same_rad, found.opposite_rad) < _NO_BETTER * found.still_rad:
        return ""
    if speak_for(turns, stamps_ns, poses):
        return ""
    return (
        f"its heading does not turn as the scans do: in the {found.n_pairs} half seconds with turns they differ by "
        f"{np.degrees(found.same_rad):.0f} deg in the median, of {np.degrees(found.still_rad):.0f} that the scans turn"
    )


def _turning_share(turns: ScanTurns, stamps_ns: I64, poses: F64) -> float:
    """In what share of spans as long as those of the pairs, one after the other, an odometry turns."""
    span_ns = int(np.median(turns.second_ns - turns.first_ns))
    at_ns = np.arange(stamps_ns[0], stamps_ns[-1], max(span_ns, 1))
    turned_rad = wrap_angle(np.diff(poses[rows_at(stamps_ns, at_ns), 2]))
    known = np.isfinite(turned_rad)
    return float(np.mean(np.abs(turned_rad[known]) > TURNING_RAD)) if known.any() else 0.0


def _as_wished(
    name: str,
    candidates: list[Odometry],
    recording: RawRecording,
    base: str,
    tree: FrameTree,
    stamps_ns: I64,
    wish: str,
) -> Odometry:
    """The source that was asked for."""
    if wish == "tf":
        from_tf = next((found for found in candidates if found.source.startswith("tf ")), None)
        if from_tf is None:
            frames = ", ".join(tree.frames[:20]) or "none"
            msg = (
                f"{name}: tf does not join an odometry frame to the robot; frames here: {frames}. "
                "Pass --odom TOPIC or none, or set ingest.odom_frame and ingest.base_frame."
            )
            raise LogError(msg)
        return replace(from_tf, why="as set")
    if wish not in recording.odometry:
        topics = ", ".join(sorted(recording.odometry)) or "none"
        msg = (
            f"{name}: no odometry on '{wish}'; odometry here: {topics}. "
            "Pass one of these with --odom, or 'tf' or 'none'."
        )
        raise LogError(msg)
    return replace(
        from_track(recording.odometry[wish], tree, base, stamps_ns, recording.folder), why="as set"
    )


def _cover(poses: F64) -> float:
    """Share of sweeps with a pose."""
    return float(known_rows(poses).mean()) if poses.size else 0.0


def _path_m(poses: F64) -> float:
    """Path length with a radian of turning counted as 0.3 m, so that turning on the spot counts as moving."""
    is_known = known_rows(poses)
    known = poses if is_known.all() else poses[is_known]
    length_m = 0.0
    for rows in spans(max(known.shape[0] - 1, 0), known):
        steps = compose(inverse(known[rows]), known[rows.start + 1 : rows.stop + 1])
        length_m += float(np.hypot(steps[:, 0], steps[:, 1]).sum() + 0.3 * np.abs(steps[:, 2]).sum())
    return length_m


def ends_without_odometry(poses: F64) -> slice:
    """Sweeps to keep: those before the first and after the last pose go, if they are few (5 %, or two)."""
    known = np.flatnonzero(known_rows(poses))
    everything = slice(0, poses.shape[0])
    if known.size == 0:
        return everything
    kept = slice(int(known[0]), int(known[-1]) + 1)
    cut = poses.shape[0] - (kept.stop - kept.start)
    return kept if cut <= max(_MOST_CUT * poses.shape[0], _ALWAYS_CUT) else everything
