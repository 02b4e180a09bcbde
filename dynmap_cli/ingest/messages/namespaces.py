"""Robots told apart by the namespaces of their topics, not by their frames: `/a/tf` and `/b/tf`, as in ROS 2."""

from __future__ import annotations

from collections import Counter

from dynmap_cli.ingest.raw.recording import RawRecording


def namespace_of(topic: str) -> str:
    """What stands before the last part of a topic, without outer slashes; "" where nothing does."""
    return topic.rpartition("/")[0].strip("/")


def robots_in(recording: RawRecording) -> tuple[str, ...]:
    """Namespaces of robots whose frames have the same names, sorted; none where frames tell all robots apart.

    A robot has a laser in its namespace, and transforms of frames that move and that another such robot has too.
    Transforms outside of all namespaces may be copies of those inside, and part nothing.
    """
    spaces = {
        space
        for space, _, _ in recording.transforms_read
        if space and any(_is_in(laser.name, space) for laser in recording.lasers.values())
    }
    moving = {
        key for key, found in recording.transforms_read.items() if key[0] in spaces and not found.is_static
    }
    shared = Counter((parent, child) for _, parent, child in moving)
    return tuple(sorted({space for space, parent, child in moving if shared[parent, child] > 1}))


def name_frames(recording: RawRecording, robots: tuple[str, ...]) -> None:
    """Put the namespace of a robot before the frames of its lasers and odometry, and say so."""
    if not robots:
        return
    for robot in robots:
        for laser in recording.lasers.values():
            if _is_in(laser.name, robot):
                laser.frame = frame_in(robot, laser.frame)
        for track in recording.odometry.values():
            if _is_in(track.name, robot):
                track.frame, track.child = frame_in(robot, track.frame), frame_in(robot, track.child)
    recording.notes.append(
        f"frames of {', '.join(robots)} have the same names: taken as robots of their own, each with its namespace "
        "before its frames"
    )


def frame_in(robot: str, frame: str) -> str:
    """A frame with the namespace of its robot before it; "" stays."""
    return frame if not frame or frame.startswith(f"{robot}/") else f"{robot}/{frame}"


def _is_in(topic: str, space: str) -> bool:
    return topic.lstrip("/").startswith(f"{space}/")
