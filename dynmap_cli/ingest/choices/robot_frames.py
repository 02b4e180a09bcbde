"""Which frames in tf are those of the robot and of its odometry (REP 105)."""

from __future__ import annotations

from collections import Counter

from dynmap_cli.errors import LogError
from dynmap_cli.ingest.choices.frames import FrameTree
from dynmap_cli.ingest.raw.recording import RawRecording
from dynmap_cli.ingest.settings import IngestSettings

GLOBAL_FRAMES = ("map", "world", "earth", "mocap", "vicon", "optitrack")
_BASES = ("base_footprint", "base_link", "base")


def find_base(recording: RawRecording, tree: FrameTree, settings: IngestSettings) -> str:
    """Name of the robot frame: set, below odometry in tf, child of an odometry topic, by custom, or the fixed root."""
    sensors = _sensors(recording, settings)
    for key, frame in (("base_frame", settings.base_frame), ("odom_frame", settings.odom_frame)):
        if frame is not None and frame not in tree.frames:
            known = ", ".join(tree.frames[:20]) or "none"
            msg = f"{recording.name}: no frame '{frame}' in tf (ingest.{key}); frames here: {known}."
            raise LogError(msg)
    if settings.base_frame is not None:
        return settings.base_frame
    for sensor in sensors:
        base = _below_odometry(tree, sensor, settings)
        if base:
            return base
    for track in recording.odometry.values():
        if track.child and any(tree.path(track.child, sensor) for sensor in sensors):
            return track.child
    for sensor in sensors:
        above = [frame for frame in tree.parents(sensor) if last_name(frame) not in GLOBAL_FRAMES]
        for custom in _BASES:
            found = next((frame for frame in above if last_name(frame) == custom), None)
            if found:
                return found
        if above:
            return above[-1]
    return "" if any(sensor in tree.frames for sensor in sensors) else moved_by_odometry(tree)[1]


def _sensors(recording: RawRecording, settings: IngestSettings) -> list[str]:
    """Frames of the lasers, or of that which was asked for; first that with most scans, which tells the robot."""
    scans: Counter[str] = Counter()
    for laser in recording.lasers.values():
        if settings.scan_topic in {None, laser.name}:
            scans[laser.frame] += laser.n_scans
    return sorted(filter(None, scans), key=lambda frame: (-scans[frame], frame))


def odom_frame_of(tree: FrameTree, settings: IngestSettings, robot: str) -> str | None:
    """The odometry frame in tf: as set, or of those named so that are joined to a frame of the robot the likeliest."""
    if settings.odom_frame is not None:
        return settings.odom_frame
    ranks = {frame: _odometry_rank(tree, frame) for frame in tree.frames if tree.path(frame, robot)}
    named = [frame for frame, rank in ranks.items() if rank is not None]
    return min(named, key=lambda frame: (ranks[frame], len(frame), frame), default=None)


def _odometry_rank(tree: FrameTree, frame: str) -> int | None:
    """How much a frame is like that of an odometry, 0 = most; None where it is not.

    It has 'odom' in its name, and the robot moves below it (0), or above it where its publisher writes the inverse,
    because the robot has another parent already (1), or nothing moves (2).
    """
    if "odom" not in last_name(frame).lower():
        return None
    below = [edge for (parent, _), edge in tree.edges.items() if parent == frame]
    above = [
        edge
        for (parent, child), edge in tree.edges.items()
        if child == frame and last_name(parent) not in GLOBAL_FRAMES
    ]
    if any(not edge.is_fixed for edge in below):
        return 0
    if any(not edge.is_fixed for edge in above):
        return 1
    return 2 if below else None


def moved_by_odometry(tree: FrameTree) -> tuple[str, str]:
    """The likeliest odometry frame, and the frame that moves below it; "" where there are none."""
    moving = [pair for pair, edge in tree.edges.items() if not edge.is_fixed]
    found = [
        pair
        for pair in moving
        if _odometry_rank(tree, pair[0]) == 0 and last_name(pair[1]) not in GLOBAL_FRAMES
    ]
    return min(found, key=lambda pair: (len(pair[0]), pair), default=("", ""))


def _below_odometry(tree: FrameTree, sensor: str, settings: IngestSettings) -> str | None:
    """The frame next to the odometry frame on the way to a sensor."""
    odom = odom_frame_of(tree, settings, sensor)
    steps = tree.path(odom, sensor) if odom else None
    return steps[1] if steps and len(steps) > 1 and last_name(steps[1]) not in GLOBAL_FRAMES else None


def last_name(frame: str) -> str:
    """Frame name without its namespace."""
    return frame.rsplit("/", 1)[-1]
