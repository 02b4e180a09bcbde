"""Beams that see the robot that carries the laser: as the operator says, and as the recording shows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import B1, F32, F64
from dynmap_cli.domain.mapped import give_back
from dynmap_cli.domain.poses import wrap_angle
from dynmap_cli.errors import LogError
from dynmap_cli.ingest.choices.merging import Columns
from dynmap_cli.ingest.raw.columns import blocks_of, known_rows
from dynmap_cli.ingest.raw.laser import RawLaser
from dynmap_cli.ingest.settings import MaskSector

_FARTHEST_M, _SAME_M = 1.0, 0.03
_LEAST_BEAMS = 10
"""With fewer no scan says where it was made."""
_STEP_M, _STEP_RAD = 0.1, math.radians(5.0)
_TURN_RAD = math.radians(2.0)
_LEAST_PATH_M = 3.0
_LEAST_TURN_RAD, _LEAST_TO_A_SIDE_RAD = math.radians(180.0), math.radians(45.0)
_LEAST_SCANS, _MOST_SCANS, _LEAST_TURNS = 40, 4000, 8
_LEAST_SAME, _LEAST_MEASURED = 0.97, 0.5
_AHEAD, _FARTHEST_AHEAD = 16, 4096
_BLOCK = 2048


@dataclass(frozen=True, slots=True)
class Moves:
    """Scans between which the robot moved.

    Attributes
    ----------
    rows : (k,) int64
        Each at least 0.1 m or 5 degrees from the one before.
    turns_rad : (k,) float64
        From the one before to it.
    path_m : float
    """

    rows: np.ndarray[tuple[int], np.dtype[np.int64]]
    turns_rad: F64
    path_m: float

    @property
    def is_enough(self) -> bool:
        """Whether what stands in the world cannot have kept its place: some metres, and turns to either side.

        A wall beside a straight drive does, and a pillar that is driven around, always to one side.
        """
        left_rad, right_rad = self.turned_rad(1.0), self.turned_rad(-1.0)
        turns_enough = (
            left_rad + right_rad >= _LEAST_TURN_RAD and min(left_rad, right_rad) >= _LEAST_TO_A_SIDE_RAD
        )
        return self.rows.size >= _LEAST_SCANS and self.path_m >= _LEAST_PATH_M and turns_enough

    def turned_rad(self, side: float) -> float:
        """Sum of the turns to the left (1) or right (-1)."""
        turns_rad = side * self.turns_rad
        return float(turns_rad[turns_rad >= _TURN_RAD].sum())


def moves_of(poses: F64, usable: B1) -> Moves:
    """Choose up to 4000 scans so that the robot moved from each to the next; the noise of odometry at rest is no move.

    Parameters
    ----------
    poses : (n, 3) float64
        Odometry; NaN = not known.
    usable : (n,) bool
        Scans to choose from.
    """
    known = np.flatnonzero(usable & known_rows(poses))
    chosen = [0] if known.size else []
    at, window = 1, _AHEAD
    ready: list[int] = []
    begin = end = 0
    while at < known.size and len(chosen) < _MOST_SCANS:
        if at == chosen[-1] + 1:
            # While the robot drives, the next is one of the first few.
            if at > end:
                begin = at - 1
                ready = _next_moved(poses[known[begin : begin + _BLOCK + _AHEAD]])
                end = begin + len(ready)
            step = ready[at - 1 - begin]
            if step:
                chosen.append(at - 1 + step)
                at, window = at + step, _AHEAD
            else:
                at, window = at + _AHEAD, 2 * _AHEAD
            continue
        is_away = _are_away(poses[known[at : at + window]], poses[known[chosen[-1]]])
        first = int(np.argmax(is_away))
        if is_away[first]:
            chosen.append(at + first)
            at, window = at + first + 1, _AHEAD
        else:
            at, window = at + window, min(2 * window, _FARTHEST_AHEAD)
    rows = known[np.array(chosen, dtype=np.int64)]
    steps = np.diff(poses[rows], axis=0)
    turns_rad = np.concatenate([np.zeros(min(rows.size, 1)), wrap_angle(steps[:, 2])])
    path_m = float(np.hypot(steps[:, 0], steps[:, 1]).sum())
    return Moves(rows, turns_rad, path_m)


def _next_moved(poses: F64) -> list[int]:
    """For each of the first 2048 poses (n, 3) how many later the robot has moved, of up to 16; 0 = not by then."""
    steps = np.zeros(min(poses.shape[0], _BLOCK), dtype=np.int64)
    for ahead in range(_AHEAD, 0, -1):
        later = poses[ahead : ahead + steps.size]
        steps[: later.shape[0]][_are_away(later, poses[: later.shape[0]])] = ahead
    found: list[int] = steps.tolist()
    return found


def _are_away(poses: F64, last: F64) -> B1:
    """(n,) whether the robot moved between poses (n, 3) and others, (n, 3) or (3,)."""
    is_away = np.hypot(poses[:, 0] - last[..., 0], poses[:, 1] - last[..., 1]) >= _STEP_M
    is_away |= np.abs(wrap_angle(poses[:, 2] - last[..., 2])) >= _STEP_RAD
    return np.asarray(is_away)


def own_body(ranges_m: F32, moves: Moves, range_min_m: float) -> F64:
    """Distance at which each beam meets the robot itself, (n_beams,); NaN where it does not.

    Such a return is within 1 m and the same to 3 cm in 97 % of the scans that measure anything there, over all of
    them and also over those after a turn to the left and after one to the right: in a turn all that stands in the
    world moves.

    Parameters
    ----------
    ranges_m : (n, n_beams) float32
        As recorded.
    moves : Moves
        Rows of *ranges_m*, of a drive in which the robot moved enough.
    range_min_m : float
        What is shorter is no return.
    """
    found = np.full(ranges_m.shape[1], np.nan)
    if moves.rows.size < _LEAST_SCANS:
        return found
    seen = np.empty((moves.rows.size, ranges_m.shape[1]), dtype=np.float32)
    for rows in blocks_of(seen):
        seen[rows] = ranges_m[moves.rows[rows]]
        give_back(ranges_m)
    is_measured = (seen >= np.float32(range_min_m)) & (seen > 0.0)
    is_near = is_measured & (seen < _FARTHEST_M)
    for beam in np.flatnonzero(is_near.mean(axis=0) >= _LEAST_MEASURED):
        middle_m = float(np.median(seen[is_near[:, beam], beam]))
        is_same = is_near[:, beam] & (np.abs(seen[:, beam] - middle_m) <= _SAME_M)
        parts = (
            np.ones(is_same.size, dtype=bool),
            moves.turns_rad >= _TURN_RAD,
            moves.turns_rad <= -_TURN_RAD,
        )
        counts = [np.count_nonzero(is_measured[part, beam]) for part in parts]
        if min(counts) >= _LEAST_TURNS and all(
            np.count_nonzero(is_same[part]) >= _LEAST_SAME * count
            for part, count in zip(parts, counts, strict=True)
        ):
            found[beam] = middle_m
    return found


def mask(
    columns: Columns,
    number: int,
    laser: RawLaser,
    bearings_rad: F64,
    yaw_rad: float,
    poses: F64,
    sectors: Sequence[MaskSector],
) -> str:
    """Take out beams in sectors that were set, and those that see the robot itself; says which.

    Parameters
    ----------
    columns : Columns
        Ranges of these beams become NaN.
    number : int
        Of the laser.
    laser : RawLaser
    bearings_rad : (n_geometries, n_beams) float64
        In the frame of the laser.
    yaw_rad : float
        Of the laser on the robot.
    poses : (n_scans, 3) float64
    sectors : sequence of (from deg, to deg) or (from deg, to deg, laser)
    """
    said = (
        mask_sectors(columns, number, laser.name, bearings_rad + yaw_rad, sectors),
        mask_body(columns, number, poses, laser.usual_shape.range_min_m, bearings_rad),
    )
    return "; ".join(filter(None, said))


def mask_body(columns: Columns, number: int, poses: F64, range_min_m: float, bearings_rad: F64) -> str:
    """Take out what a laser sees of the robot itself; what was taken out, in words, "" where nothing was.

    Parameters
    ----------
    columns : Columns
        Its ranges are changed.
    number : int
        Of the laser.
    poses : (n, 3) float64
        Odometry of each scan.
    range_min_m : float
    bearings_rad : (n_geometries, n_beams) float64
        In the frame of the laser.
    """
    moves = moves_of(poses, columns.laser == number)
    if not moves.is_enough:
        return ""
    geometry = columns.geometry_index[moves.rows]
    said: list[tuple[int, F64, F64]] = []
    for row in np.unique(geometry):
        is_of = geometry == row
        part = Moves(moves.rows[is_of], moves.turns_rad[is_of], moves.path_m)
        body_m = own_body(columns.ranges_m, part, range_min_m)
        beams = np.flatnonzero(np.isfinite(body_m))
        scans = np.flatnonzero(columns.geometry_index == row)
        for rows in blocks_of(columns.ranges_m) if beams.size else ():
            inside = scans[slice(*np.searchsorted(scans, (rows.start, rows.stop)))]
            ranges_m = columns.ranges_m[inside[:, None], beams]
            ranges_m[ranges_m <= body_m[beams] + _SAME_M] = np.nan
            columns.ranges_m[inside[:, None], beams] = ranges_m
            give_back(columns.ranges_m)
        if beams.size:
            said.append((beams.size, bearings_rad[row, beams], body_m[beams]))
    if not said:
        return ""
    most = max(count for count, _, _ in said)
    degrees, near_m = (
        np.degrees(np.concatenate([one for _, one, _ in said])),
        np.concatenate([one for *_, one in said]),
    )
    return (
        f"{most} beams between {degrees.min():.0f} and {degrees.max():.0f} deg hit the robot itself, at "
        f"{near_m.min():.2f} to {near_m.max():.2f} m: the same over {moves.path_m:.1f} m and through turns of "
        f"{math.degrees(moves.turned_rad(1.0)):.0f} deg to the left and {math.degrees(moves.turned_rad(-1.0)):.0f} deg "
        "to the right; left out"
    )


def unused_sectors(sectors: Sequence[MaskSector], names: Sequence[str]) -> list[str]:
    """One sentence on each sector of a laser that is not there, for who set it believes that the robot is masked."""
    return [
        f"ingest.mask_sectors {start:g},{end:g},{laser[0]}: not used, the recording has no such laser but "
        + ", ".join(sorted(names))
        for start, end, *laser in sectors
        if laser and laser[0] not in names
    ]


def mask_sectors(
    columns: Columns,
    number: int,
    name: str,
    directions_rad: F64,
    sectors: Sequence[MaskSector],
) -> str:
    """Take out the beams of a laser in sectors of the robot's frame; what was taken out, in words.

    Parameters
    ----------
    columns : Columns
        Its ranges are changed.
    number, name : int, str
        Of the laser.
    directions_rad : (n_geometries, n_beams) float64
        Of each beam in the frame of the robot.
    sectors : sequence of (from deg, to deg) or (from deg, to deg, laser)
        Counter-clockwise.

    Raises
    ------
    LogError
        If fewer beams are left than any stage can use.
    """
    mine = [(start, end) for start, end, *laser in sectors if not laser or laser[0] == name]
    if not mine:
        return ""
    most = 0
    for row, (laser, shape) in enumerate(columns.geometries):
        if laser != number:
            continue
        degrees = np.degrees(directions_rad[row])
        is_masked = np.zeros(degrees.size, dtype=bool)
        for start, end in mine:
            is_masked |= (degrees - start) % 360.0 <= (end - start) % 360.0
        left = int(np.count_nonzero(~is_masked[: shape.n_beams]))
        if left < min(_LEAST_BEAMS, shape.n_beams):
            sectors_words = "; ".join(f"{start:g},{end:g}" for start, end in mine)
            msg = (
                f"{name}: the sectors {sectors_words} of ingest.mask_sectors (--mask-sector) leave {left} of the "
                f"{shape.n_beams} beams of this laser, at least {_LEAST_BEAMS} are needed. "
                "Make them smaller, or name a laser."
            )
            raise LogError(msg)
        scans = np.flatnonzero(columns.geometry_index == row)
        for beam in np.flatnonzero(is_masked):
            columns.ranges_m[scans, beam] = np.nan
        most = max(most, int(np.count_nonzero(is_masked)))
    words = ", ".join(f"{start:g} to {end:g} deg" for start, end in mine)
    return f"{most} beams masked, as set: {words}"
