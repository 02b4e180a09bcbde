"""What the user has to know about a map before trusting it: one sentence each, empty where all is well."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from dynmap_cli.arrays import F64
from dynmap_cli.domain.poses import wrap_angle
from dynmap_cli.scan_matching.calibration import Calibration
from dynmap_cli.scan_matching.wheel_faults import WheelFault, runs

WRONG_MAP = 0.06
"""Share of contradicting places above which a map is wrong; right maps stay under 0.024."""
_LAG_S, _LAG_SCANS = 0.05, 0.3
_MOST_FAULTS = 5
_BARE, _CORRIDOR_M = 0.006, 3.0
_RETURN_M, _WAY_M, _SPACING_M = 1.0, 20.0, 0.5
_LONG_WAY_M = 50.0
_BENT_RAD = np.radians(10.0)


def warn_of_carries(times_s: Sequence[tuple[float, float]]) -> list[str]:
    """Where the robot seems to have been carried: from and to, seconds since the first sweep of the drive."""
    return [
        f"at t = {begin_s:.1f} s the robot seems to have been carried (until t = {end_s:.1f} s): what it saw before "
        "and after contradicts its odometry. The map may be bent there; cut the recording at this time, and build the "
        "parts together, as two recordings"
        for begin_s, end_s in times_s
    ]


def warn_of_odometry(calibration: Calibration) -> list[str]:
    """Late or early stamps, and a missing sign."""
    lines = []
    for lag, least, unit in (
        (calibration.lag_s, _LAG_S, "s"),
        (calibration.lag_scans, _LAG_SCANS, "scans"),
    ):
        if abs(lag) > least:
            word = "lags the scans" if lag > 0 else "runs ahead of the scans"
            lines.append(f"odometry {word} by {abs(lag):.2f} {unit}; taken out")
    if calibration.reversible:
        lines.append("odometry never runs backwards although the robot does; directions come from the scans")
    return lines


def warn_of_wheels(faults: Sequence[WheelFault]) -> list[str]:
    """Where odometry stood still or slipped; at most a few, the others are counted."""
    lines = [_fault_sentence(fault) for fault in faults[:_MOST_FAULTS]]
    if len(faults) > _MOST_FAULTS:
        rest = len(faults) - _MOST_FAULTS
        often = "once more" if rest == 1 else f"{rest} more times"
        lines.append(f"odometry was wrong {often}, see wheel_faults in the manifest")
    return lines


def _fault_sentence(fault: WheelFault) -> str:
    when = f"from t = {fault.start_s:.1f} s to {fault.end_s:.1f} s"
    moved = f"{fault.scans_m:.1f} m and {np.degrees(fault.scans_rad):+.0f} deg"
    if fault.is_frozen:
        return f"odometry stood still {when} while the robot moved {moved}"
    counted = f"{fault.odometry_m:.1f} m and {np.degrees(fault.odometry_rad):+.0f} deg"
    what = "wheels slipped" if fault.odometry_m > fault.scans_m + 0.1 else "odometry was wrong"
    return f"{what} {when}: counted {counted}, by the scans the robot moved {moved}"


def warn_of_corridors(poses: F64, information: F64, *, has_odometry: bool) -> list[str]:
    """Length of the way along which the scans say nothing about the distance travelled.

    Parameters
    ----------
    poses : (n_scans, 3) float64
        In the order of the sweeps.
    information : (n_scans, 3, 3) float64
        What the match knows about each pose, without what noise feigns, map frame.
    has_odometry : bool
        Whether any scan has odometry.
    """
    values, vectors = np.linalg.eigh(information[:, :2, :2])
    is_bare = (values[:, 0] < _BARE * values[:, 1]) & (values[:, 1] > 0.0)
    steps = np.diff(poses[:, :2], axis=0, prepend=poses[:1, :2])
    along = np.abs(np.einsum("ni,ni->n", steps, vectors[:, :, 0])) * is_bare
    stretches = [float(along[first:last].sum()) for first, last in runs(np.asarray(is_bare))]
    total = sum(length for length in stretches if length >= _CORRIDOR_M)
    if total == 0.0:
        return []
    return [
        f"corridor: {total:.0f} m with no information along it; how far the robot went comes from "
        f"{_source(has_odometry=has_odometry)}"
    ]


def warn_of_missing_loops(poses: F64, n_loops: int) -> list[str]:
    """Whether no loop was found although the path returns to where it was before, or is long.

    Parameters
    ----------
    poses : (n, 3) float64
        Of the key scans, in the order of the sweeps.
    n_loops : int
    """
    if n_loops:
        return []
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1))])
    kept = np.unique(
        np.searchsorted(way, np.arange(0.0, way[-1] + _SPACING_M, _SPACING_M)).clip(0, way.size - 1)
    )
    pairs = cKDTree(poses[kept, :2]).query_pairs(_RETURN_M, output_type="ndarray")
    if not bool((np.abs(way[kept[pairs[:, 0]]] - way[kept[pairs[:, 1]]]) > _WAY_M).any()):
        if way[-1] <= _LONG_WAY_M:
            return []
        return [f"no place was seen twice on {way[-1]:.0f} m: the overall shape of the map is unverified"]
    return [
        f"no loop found although the path returns within {_RETURN_M:.0f} m of itself; the map may be double there"
    ]


def warn_of_bent_path(motion: F64, poses: F64, n_loops: int) -> list[str]:
    """Whether the path turns otherwise than the odometry says, on the whole, and no loop tells which is right.

    Parameters
    ----------
    motion : (n_scans, 3) float64
        Calibrated odometry steps as of `corrected_motion`, NaN where they are missing or not believed.
    poses : (n_scans, 3) float64
        In the order of the sweeps.
    n_loops : int
    """
    if n_loops:
        return []
    apart = wrap_angle(np.diff(poses[:, 2]) - motion[1:, 2])
    bend = float(np.nansum(apart))
    if abs(bend) <= _BENT_RAD:
        return []
    return [
        f"heading of the map departs from the odometry's by {np.degrees(bend):+.0f} deg over the whole path, "
        "and no loop tells which is right"
    ]


def warn_of_lost_scans(n_lost: int, n_scans: int, *, has_odometry: bool) -> list[str]:
    """Scans that fitted nowhere."""
    if n_lost == 0:
        return []
    source = _source(has_odometry=has_odometry)
    return [f"{n_lost} of {n_scans} scans fitted nowhere; their poses come from {source}"]


def _source(*, has_odometry: bool) -> str:
    """What the path follows where the scans say nothing."""
    return "the odometry" if has_odometry else "constant motion"


def warn_of_contradictions(share: float) -> list[str]:
    """Places that were seen twice and cannot both be right."""
    if share <= WRONG_MAP:
        return []
    return [
        f"{100 * share:.0f} % of the places seen twice contradict each other in free space; the map is probably "
        "wrong somewhere, see loops.csv"
    ]
