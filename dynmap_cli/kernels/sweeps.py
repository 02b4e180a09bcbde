"""One placed scan in the map: the surfaces its beams cross, what explains their ends, and what the states say of it."""

from __future__ import annotations

import math

import numpy as np

from dynmap_cli.arrays import B1, F32, F64, I64, U8
from dynmap_cli.kernels.crossings import first_crossing, passing_share
from dynmap_cli.kernels.jit import kernel


@kernel
def place_beams(directions_rad: F64, lengths_m: F64, pose: F64, out_rad: F64, out_m: F64) -> None:
    """Write the directions and the ends of beams that start at a pose (3,).

    Parameters
    ----------
    directions_rad, lengths_m : (n,) float64
        Seen from the pose.
    pose : (3,) float64
    out_rad : (n,) float64
    out_m : (n, 2) float64
    """
    for k in range(directions_rad.size):
        out_rad[k] = directions_rad[k] + pose[2]
        out_m[k, 0] = pose[0] + lengths_m[k] * math.cos(out_rad[k])
        out_m[k, 1] = pose[1] + lengths_m[k] * math.sin(out_rad[k])


@kernel
def _cell_of(x_m: float, y_m: float, cell: F64) -> tuple[int, int]:
    """Row and column of a point in a grid whose corner (x, y) and edge of a cell are given (3,), in metres."""
    return int(math.floor((y_m - cell[1]) / cell[2])), int(math.floor((x_m - cell[0]) / cell[2]))


@kernel
def walls_crossed(
    surfaces: U8,
    cell: F64,
    sensor_m: F64,
    directions_rad: F64,
    lengths_m: F64,
    least_sine: float,
    crossings_m: F64,
    behind_m: F64,
) -> None:
    """Write where beams cross the first surface on their way, and how far behind it they end.

    Parameters
    ----------
    surfaces : (rows, cols) uint8
        As for `first_crossing`.
    cell : (3,) float64
        x and y of the grid's lower left corner, and the edge of a cell, in metres.
    sensor_m : (2,) float64
    directions_rad, lengths_m : (n,) float64
        In the map frame.
    least_sine : float
        Of the angle with a surface.
    crossings_m : (n, 2) float64
        The sensor for beams that cross nothing.
    behind_m : (n,) float64
        -inf for beams that cross nothing.
    """
    x, y = (sensor_m[0] - cell[0]) / cell[2], (sensor_m[1] - cell[1]) / cell[2]
    for beam in range(directions_rad.size):
        dx, dy = math.cos(directions_rad[beam]), math.sin(directions_rad[beam])
        _, crossed = first_crossing(surfaces, x, y, dx, dy, lengths_m[beam] / cell[2], least_sine)
        behind_m[beam] = lengths_m[beam] - crossed * cell[2]
        distance = crossed * cell[2] if math.isfinite(crossed) else 0.0
        crossings_m[beam, 0] = sensor_m[0] + distance * dx
        crossings_m[beam, 1] = sensor_m[1] + distance * dy


@kernel
def weigh_states(
    surfaces: U8,
    passes: F32,
    owned: B1,
    pool: F32,
    field_start: I64,
    cell: F64,
    sensor_m: F64,
    directions_rad: F64,
    lengths_m: F64,
    ends_m: F64,
    hits: B1,
    values: F64,
    limits: F64,
    switches: I64,
    at_ends: F64,
    through: F64,
    told: I64,
) -> int:
    """Write what a scan says of each state of a sub-map; return how many beams tell them apart.

    Parameters
    ----------
    surfaces : (n_states, rows, cols) uint8
        As for `first_crossing`.
    passes : (n_states, rows, cols) float32
        As for `passing_share`.
    owned : (rows, cols) bool
    pool : (n,) float32
        Log-likelihood of an end, in which the field of each state starts at *field_start* (n_states,) int64.
    cell : (3,) float64
        x and y of the sub-map's lower left corner, and the edge of a cell, in metres.
    sensor_m : (2,) float64
    directions_rad, lengths_m : (n,) float64
        In the map frame.
    ends_m : (n, 2) float64
    hits : (n,) bool
        Beams that hit something.
    values : (2,) float64
        Log-likelihood of an end on the map, and of one far from it.
    limits : (4,) float64
        Sine of the least angle with a surface; how far a beam goes on behind it at least, and how far the
        sub-map is at most, metres; difference of log-likelihoods by which a beam tells states apart.
    switches : (n_pairs, 3) int64
        An object, and two states that differ in it; by objects.
    at_ends, through : (n_states,) float64
        Sums: of ends inside, and of what is added for beams that went through something.
    told : (n_objects,) int64
        Beams that tell apart the states of one of the pairs of each object.
    """
    rows, cols = owned.shape
    x, y = (sensor_m[0] - cell[0]) / cell[2], (sensor_m[1] - cell[1]) / cell[2]
    beyond = limits[1] / cell[2]
    at_ends[:] = 0.0
    through[:] = 0.0
    told[:] = 0
    n_beams, said = 0, np.zeros(field_start.size)
    for beam in range(directions_rad.size):
        dx, dy = math.cos(directions_rad[beam]), math.sin(directions_rad[beam])
        length = lengths_m[beam] / cell[2]
        row, col = _cell_of(ends_m[beam, 0], ends_m[beam, 1], cell)
        inside = hits[beam] and 0 <= row < rows and 0 <= col < cols and owned[row, col]
        lowest, highest = math.inf, -math.inf
        for state in range(field_start.size):
            enter, share = passing_share(
                surfaces[state], passes[state], x, y, dx, dy, length, beyond, limits[0]
            )
            if not enter * cell[2] <= limits[2]:
                break
            end = values[0]
            said[state] = 0.0
            if inside:
                end = np.float64(pool[field_start[state] + row * cols + col])
                said[state] = end
                at_ends[state] += end
            if share < 1.0:
                more = math.log(share + (1.0 - share) * math.exp(values[1] - end))
                through[state] += more
                said[state] += more
            lowest, highest = min(lowest, said[state]), max(highest, said[state])
        if highest - lowest >= limits[3]:
            n_beams += 1
            last = -1
            for pair in range(switches.shape[0]):
                thing = switches[pair, 0]
                if thing != last and abs(said[switches[pair, 1]] - said[switches[pair, 2]]) >= limits[3]:
                    told[thing] += 1
                    last = thing
    return n_beams


