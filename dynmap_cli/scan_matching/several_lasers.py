"""How well the poses found with several lasers agree: where each is mounted, and how much the matches can be believed.

All lasers are matched against one local map. Where the stated mounting of one is wrong, the path jumps to and fro
between the poses found with it and with the others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import B1, F64, I64
from dynmap_cli.domain.poses import between, compose, wrap_angle
from dynmap_cli.scan_matching.calibration import ENOUGH_SCANS
from dynmap_cli.scan_matching.front_end import Registered

_GOOD_SHARE = 0.7
_LONGEST_GAP_S = 0.5
_LEAST_INFORMATION = 1.0
_BLOCKS = 16
_SIGMAS = 4.0
_LEAST_SHIFT_M, _LEAST_TURN_RAD = 0.003, 0.002
_MOST_ROUNDS = 6
_CLEAR_EXCESS = 4.0
_CHI2_MEDIAN = 2.366
"""Median of the chi-square distribution with three degrees of freedom."""


@dataclass(frozen=True, slots=True)
class Agreement:
    """Poses found with the scans of each laser, against those of the first, interpolated at their times.

    Attributes
    ----------
    offsets : (n_lasers, 3) float64
        Median pose by the scans of a laser in the robot frame by those of the first: x, y, yaw; 0 for the first, and
        where too few scans match well.
    errors : (n_lasers, 3) float64
        Their standard errors, from the scatter of the medians over parts of the time; infinite where nothing is known.
    excess : float
        Variance of the differences as a multiple of that which the matches state (the variance of unit weight of a
        least squares adjustment), robust; 1 where it is not known.
    """

    offsets: F64
    errors: F64
    excess: float

    @property
    def is_off(self) -> B1:
        """(n_lasers,) whether the offset stands out of its error, and is not too small to matter."""
        least = np.array([_LEAST_SHIFT_M, _LEAST_SHIFT_M, _LEAST_TURN_RAD])
        return np.asarray((np.abs(self.offsets) > np.maximum(_SIGMAS * self.errors, least)).any(axis=1))

    @property
    def believed_share(self) -> float:
        """Factor on the information of each match, for errors that the scans of one laser have in common."""
        return 1.0 / self.excess if self.excess > _CLEAR_EXCESS else 1.0


def agreement(found: Registered, times_s: F64, laser: I64, first: int) -> Agreement:
    """Compare the poses found with each laser with those of laser *first*.

    Parameters
    ----------
    found : Registered
        Of n_scans scans.
    times_s : (n_scans,) float64
        Ascending.
    laser : (n_scans,) int64
        Which laser made each scan.
    first : int
    """
    n_lasers = int(laser.max()) + 1
    offsets, errors = np.zeros((n_lasers, 3)), np.full((n_lasers, 3), np.inf)
    is_good = (found.shares > _GOOD_SHARE) & found.fixes_position
    is_good &= np.linalg.eigvalsh(found.information)[:, 0] > _LEAST_INFORMATION
    reference = np.flatnonzero(is_good & (laser == first))
    squares: list[F64] = []
    for one in range(n_lasers):
        scans = np.flatnonzero(is_good & (laser == one))
        if one == first or reference.size < 2:
            continue
        scans, before, after = _between_scans(scans, reference, times_s)
        if scans.size < ENOUGH_SCANS:
            continue
        expected, covariance = _interpolated(found, times_s, scans, before, after)
        differences = between(expected, found.poses[scans])
        offsets[one], errors[one] = _median_with_error(differences)
        in_map = found.poses[scans] - expected
        in_map[:, 2] = wrap_angle(in_map[:, 2])
        covariance += np.linalg.inv(found.information[scans])
        squares.append(np.einsum("ni,ni->n", in_map, np.linalg.solve(covariance, in_map[..., None])[..., 0]))
    excess = float(np.median(np.concatenate(squares))) / _CHI2_MEDIAN if squares else 1.0
    return Agreement(offsets, errors, excess)


def _between_scans(scans: I64, reference: I64, times_s: F64) -> tuple[I64, I64, I64]:
    """The scans soon after one and soon before another reference scan, and these two."""
    place = np.searchsorted(times_s[reference], times_s[scans])
    is_inside = (place > 0) & (place < reference.size)
    scans, place = scans[is_inside], place[is_inside]
    before, after = reference[place - 1], reference[place]
    is_soon = times_s[after] - times_s[before] < _LONGEST_GAP_S
    return scans[is_soon], before[is_soon], after[is_soon]


def _interpolated(found: Registered, times_s: F64, scans: I64, before: I64, after: I64) -> tuple[F64, F64]:
    """Poses (n, 3) at the times of scans between two others each, and their covariances (n, 3, 3)."""
    elapsed_s = np.maximum(times_s[after] - times_s[before], 1e-9)
    share = (times_s[scans] - times_s[before]) / elapsed_s
    step = found.poses[after] - found.poses[before]
    step[:, 2] = wrap_angle(step[:, 2])
    covariance = np.zeros((scans.size, 3, 3))
    for part, rows in ((1.0 - share, before), (share, after)):
        covariance += part[:, None, None] ** 2 * np.linalg.inv(found.information[rows])
    return found.poses[before] + share[:, None] * step, covariance


def _median_with_error(differences: F64) -> tuple[F64, F64]:
    """Median (3,) of differences (n, 3) in the order of time, and its standard error.

    Differences that follow one another err together: what counts is how the medians over parts of the time differ.
    """
    medians = np.array([np.median(part, axis=0) for part in np.array_split(differences, _BLOCKS)])
    spread = 1.4826 * np.median(np.abs(medians - np.median(medians, axis=0)), axis=0)
    return np.median(differences, axis=0), 1.2533 * spread / np.sqrt(_BLOCKS)


@dataclass(frozen=True, slots=True)
class Mounting:
    """A laser that is not mounted as stated.

    Attributes
    ----------
    stated, found : (3,) float64
        robot_from_sensor: as the recording says, and so that its scans fit those of the first laser.
    first : (3,) float64
        robot_from_sensor of the first laser, which is believed.
    """

    stated: F64
    found: F64
    first: F64

    def sentence(self) -> str:
        """All of it in one line for people."""
        shift_m = float(np.linalg.norm(self.found[:2] - self.stated[:2]))
        turn_deg = abs(float(np.degrees(wrap_angle(self.found[2:] - self.stated[2:])[0])))
        return (
            f"laser at x {self.stated[0]:.3f} m, y {self.stated[1]:.3f} m: mounted {1e3 * shift_m:.0f} mm, "
            f"{turn_deg:.2f} deg off what is stated, relative to the laser at x {self.first[0]:.3f} m, "
            f"y {self.first[1]:.3f} m; taken out"
        )


def find_mountings(
    sensor_poses: F64, laser_index: I64, seen: I64, match: Callable[[F64], Registered], times_s: F64
) -> tuple[F64, Agreement]:
    """Move the lasers until the poses by their scans agree with those by the laser that made most.

    A wrong mounting shows only in part, as each scan also meets earlier ones of its own laser: it is found in steps,
    as long as each lessens the disagreement.

    Parameters
    ----------
    sensor_poses : (n_geometries, 3) float64
        robot_from_sensor, as stated.
    laser_index : (n_geometries,) int64
        Which laser a geometry belongs to.
    seen : (n_scans,) int64
        Which laser made each scan.
    match : callable
        Told sensor poses: the scans registered with them.
    times_s : (n_scans,) float64

    Returns
    -------
    (n_geometries, 3) float64
        The same where nothing is off.
    Agreement
        What is left.
    """
    first = int(np.bincount(seen).argmax())
    best, left = sensor_poses, agreement(match(sensor_poses), times_s, seen, first)
    is_off = left.is_off
    for _ in range(_MOST_ROUNDS if is_off.any() else 0):
        # A scan that was put in the wrong place says: the sensor is off by as much as the pose it gave.
        moves = np.zeros((int(laser_index.max()) + 1, 3))
        moves[: is_off.size][is_off] = left.offsets[is_off]
        moved = compose(moves[laser_index], best)
        moved = np.where(moves[laser_index].any(axis=1, keepdims=True), moved, best)
        found = agreement(match(moved), times_s, seen, first)
        if found.excess >= left.excess:
            break
        best, left = moved, found
    return best, left
