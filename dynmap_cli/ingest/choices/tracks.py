"""Poses over time of a recording, odometry topics and transforms alike: where they are, and how they are moved."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from dynmap_cli.arrays import F64, I64
from dynmap_cli.domain.poses import interpolate
from dynmap_cli.ingest.choices.frames import make_edge
from dynmap_cli.ingest.choices.transforms import planar, planar_of, put_at
from dynmap_cli.ingest.raw.recording import RawOdometry, RawRecording, RawTransform

Track = RawOdometry | RawTransform


def moving_tracks(
    recording: RawRecording, is_wanted: Callable[[str], bool] = lambda _parent: True
) -> Iterator[tuple[str, Track]]:
    """Yield odometry, and transforms that are not latched, if their parent frame is wanted, each with its name."""
    yield from recording.odometry.items()
    for (parent, child), transform in recording.transforms.items():
        if not transform.is_static and is_wanted(parent):
            yield f"{parent} -> {child}", transform


def places_of(track: Track) -> F64:
    """Places x, y (n, 2) in the order of recording."""
    return (track.poses if isinstance(track, RawOdometry) else track.values)[:, :2]


def poses_of(track: Track) -> F64:
    """Poses (n, 3) in the order of recording."""
    return track.poses if isinstance(track, RawOdometry) else planar_of(track.values)


def put_poses(track: Track, poses: F64) -> None:
    """Move a track to other poses (n, 3) in the order of recording."""
    if isinstance(track, RawOdometry):
        track.poses = poses
    else:
        track.values = put_at(track.values, poses)


def yaws_at(track: Track, at_ns: I64) -> F64:
    """Headings (n,) at times; NaN where there are none."""
    if isinstance(track, RawOdometry):
        return np.asarray(interpolate(*track.as_arrays(), at_ns)[:, 2])
    return np.asarray(planar(make_edge(track).at(at_ns))[:, 2])


def part_of(track: Track, rows: slice) -> Track:
    """Some rows of a track, as one of its own."""
    if isinstance(track, RawOdometry):
        odometry = RawOdometry(track.name, track.frame, track.child)
        odometry.add_many(track.stamps_ns[rows], track.logged_ns[rows], track.poses[rows])
        return odometry
    transform = RawTransform(track.is_static)
    transform.add_many(track.stamps_ns[rows], track.logged_ns[rows], track.values[rows])
    return transform
