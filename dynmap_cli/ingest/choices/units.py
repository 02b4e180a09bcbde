"""Ranges that are not in metres: told by their size, for no laser that sweeps a plane sees most things 100 m away.

Three quarters of the returns lie within 2 to 12 m where robots drive, that is below 1200 in centimetres and from 1800
on in millimetres. A reach that is stated comes first: in metres the returns have to keep to it, in the unit of the
ranges it has to be that of a laser.
"""

from __future__ import annotations

import numpy as np

from dynmap_cli.arrays import F64
from dynmap_cli.errors import LogError
from dynmap_cli.ingest.raw.laser import RawLaser
from dynmap_cli.ingest.raw.recording import RawRecording

_SAMPLED_SWEEPS = 200
_FARTHEST_MEDIAN_M = 100.0
_LARGEST_CM, _LEAST_MM = 1200.0, 1800.0
_USUAL_QUANTILE, _CODES = 0.75, 0.98
_SHORTEST_REACH_M, _LONGEST_REACH_M, _REACH_SHARES = 3.0, 120.0, (0.05, 1.05)
_UNITS = {"centimetres": 0.01, "millimetres": 0.001}


def mend_units(recording: RawRecording) -> None:
    """Bring ranges that are in centimetres or millimetres to metres, and say so.

    Raises
    ------
    LogError
        If they are not in metres, and nobody can tell in what.
    """
    for laser in recording.lasers.values():
        values = _returns_of(laser)
        if not values.size or np.median(values) <= _FARTHEST_MEDIAN_M:
            continue
        usual = float(np.quantile(values, _USUAL_QUANTILE))
        units = _units_for(usual, laser.usual_shape.range_max_m)
        if len(units) != 1:
            msg = (
                f"{recording.name}: the ranges of {laser.name} cannot be metres, half of them are above "
                f"{float(np.median(values)):.0f}, and neither centimetres nor millimetres fit clearly. Convert them to "
                "metres, or record them so; or pass another --scan-topic."
            )
            raise LogError(msg)
        laser.scale_ranges(_UNITS[units[0]])
        recording.warnings.append(
            f"{laser.name}: three quarters of its ranges are below {usual:.0f}, half of them above "
            f"{float(np.median(values)):.0f}: taken to be in {units[0]}"
        )


def _returns_of(laser: RawLaser) -> F64:
    """Readings (n,) of some sweeps that are returns, without the largest, which are often codes."""
    values = laser.sample(_SAMPLED_SWEEPS)
    found = values[np.isfinite(values) & (values > 0.0)].astype(np.float64)
    return np.asarray(found[found < _CODES * found.max(initial=0.0)])


def _units_for(usual: float, reach: float) -> list[str]:
    """Units in which a reading that a quarter of the returns exceed is one, and the returns keep to the reach."""
    if reach <= _LONGEST_REACH_M:
        low, high = _REACH_SHARES
        units = [name for name, metres in _UNITS.items() if low * reach <= usual * metres <= high * reach]
    else:
        units = [
            name for name, metres in _UNITS.items() if _SHORTEST_REACH_M <= reach * metres <= _LONGEST_REACH_M
        ]
    if len(units) == 1:
        return units
    if usual < _LARGEST_CM:
        return ["centimetres"]
    return ["millimetres"] if usual >= _LEAST_MM else []
