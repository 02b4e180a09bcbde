"""Where a drive lies on a site: local maps of one tried everywhere on the maps of the others, and what agrees."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from dynmap_cli.arrays import F32, F64, I64
from dynmap_cli.domain.poses import between, compose, inverse, transform_points, wrap_angle
from dynmap_cli.kernels.likelihood import field_log_likelihoods
from dynmap_cli.mapping.local_maps import Easel, LocalMaps
from dynmap_cli.mapping.loops import LoopParams, why_not

_CELL_M, _MARGIN_M = 0.1, 1.0
_SIGMA_M, _FARTHEST_SIGMAS = 0.2, 2.5
_PITCH_M, _N_YAWS = 0.25, 90
_REACH_M = 4.0
_N_POINTS = 200
_N_BEST, _N_PEAKS = 3000, 10
_PEAK_M, _PEAK_RAD = 0.5, 0.2
_NEAREST_MAPS = 2
_SEARCH_M, _SEARCH_RAD = 0.5, 0.12
_AGREE_M, _AGREE_SHARE, _AGREE_FARTHEST_M, _AGREE_RAD = 0.5, 0.03, 3.0, 0.15
_LEAST_PLACES, _CLEARLY_MORE = 3, 4
_FIRST_LOOK, _MOST_PLACES = 8, 40
_CANDIDATES_TO_CHECK, _PLACES_TO_CHECK, _CHECK_REACH_M = 4, 24, 1.0
_LEAST_QUALITY, _CLEARLY_BETTER = 0.8, 0.05


@dataclass(frozen=True, slots=True)
class Places:
    """Local maps in one frame.

    Attributes
    ----------
    maps : LocalMaps
    poses : (n_maps, 3) float64
        frame_from_anchor.
    """

    maps: LocalMaps
    poses: F64

    def moved(self, frame_from_this: F64) -> Places:
        """The same in another frame."""
        return Places(self.maps, compose(frame_from_this, self.poses))


def joined_places(parts: Sequence[Places]) -> Places:
    """All places of several sets in the same frame."""
    first, *others = (part.maps for part in parts)
    return Places(reduce(add, others, first), np.concatenate([part.poses for part in parts]))


@dataclass(frozen=True, slots=True)
class Placement:
    """Where a drive lies, or why that is not known.

    Attributes
    ----------
    site_from_drive : (3,) float64 or None
        None where it fits nowhere, or in several places.
    evidence : str
        How many places were tried, and what came of it.
    """

    site_from_drive: F64 | None
    evidence: str


@dataclass(frozen=True, slots=True)
class _Vote:
    """One place of the drive that fits on the site.

    Attributes
    ----------
    place : int
        Number of the drive's local map.
    site_from_drive : (3,) float64
    matched : float
        Share of its points on lines of the site.
    """

    place: int
    site_from_drive: F64
    matched: float


def place_drive(site: Places, drive: Places) -> Placement:
    """Find the pose of a drive on a site without a guess.

    Places of the drive are weighed on a lattice of poses over the distance field of the site; the best poses are fitted
    on the local maps there and asked for what loops are asked for. A pose is a candidate once several places say the
    same. It holds if most places of the drive that lie on the site at that pose fit there, and if no other candidate
    fits about as well.

    Parameters
    ----------
    site, drive : Places
        Each in its own frame.
    """
    field, easel = _Field(site), Easel()
    votes: list[_Vote] = []
    needed, enough = min(_LEAST_PLACES, len(drive.maps)), min(_FIRST_LOOK, len(drive.maps))
    n_tried, n_fitting, said = 0, 0, "none fits"
    for place in _spread_out(len(drive.maps)):
        found = _votes_of(place, drive, site, field, easel)
        votes += found
        n_tried, n_fitting = n_tried + 1, n_fitting + bool(found)
        if n_tried >= enough and (found or n_tried == enough):
            chosen, said = _choose(votes, needed, site, drive, easel)
            if chosen is not None:
                return Placement(chosen, f"{n_fitting} of {n_tried} places tried fit somewhere; {said}")
        if n_tried == _MOST_PLACES:
            break
    return Placement(None, f"{n_tried} places along it were tried, {n_fitting} fit somewhere; {said}")


def _choose(
    votes: Sequence[_Vote], needed: int, site: Places, drive: Places, easel: Easel
) -> tuple[F64 | None, str]:
    """The pose that holds, and the evidence; None where none does."""
    candidates = _candidates(votes, drive)
    most = len(candidates[0]) if candidates else 0
    if most < needed:
        return None, f"at most {most} agree (at least {needed} must)"
    best: tuple[F64, _Check] | None = None
    second = 0.0
    refuted = ""
    for agreed in candidates[:_CANDIDATES_TO_CHECK]:
        if len(agreed) < needed:
            break
        pose = max(agreed, key=lambda vote: vote.matched).site_from_drive
        check = _check(pose, site, drive, easel)
        if check.n_for < max(needed, _CLEARLY_MORE * check.n_against) or check.quality < _LEAST_QUALITY:
            misfits = f"{check.n_against} do not fit, and " if check.n_against else ""
            refuted = refuted or (
                f"{len(agreed)} agree, but of the {check.n_for + check.n_against} places that lie on the map there "
                f"{misfits}on the whole {100 * check.quality:.0f} % of their points match "
                f"(at least {100 * _LEAST_QUALITY:.0f} %)"
            )
        elif best is None or check.quality > best[1].quality:
            second = best[1].quality if best else 0.0
            best = pose, check
        else:
            second = max(second, check.quality)
    if best is None:
        return None, refuted
    if second > best[1].quality - _CLEARLY_BETTER:
        return None, "it fits in two places about equally well"
    return best[0], f"{best[1].n_for} of {best[1].n_for + best[1].n_against} fit where most agree"


@dataclass(frozen=True, slots=True)
class _Check:
    """How the places of a drive fit at one pose.

    Attributes
    ----------
    n_for, n_against : int
        Places that overlap the site and fit there, or do not.
    quality : float
        Mean share of the overlapping points that match, less those in free space.
    """

    n_for: int
    n_against: int
    quality: float


def _check(pose: F64, site: Places, drive: Places, easel: Easel) -> _Check:
    """Fit places along the whole drive near where they would lie."""
    params, tree = LoopParams(), cKDTree(site.poses[:, :2])
    fits_well: list[bool] = []
    qualities: list[float] = []
    for number, place in enumerate(_spread_out(len(drive.maps))):
        if number == _PLACES_TO_CHECK:
            break
        guess = compose(pose, drive.poses[place])
        distance, nearest = tree.query(guess[:2])
        if distance > _REACH_M:
            continue
        easel.draw(site.maps[nearest])
        fits = easel.search(
            drive.maps[place], between(site.poses[nearest], guess), _CHECK_REACH_M, _SEARCH_RAD
        )
        if fits and fits[0].seen >= params.min_seen:
            fits_well.append(not why_not(fits[0], params))
            qualities.append(fits[0].matched_of_seen - fits[0].in_free / fits[0].seen)
    n_for = sum(fits_well)
    return _Check(n_for, len(fits_well) - n_for, float(np.mean(qualities)) if qualities else 0.0)


def _points_of(site: Places) -> Iterator[F64]:
    """Yield the points (n, 2) of each local map that has any, in the frame of the site."""
    for pose, each in zip(site.poses, site.maps, strict=True):
        if each.points.size:
            yield transform_points(pose, each.points.astype(np.float64))


class _Field:
    """Distance field of all points of a site, and the lattice of positions on it."""

    def __init__(self, site: Places) -> None:
        ends = [(points.min(axis=0), points.max(axis=0)) for points in _points_of(site)]
        self._origin = np.min([low for low, _ in ends], axis=0) - _MARGIN_M
        high = np.max([high for _, high in ends], axis=0)
        cols, rows = (np.ceil((high + _MARGIN_M - self._origin) / _CELL_M) + 1).astype(int)
        is_free = np.ones((rows, cols), dtype=bool)
        for points in _points_of(site):
            at = ((points - self._origin) / _CELL_M).astype(int)
            is_free[at[:, 1], at[:, 0]] = False
        sigmas = np.minimum(distance_transform_edt(is_free) * (_CELL_M / _SIGMA_M), _FARTHEST_SIGMAS)
        self._pool: F32 = (-0.5 * sigmas**2).astype(np.float32).ravel()
        self._rows, self._cols = int(rows), int(cols)
        self._lattice = self._positions(site.poses[:, :2])

    def _positions(self, anchors: F64) -> F64:
        """(n, 2) positions near anchors, metres."""
        low, high = anchors.min(axis=0) - _REACH_M, anchors.max(axis=0) + _REACH_M
        axes = [np.arange(low[k], high[k], _PITCH_M) for k in range(2)]
        lattice = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        distance, _ = cKDTree(anchors).query(lattice, distance_upper_bound=_REACH_M)
        return np.asarray(lattice[np.isfinite(distance)])

    def peaks(self, points: F32) -> list[F64]:
        """Poses (3,) in which points (n, 2) lie best on the site, the best first, each in a place of its own."""
        n_places = self._lattice.shape[0]
        ends = np.ascontiguousarray(points[:: max(1, points.shape[0] // _N_POINTS)].T / np.float32(_CELL_M))
        cell, nowhere = np.array([*self._origin, _CELL_M]), np.zeros((1, 5), dtype=np.int32)
        yaws: F64 = 2.0 * np.pi / _N_YAWS * np.arange(_N_YAWS, dtype=np.float64)
        scores = np.empty((_N_YAWS, n_places))
        scratch = np.empty(ends.shape[1], dtype=np.int32)
        for number, yaw in enumerate(yaws):
            poses, out = np.column_stack([self._lattice, np.full(n_places, yaw)]), scores[number]
            field_log_likelihoods(
                self._pool, self._rows, self._cols, cell, poses, ends, nowhere, scratch, out
            )
        flat = scores.ravel()
        best = np.argpartition(flat, max(flat.size - _N_BEST, 0))[-_N_BEST:]
        best = best[np.lexsort((best, -flat[best]))]
        yaw_index, place = np.divmod(best, n_places)
        return _apart(np.column_stack([self._lattice[place], wrap_angle(np.asarray(yaws[yaw_index]))]))


def _apart(poses: F64) -> list[F64]:
    """The first of the poses (n, 3), and each next one that is no neighbour of those before."""
    kept: list[F64] = []
    for pose in poses:
        if all(
            np.hypot(*(pose[:2] - other[:2])) > _PEAK_M or abs(wrap_angle(pose[2] - other[2])) > _PEAK_RAD
            for other in kept
        ):
            kept.append(pose)
        if len(kept) == _N_PEAKS:
            break
    return kept


def _spread_out(n_places: int) -> Iterator[int]:
    """All numbers below *n_places*, those far from the ones before first."""
    step = 1 << max(n_places - 1, 0).bit_length()
    told: set[int] = set()
    while step:
        for number in range(step // 2, n_places, step):
            if number not in told:
                told.add(number)
                yield number
        step //= 2
    if n_places > 0 and 0 not in told:
        yield 0


def _votes_of(place: int, drive: Places, site: Places, field: _Field, easel: Easel) -> list[_Vote]:
    """Where one place of the drive fits on the site about equally well."""
    params, moved = LoopParams(), drive.maps[place]
    tree = cKDTree(site.poses[:, :2])
    votes = []
    for peak in field.peaks(moved.points):
        _, nearest = tree.query(peak[:2], k=range(1, min(_NEAREST_MAPS, len(site.maps)) + 1))
        for number in nearest.tolist():
            easel.draw(site.maps[number])
            fits = easel.search(moved, between(site.poses[number], peak), _SEARCH_M, _SEARCH_RAD)
            if fits and not why_not(fits[0], params):
                pose = compose(site.poses[number], fits[0].pose)
                votes.append(_Vote(place, compose(pose, inverse(drive.poses[place])), fits[0].matched))
                break
    well = params.margin * max((vote.matched for vote in votes), default=0.0)
    return [vote for vote in votes if vote.matched > well]


def _candidates(votes: Sequence[_Vote], drive: Places) -> list[list[_Vote]]:
    """Groups of votes, one of each place, that agree; the largest first, none agreeing with one before."""
    groups: list[list[_Vote]] = []
    for vote in votes:
        agreed: dict[int, _Vote] = {}
        for other in votes:
            if _agree(vote, other, drive):
                agreed.setdefault(other.place, other)
        groups.append(list(agreed.values()))
    groups.sort(key=len, reverse=True)
    candidates: list[list[_Vote]] = []
    for group in groups:
        if not any(_agree(group[0], vote, drive) for candidate in candidates for vote in candidate):
            candidates.append(group)
    return candidates


def _agree(vote: _Vote, other: _Vote, drive: Places) -> bool:
    """Whether two votes put the second one's place at nearly the same pose."""
    pose = drive.poses[other.place]
    error = between(compose(vote.site_from_drive, pose), compose(other.site_from_drive, pose))
    way_m = float(np.hypot(*(drive.poses[vote.place][:2] - pose[:2])))
    allowed_m = min(_AGREE_M + _AGREE_SHARE * way_m, _AGREE_FARTHEST_M)
    return bool(np.hypot(error[0], error[1]) < allowed_m and abs(error[2]) < _AGREE_RAD)


def near_pairs(poses: F64, first_of_drive: I64, reach_m: float, n_pairs: int) -> list[tuple[int, int]]:
    """Pairs (later, earlier) of places of different drives that are near one another, a few along each drive.

    Parameters
    ----------
    poses : (n_maps, 3) float64
        Of all drives in one frame.
    first_of_drive : (n_drives,) int64
        Ascending; number of the first place of each drive.
    reach_m : float
    n_pairs : int
        Of each drive at most.
    """
    pairs: list[tuple[int, int]] = []
    ends = [*first_of_drive[1:].tolist(), poses.shape[0]]
    for first, last in zip(first_of_drive[1:].tolist(), ends[1:], strict=True):
        distance, nearest = cKDTree(poses[:first, :2]).query(
            poses[first:last, :2], distance_upper_bound=reach_m
        )
        near = np.flatnonzero(np.isfinite(distance))
        chosen = near[np.unique(np.linspace(0, near.size - 1, min(n_pairs, near.size)).astype(int))]
        pairs += [(first + int(number), int(nearest[number])) for number in chosen]
    return pairs