@kernel
def are_marked(points_m: F64, cell: F64, marked: B1, out: B1) -> None:
    """Write whether each point lies in a marked cell; points outside the grid count for its border.

    Parameters
    ----------
    points_m : (n, 2) float64
    cell : (3,) float64
        x and y of the grid's lower left corner, and the edge of a cell, in metres.
    marked : (rows, cols) bool
    out : (n,) bool
    """
    rows, cols = marked.shape
    for k in range(points_m.shape[0]):
        row, col = _cell_of(points_m[k, 0], points_m[k, 1], cell)
        out[k] = marked[min(max(row, 0), rows - 1), min(max(col, 0), cols - 1)]


@kernel
def explain_by_states(
    ends_m: F64, cell: F64, owned: B1, explained: B1, state: int, now: B1, other: B1
) -> None:
    """Overwrite, for ends in own cells of a sub-map, whether one state explains them, and whether only others do.

    Parameters
    ----------
    ends_m : (n, 2) float64
    cell : (3,) float64
        x and y of the sub-map's lower left corner, and the edge of a cell, in metres.
    owned : (rows, cols) bool
    explained : (n_states, rows, cols) bool
    state : int
    now, other : (n,) bool
    """
    rows, cols = owned.shape
    for k in range(ends_m.shape[0]):
        row, col = _cell_of(ends_m[k, 0], ends_m[k, 1], cell)
        if 0 <= row < rows and 0 <= col < cols and owned[row, col]:
            by_any = False
            for k_state in range(explained.shape[0]):
                by_any |= explained[k_state, row, col]
            now[k] = explained[state, row, col]
            other[k] = by_any and not now[k]


@kernel
def sort_beams(
    hits: B1,
    now: B1,
    other: B1,
    behind_m: F64,
    in_free: B1,
    on_map: B1,
    clips: B1,
    limits: F64,
    counts: I64,
    things: B1,
    openings: B1,
) -> None:
    """Count the beams with a return by what explains them, and write which show something that the map has not.

    Parameters
    ----------
    hits, now, other, in_free, on_map, clips : (n,) bool
        Whether a beam hit something; its end is explained by the likeliest states, or by others only; it ends where
        the map is free; it ends on what is in the map, in any state; what it went through is the edge of a wall only.
    behind_m : (n,) float64
        How far behind the first wall on its way it ends.
    limits : (2,) float64
        Metres behind a wall from which on a beam went through it, and from which on it shows an opening.
    counts : (7,) int64
        Beams that hit something; explained now, by others, and by none; of the last, those that went through
        a wall into the free, those that went through one to where the map knows nothing, and those that did neither
        and end where the map knows nothing.
    things, openings : (n,) bool
        Unexplained and through no more than an edge, or through nothing and not on the map; through a wall.
    """
    counts[:] = 0
    for k in range(hits.size):
        unexplained = hits[k] and not (now[k] or other[k])
        through = behind_m[k] > limits[0]
        things[k] = (unexplained and clips[k]) or (hits[k] and not on_map[k] and not through)
        openings[k] = hits[k] and behind_m[k] > limits[1]
        counts[0] += hits[k]
        counts[1] += hits[k] and now[k]
        counts[2] += hits[k] and other[k]
        counts[3] += unexplained
        counts[4] += unexplained and through and in_free[k]
        counts[5] += unexplained and through and not in_free[k]
        counts[6] += unexplained and not through and not in_free[k]
