"""Robots told apart by the namespaces of their topics, not by their frames: `/a/tf` and `/b/tf`, as in ROS 2."""

from __future__ import annotations

from collections import defaultdict
from itertools import combinations

import numpy as np

from dynmap_cli.ingest.raw.recording import RawRecording, RawTransform


def namespace_of(topic: str) -> str:
    """What stands before the last part of a topic, without outer slashes; "" where nothing does."""
    return topic.rpartition("/")[0].strip("/")


def robots_in(recording: RawRecording) -> tuple[str, ...]:
    """Namespaces of robots whose frames have the same names, sorted; none where frames tell all robots apart.

    Two namespaces, of which one has a laser, have transforms of frames that move and have the same names. Copies part
    nothing, as in the namespaces of several lasers of one robot. Outside of all namespaces there may be a robot as
    well, or anything else of those inside: there only odometry at the same time tells.
    """
    spaces = {space for space, _, _ in recording.transforms_read if space}
    with_laser = {
        space for space in spaces for laser in recording.lasers.values() if _is_in(laser.name, space)
    }
    moving: defaultdict[tuple[str, str], dict[str, RawTransform]] = defaultdict(dict)
    for (space, *pair), found in recording.transforms_read.items():
        if not found.is_static and (space or "odom" in pair[0].rpartition("/")[2]):
            moving[pair[0], pair[1]][space] = found
    told_apart = (
        pair
        for of_space in moving.values()
        for pair in combinations(of_space, 2)
        if with_laser.intersection(pair)
        and ("" not in pair or _overlap(of_space[pair[0]], of_space[pair[1]]))
        and not _are_copies(of_space[pair[0]], of_space[pair[1]])
    )
    return tuple(sorted({space for pair in told_apart for space in pair if space}))


def _overlap(one: RawTransform, other: RawTransform) -> bool:
    """Whether each of two has stamps from the time of the other."""
    return bool(one.stamps_ns.min() < other.stamps_ns.max() and other.stamps_ns.min() < one.stamps_ns.max())


def _are_copies(one: RawTransform, other: RawTransform) -> bool:
    """Whether transforms of two topics have stamps in common, and at these the same values."""
    _, rows, other_rows = np.intersect1d(one.stamps_ns, other.stamps_ns, return_indices=True)
    return bool(rows.size) and np.array_equal(one.values[rows], other.values[other_rows], equal_nan=True)


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
        f"frames of {', '.join(robots)} have the same names as others: taken as robots of their own, each with its "
        "namespace before its frames"
    )


def share_fixed(recording: RawRecording, robots: tuple[str, ...]) -> None:
    """Let fixed transforms that were published outside of the namespaces of robots be those of each robot as well.

    What a robot has itself stays, and frames that have the namespace of a robot are of no other.
    """
    outside = [
        (pair, found)
        for pair, found in recording.transforms.items()
        if found.is_static and not any(frame.startswith(f"{robot}/") for robot in robots for frame in pair)
    ]
    for (parent, child), found in outside:
        for robot in robots:
            pair = frame_in(robot, parent), frame_in(robot, child)
            if pair not in recording.transforms:
                recording.transforms[pair] = RawTransform(is_static=True)
                recording.transforms[pair].add_many(found.stamps_ns, found.logged_ns, found.values)


def frame_in(robot: str, frame: str) -> str:
    """A frame with the namespace of its robot before it; "" stays."""
    return frame if not frame or frame.startswith(f"{robot}/") else f"{robot}/{frame}"


def _is_in(topic: str, space: str) -> bool:
    return topic.lstrip("/").startswith(f"{space}/")
