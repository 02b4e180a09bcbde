"""Says where a start is in doubt: a map that looks the same from several places, a start that was given wrongly."""

from __future__ import annotations

import math
from collections.abc import Sequence

from dynmap_cli.arrays import F64
from dynmap_cli.localization.particles.particle_filter import ONE_MODE_SHARE
from dynmap_cli.localization.starting.global_start import shares_of
from dynmap_cli.localization.starting.modes import Mode

_LEAST_NAMED, _MOST_NAMED = 0.05, 3


def undecided_words(modes: Sequence[Mode], recordings: Sequence[str]) -> str:
    """One sentence where none of the possible starts (not none) of a drive has most of the probability; else "".

    Nothing is wrong with the scans then: in an empty corridor whose doors are shut, both ends fit to the end of the
    drive, and which of them the particles follow is chance.
    """
    shares = shares_of(modes)
    if shares.max() >= ONE_MODE_SHARE:
        return ""
    ranked = sorted(zip(shares.tolist(), modes, strict=True), key=lambda one: -one[0])
    named = [one for one in ranked if one[0] >= _LEAST_NAMED][:_MOST_NAMED] or ranked[:_MOST_NAMED]
    places = [f"{_called(mode)} ({100 * share:.0f} %)" for share, mode in named]
    if len(ranked) > len(named):
        places.append(f"{len(ranked) - len(named)} other places")
    n_looks = max(mode.n_looks for mode in modes)
    return (
        f"{', '.join(recordings)}: the map looks alike from several places: {n_looks} scans along the way fit a start "
        f"at {' or '.join(places)}; which of them the poses follow may be chance, so give --start if it is known"
    )


def _called(mode: Mode) -> str:
    """A pose for people."""
    x_m, y_m, yaw_rad = mode.pose.tolist()
    return f"({x_m:.2f}, {y_m:.2f}) m, {math.degrees(math.remainder(yaw_rad, math.tau)):.0f} deg"


def moved_words(given: F64, found: F64) -> str:
    """One sentence for a start (3,) that was given and is wrong, and the pose (3,) where the robot was found."""
    places = (f"({x:.2f}, {y:.2f}) m, {math.degrees(yaw):.0f} deg" for x, y, yaw in (given, found))
    return "the robot did not start at {}, where it was said to be; it was found at {}".format(*places)
