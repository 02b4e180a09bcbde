"""Which odometry is used, and the robot pose at each sweep."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from dynmap_cli.arrays import F64, I64
from dynmap_cli.domain.poses import compose, interpolate, inverse
from dynmap_cli.errors import LogError
from dynmap_cli.files.tables import new_table
from dynmap_cli.ingest.choices.frames import FrameTree, planar
from dynmap_cli.ingest.choices.robot_frames import GLOBAL_FRAMES, last_name, moved_by_odometry, odom_frame_of
from dynmap_cli.ingest.choices.track_quality import known_jumps_m
from dynmap_cli.ingest.choices.turns import ScanTurns, agreement_at
from dynmap_cli.ingest.raw.columns import known_rows, spans, steps_in
from dynmap_cli.ingest.raw.laser import RawLaser
from dynmap_cli.ingest.raw.recording import RawOdometry, RawRecording
from dynmap_cli.ingest.settings import IngestSettings

_TRUTH_WORDS = (
    "ground_truth",
    "groundtruth",
    "truth",
    "mocap",
    "vicon",
    "optitrack",
    "gps",
    "amcl",
    "localiz",
)
_TRUTH_TOKENS = frozenset({"gt", "gnss"})
_LEAST_COVER = 0.9
_LEAST_PATH_M = 0.02
_MOST_CUT, _ALWAYS_CUT = 0.05, 2
_MOST_JUMPING = 0.1
_NONE_WORDS = "none"
_MANY_TURNS, _NO_BETTER = 25, 0.8
_CLEAR_TURN_RAD = np.radians(6.0)
"""In the median of the pairs in which either turns."""


@dataclass(frozen=True, slots=True)
class Odometry:
    """Robot poses at the sweeps.

    Attributes
    ----------
    source : str
        "tf odom -> base_link", a topic, a kind of line, or "none".
    why : str
    poses : (n, 3) float64
        odom_from_robot at each asked time; NaN where unknown.
    longest_gap_s, path_m, rate_hz : float
        Longest pause, distance driven in the order of recording, and poses per second (median), of the source itself.
    rejected : tuple of str
        Sources that were left out, each with the reason.
    """

    source: str
    why: str
    poses: F64
    longest_gap_s: float
    path_m: float
    rejected: tuple[str, ...] = ()
    rate_hz: float = 0.0


def find_odometry(
    recording: RawRecording,
    tree: FrameTree,
    base: str,
    lasers: list[RawLaser],
    stamps_ns: I64,
    turns: ScanTurns,
    settings: IngestSettings,
) -> Odometry:
    """Robot pose at each sweep, from the best source there is.

    tf (odometry frame to robot frame) is taken if it covers the sweeps and moves, else an odometry topic or the
    pose fields of a text log. Frames and topics of localization or ground truth are never odometry.

    Parameters
    ----------
    recording : RawRecording
    tree : FrameTree
    base : str
        Robot frame; "" where there is none.
    lasers : list of RawLaser
        The lasers that are used.
    stamps_ns : (n,) int64
        Times of the sweeps, ascending.
    turns : ScanTurns
        Of one of the lasers, as the robot turned.
    settings : IngestSettings
    """
    if settings.odom == _NONE_WORDS:
        return _nowhere("as set", stamps_ns)
    candidates, rejected = _candidates(recording, tree, base, lasers, stamps_ns, settings)
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


def _nowhere(why: str, stamps_ns: I64, rejected: Sequence[str] = ()) -> Odometry:
    """No odometry, with the reason."""
    return Odometry("none", why, np.full((stamps_ns.size, 3), np.nan), 0.0, 0.0, tuple(rejected))


def _why_not(other: Odometry, chosen: Odometry) -> str:
    """Why another source comes second."""
    if _path_m(other.poses) < _LEAST_PATH_M <= _path_m(chosen.poses):
        return "it stands still"
    if _cover(other.poses) < min(_LEAST_COVER, _cover(chosen.poses)):
        return f"it covers {_cover(other.poses):.0%} of the sweeps"
    return "second choice"


def _candidates(
    recording: RawRecording,
    tree: FrameTree,
    base: str,
    lasers: list[RawLaser],
    stamps_ns: I64,
    settings: IngestSettings,
) -> tuple[list[Odometry], list[str]]:
    """All sources of odometry, the preferred first, and names of what looks like one but is not."""
    found: list[Odometry] = []
    rejected: list[str] = []
    from_tf = odometry_from_tf(tree, base, stamps_ns, settings, recording.folder)
    if from_tf is not None:
        found.append(from_tf)
    own = {laser.name for laser in lasers}
    for name, track in sorted(
        recording.odometry.items(),
        key=lambda item: (item[0] not in own, _distance(item[1], tree, base), item[0]),
    ):
        reason = _is_global(track)
        if reason:
            rejected.append(f"{name} ({reason})")
            continue
        found.append(_from_track(track, tree, base, stamps_ns, recording.folder))
    odom, moved = moved_by_odometry(tree)
    if from_tf is None and settings.odom_frame is None and base and moved and not tree.path(moved, base):
        found.append(
            _along(
                tree, odom, moved, stamps_ns, recording.folder, f"transforms; '{moved}' taken to be '{base}'"
            )
        )
    return found, rejected


def _distance(track: RawOdometry, tree: FrameTree, base: str) -> int:
    """0 where it is the robot frame that an odometry moves, 1 a frame that is joined to it, 2 where nobody knows."""
    if track.child == base:
        return 0
    return 1 if track.child and base and tree.path(track.child, base) else 2


def _always_jumps(stamps_ns: I64, poses: F64) -> str:
    """Says so where over a tenth of the steps between sweeps are longer than anything drives, as in millimetres."""
    found_m = known_jumps_m(stamps_ns, poses)
    if found_m.size <= max(_MOST_JUMPING * np.count_nonzero(known_rows(poses)), _ALWAYS_CUT):
        return ""
    return f"it jumps {found_m.size} times between scans, by up to {found_m.max():.1f} m"


def _turns_otherwise(turns: ScanTurns, stamps_ns: I64, poses: F64) -> str:
    """Says so where the headings of an odometry have nothing to do with how the laser turned, either way up.

    Where the sweeps hardly seem to turn they say nothing: in a round hall they look alike from every side.
    """
    if not turns.turns_rad.any():
        return ""
    found = agreement_at(turns, stamps_ns, poses)
    if found.n_pairs < _MANY_TURNS or found.still_rad < _CLEAR_TURN_RAD:
        return ""
    if min(found.same_rad, found.opposite_rad) < _NO_BETTER * found.still_rad:
        return ""
    return (
        f"its heading does not turn as the scans do: in the {found.n_pairs} half seconds with turns they differ by "
        f"{np.degrees(found.same_rad):.0f} deg in the median, of {np.degrees(found.still_rad):.0f} that the scans turn"
    )


def odometry_from_tf(
    tree: FrameTree, base: str, stamps_ns: I64, settings: IngestSettings, folder: Path | None = None
) -> Odometry | None:
    """Robot poses from the transforms between the odometry frame and the robot frame."""
    odom = odom_frame_of(tree, settings, base) if base else None
    steps = tree.path(odom, base) if odom else None
    if not odom or not steps or odom == base:
        return None
    if any(last_name(frame) in GLOBAL_FRAMES for frame in steps):
        return None
    return _along(tree, odom, base, stamps_ns, folder, "transforms of the odometry frame")


def _along(tree: FrameTree, odom: str, base: str, stamps_ns: I64, folder: Path | None, why: str) -> Odometry:
    """Robot poses from the transforms between two frames that are joined."""
    edges = [tree.edge_between(a, b) for a, b in pairwise(tree.path(odom, base) or ())]
    gaps = [_longest_gap_s(edge.stamps_ns) for edge in edges]
    flat = _planar_at(tree, odom, base, stamps_ns, folder)
    is_known = known_rows(flat)
    path_m = path_length_m(flat if is_known.all() else flat[is_known])
    return Odometry(
        f"tf {odom} -> {base}",
        why,
        flat,
        max(gaps, default=0.0),
        path_m,
        rate_hz=min((_rate_hz(edge.stamps_ns) for edge in edges if not edge.is_fixed), default=0.0),
    )


def _planar_at(tree: FrameTree, target: str, source: str, stamps_ns: I64, folder: Path | None) -> F64:
    """target_from_source (n, 3) in the plane at each time, of two frames that are joined; in blocks, to save memory."""
    result: F64 = new_table(stamps_ns.size, 3, folder, np.float64)
    for rows in spans(stamps_ns.size, stamps_ns, result):
        poses = tree.transform(target, source, stamps_ns[rows])
        result[rows] = np.nan if poses is None else planar(poses)
        tree.give_back()
    return result


def _from_track(
    track: RawOdometry, tree: FrameTree, base: str, stamps_ns: I64, folder: Path | None
) -> Odometry:
    """Robot poses from an odometry topic or the pose fields of a text log."""
    stamps, poses = track.as_arrays()
    why = "odometry messages" if track.frame else "poses in the lines of the log"
    if track.child and base and track.child != base:
        offset = tree.transform(track.child, base, stamps[:1])
        if offset is not None and np.isfinite(offset).all():
            poses = compose(poses, planar(offset)[0])
        else:
            why = f"odometry messages; '{track.child}' taken to be '{base}'"
    gap_s = _longest_gap_s(stamps)
    rate_hz = _rate_hz(stamps)
    path_m = path_length_m(track.poses)
    track.give_back()
    at_sweeps: F64 = new_table(stamps_ns.size, 3, folder, np.float64)
    for rows in spans(stamps_ns.size, stamps_ns, at_sweeps):
        at_sweeps[rows] = interpolate(stamps, poses, stamps_ns[rows])
        track.give_back()
    return Odometry(track.name, why, at_sweeps, gap_s, path_m, rate_hz=rate_hz)


def _rate_hz(stamps_ns: I64) -> float:
    """One over the median time between ascending stamps; 0 with fewer than two."""
    if stamps_ns.size < 2:
        return 0.0
    steps_ns = np.concatenate([*steps_in(stamps_ns)])
    return 1e9 / float(np.median(steps_ns, overwrite_input=True))


def _longest_gap_s(stamps_ns: I64) -> float:
    """Longest time between ascending stamps, seconds."""
    return max((int(steps.max()) for steps in steps_in(stamps_ns)), default=0) * 1e-9


def path_length_m(poses: F64) -> float:
    """Distance along poses (n, 3)."""
    steps_m = np.empty(max(poses.shape[0] - 1, 0))
    for rows in spans(steps_m.size, poses):
        steps_m[rows] = np.hypot(*np.diff(poses[rows.start : rows.stop + 1, :2], axis=0).T)
    return float(steps_m.sum())


def _is_global(track: RawOdometry) -> str:
    """Why a pose source is no odometry; "" where it is one."""
    if last_name(track.frame) in GLOBAL_FRAMES:
        return f"its poses are in '{track.frame}', a localization rather than odometry"
    name = track.name.lower()
    if any(word in name for word in _TRUTH_WORDS) or not _TRUTH_TOKENS.isdisjoint(re.split(r"[^a-z]+", name)):
        return "named as ground truth or localization"
    return ""


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
        _from_track(recording.odometry[wish], tree, base, stamps_ns, recording.folder), why="as set"
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
