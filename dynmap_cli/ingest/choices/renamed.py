"""Sweeps of one topic that name different frames: two lasers, or one whose frame was renamed."""

from __future__ import annotations

import numpy as np

from dynmap_cli.ingest.choices.frames import FrameTree, find_mounting
from dynmap_cli.ingest.choices.lasers import is_same_place
from dynmap_cli.ingest.raw.laser import RawLaser
from dynmap_cli.ingest.raw.recording import RawRecording, topic_of


def join_renamed(recording: RawRecording, tree: FrameTree, base: str) -> None:
    """Make lasers of one topic one where they sit at one place, or where one ends before the other begins.

    Lasers at two places stay two; that is said, for whoever recorded them may not know of it.
    """
    for name in [name for name in recording.lasers if topic_of(name) != name]:
        first, other = recording.lasers.get(topic_of(name)), recording.lasers[name]
        if first is None:
            continue
        places = [find_mounting(tree, base, laser.frame, laser.stamps_ns) for laser in (first, other)]
        if places[0] is not None and places[1] is not None:
            is_one = is_same_place(places[0], places[1])
        else:
            is_one = _come_one_after_the_other(first, other)
        if not is_one:
            recording.warnings.append(
                f"{topic_of(name)}: its {first.n_scans + other.n_scans} scans name several frames: {other.n_scans} of "
                f"them '{other.frame}', {first.n_scans} '{first.frame}'; taken as lasers of their own"
            )
            continue
        frame = first.frame if places[0] is not None or places[1] is None else other.frame
        recording.notes.append(
            f"{first.name}: the frames '{first.frame}' and '{other.frame}' are taken as one laser"
        )
        first.frame = frame
        first.append(other)
        del recording.lasers[name]
        first.keep(np.argsort(first.logged_ns, kind="stable"))


def _come_one_after_the_other(a: RawLaser, b: RawLaser) -> bool:
    """Whether no sweep of one was recorded between two of the other."""
    return bool(a.logged_ns.max() < b.logged_ns.min() or b.logged_ns.max() < a.logged_ns.min())
