"""What people say about sub-maps and states that no recording tells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dynmap_cli.domain.submaps import Rectangle, SubMap

_LEAST_LIKENESS = 0.5


@dataclass(frozen=True, slots=True)
class Place:
    """Which sub-map is meant.

    Attributes
    ----------
    submap_id : int
    rectangle : Rectangle
        Where it was when this was said.
    """

    submap_id: int
    rectangle: Rectangle


@dataclass(frozen=True, slots=True)
class Merge:
    """Some states of a sub-map are one, which keeps the lowest of their numbers."""

    place: Place
    states: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Drop:
    """An area that was found is no sub-map."""

    place: Place


@dataclass(frozen=True, slots=True)
class Name:
    """What a sub-map is called."""

    place: Place
    name: str


@dataclass(frozen=True, slots=True)
class Addition:
    """An area is a sub-map of its own.

    Attributes
    ----------
    submap_id : int
        Its number, which no other sub-map gets.
    corners_m : tuple of (x, y)
        Polygon in the map frame.
    """

    submap_id: int
    corners_m: tuple[tuple[float, float], ...]


Correction = Merge | Drop | Name | Addition


def find_place(place: Place, submaps: Sequence[SubMap]) -> SubMap | None:
    """The sub-map that is meant: of that number, if it still lies there, else the one that lies as that one did.

    Rectangles lie alike if their common area is at least half of the area of both together.
    """
    for submap in submaps:
        if submap.submap_id == place.submap_id and submap.rectangle.common_m2(place.rectangle) > 0.0:
            return submap
    likeness = [submap.rectangle.likeness(place.rectangle) for submap in submaps]
    if not likeness or max(likeness) < _LEAST_LIKENESS:
        return None
    return submaps[likeness.index(max(likeness))]


def describe(correction: Correction) -> str:
    """Say it in a few words."""
    if isinstance(correction, Addition):
        x, y = zip(*correction.corners_m, strict=True)
        where = f"x {min(x):.1f} to {max(x):.1f}, y {min(y):.1f} to {max(y):.1f}"
        return f"sub-map {correction.submap_id} is added: polygon of {len(correction.corners_m)} corners, {where}"
    head = f"sub-map {correction.place.submap_id}"
    if isinstance(correction, Merge):
        return f"{head}: states {', '.join(map(str, correction.states))} are one"
    if isinstance(correction, Name):
        return f"{head} is called {correction.name}"
    return f"{head} is dropped"
