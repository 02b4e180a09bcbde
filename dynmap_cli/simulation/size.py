"""Whether a scenario is of a size that can be simulated, found out before anything long begins."""

from __future__ import annotations

import numpy as np

from dynmap_cli.domain.grid import frame_around
from dynmap_cli.errors import ConfigError
from dynmap_cli.simulation.driving import plan_drive
from dynmap_cli.simulation.scenario import Scenario
from dynmap_cli.simulation.shapes import shapes_of
from dynmap_cli.simulation.worlds import expand

MOST_READINGS = 300_000_000
"""Beams of all scans: 46 hours of 181 beams at 10 Hz."""
MOST_SECONDS = 40_000_000
MOST_TICKS = 20_000_000
MOST_MOVER_SECONDS = 20_000_000


def check_size(scenario: Scenario) -> None:
    """Refuse what would take days or more memory than there is.

    Raises
    ------
    ConfigError
        One line with what is too large, and what is allowed.
    """
    written_out = expand(scenario)
    drive = plan_drive(written_out.robot)
    recorded_s = sum(end - begin for begin, end in drive.recorded_spans())
    people = sum(getattr(mover, "count", 1) for mover in written_out.movers)
    sizes = {
        "seconds from first to last": (drive.duration_s, MOST_SECONDS),
        "readings of the lasers": (
            recorded_s * sum(laser.rate_hz * laser.beams for laser in scenario.lasers),
            MOST_READINGS,
        ),
        "odometry messages": (
            recorded_s * (scenario.odometry.rate_hz if scenario.odometry else 0.0),
            MOST_TICKS,
        ),
        "seconds of all movers together": (people * recorded_s, MOST_MOVER_SECONDS),
    }
    for what, (found, most) in sizes.items():
        if found > most:
            msg = f"the scenario makes {found:.3g} {what}, at most {most:.3g} are simulated. Make it shorter."
            raise ConfigError(msg)
    shapes = shapes_of(written_out.world)
    points = np.concatenate([shapes.segments.reshape(-1, 2), shapes.circles[:, :2], drive.poses[:, :2]])
    try:
        frame_around(points, scenario.map_resolution_m, 1.0)
    except ValueError as err:
        msg = f"{err}. Make the world smaller, or map_resolution_m larger."
        raise ConfigError(msg) from err
