"""Where odometry may come from: transforms, topics, pose fields of text logs; the robot pose at each sweep by each."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from dynmap_cli.arrays import F64, I64
from dynmap_cli.domain.poses import compose, interpolate
from dynmap_cli.files.tables import new_table
from dynmap_cli.ingest.choices.frames import FrameTree
from dynmap_cli.ingest.choices.robot_frames import GLOBAL_FRAMES, last_name, moved_by_odometry, odom_frame_of
from dynmap_cli.ingest.choices.transforms import planar
from dynmap_cli.ingest.raw.columns import known_rows, spans, steps_in
from dynmap_cli.ingest.raw.laser import RawLaser
from dynmap_cli.ingest.raw.recording import RawOdometry, RawRecording
from dynmap_cli.ingest.seen_motion.turns import Headings
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
NONE_WORDS = "none"


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


@dataclass(frozen=True, slots=True)
class Candidates:
    """What may be used as odometry.

    Attributes
    ----------
    found : list of Odometry
        The preferred first.
    rejected : list of str
        What looks like one but is not, each with the reason.
    """

    found: list[Odometry]
    rejected: list[str]

    def headings(self, stamps_ns: I64) -> Headings:
        """All of them at the sweeps (n,), ascending."""
        return Headings(stamps_ns, [found.poses for found in self.found])


def find_candidates(
    recording: RawRecording,
    tree: FrameTree,
    base: str,
    lasers: list[RawLaser],
    stamps_ns: I64,
    settings: IngestSettings,
) -> Candidates:
    """Find all sources of odometry: tf (odometry frame to robot frame), topics, pose fields of a text log.

    Frames and topics of localization or ground truth are never odometry.

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
    settings : IngestSettings
    """
    found: list[Odometry] = []
    rejected: list[str] = []
    if settings.odom == NONE_WORDS:
        return Candidates(found, rejected)
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
        found.append(from_track(track, tree, base, stamps_ns, recording.folder))
    odom, moved = moved_by_odometry(tree)
    if from_tf is None and settings.odom_frame is None and base and moved and not tree.path(moved, base):
        found.append(
            _along(
                tree, odom, moved, stamps_ns, recording.folder, f"transforms; '{moved}' taken to be '{base}'"
            )
        )
    return Candidates(found, rejected)


def _distance(track: RawOdometry, tree: FrameTree, base: str) -> int:
    """0 where it is the robot frame that an odometry moves, 1 a frame that is joined to it, 2 where nobody knows."""
    if track.child == base:
        return 0
    return 1 if track.child and base and tree.path(track.child, base) else 2


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


def from_track(
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
