"""Messages from before and after a clock was set back, of which nobody knows any more in which order they came."""

from __future__ import annotations

import numpy as np

from dynmap_cli.ingest.choices.clock_sets import LEAST_BACK_NS
from dynmap_cli.ingest.choices.two_robots import LEAST_ALTERNATING, alternates
from dynmap_cli.ingest.raw.columns import steps_in
from dynmap_cli.ingest.raw.laser import most_used
from dynmap_cli.ingest.raw.recording import RawRecording, file_name

_MOST_LOOKED_AT, _MOST_DROPPED, _DOUBTFUL = 256, 0.5, 0.1


def drop_mixed(recording: RawRecording, first_ns: int, last_ns: int) -> None:
    """Leave out all messages of a time in which the sweeps show two places in turn; says so.

    What lies before and after is whole, and goes on in its odometry. Where that is less than half of the sweeps, all
    stays as it is, to be refused.
    """
    laser = most_used(recording.lasers.values())
    # Stamps that go back in this order are those of one source alone, whose clock was set.
    if laser is None or any((steps_ns < LEAST_BACK_NS).any() for steps_ns in steps_in(laser.stamps_ns)):
        return
    order = np.argsort(laser.stamps_ns, kind="stable")
    ordered_ns = laser.stamps_ns[order]
    start, stop = np.searchsorted(ordered_ns, [first_ns, last_ns + 1]).tolist()
    if stop - start < 4 or stop - start > _MOST_DROPPED * laser.n_scans:
        return
    starts = np.unique(np.linspace(start, stop - 4, min(_MOST_LOOKED_AT, stop - 3 - start)).astype(np.int64))
    rows = order[starts[:, None] + np.arange(4)]
    ranges_m = np.full((rows.size, int(laser.lengths_counted[0][-1])), np.nan, dtype=np.float32)
    laser.fill(ranges_m, rows.ravel())
    share = float(alternates(ranges_m.reshape(*rows.shape, -1), laser.shape_index[rows]).mean())
    if share <= _DOUBTFUL:
        return
    begin_s, end_s = ((at_ns - int(ordered_ns[0])) * 1e-9 for at_ns in (first_ns, last_ns))
    what = (
        f"{file_name(recording.name)}: from t = {begin_s:.1f} s to {end_s:.1f} s scans come twice as often, and "
        f"{100 * share:.0f} % of them show two places in turn, as where the clock was set back and messages were put "
        "in order since"
    )
    if share <= LEAST_ALTERNATING:
        recording.warnings.append(f"{what}: positions there may be wrong")
        return
    moving = [one for one in recording.transforms.values() if not one.is_static]
    for source in [*recording.lasers.values(), *recording.odometry.values(), *moving]:
        source.keep((source.stamps_ns < first_ns) | (source.stamps_ns > last_ns))
    recording.warnings.append(f"{what}: all of that time is left out, {stop - start} scans")
