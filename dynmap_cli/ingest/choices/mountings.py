"""How the lasers that are used sit on the robot: as set, as found, as their turns show, or at its centre."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dynmap_cli.errors import LogError
from dynmap_cli.ingest.choices.frames import Mounting
from dynmap_cli.ingest.choices.lasers import LaserChoice
from dynmap_cli.ingest.raw.recording import RawRecording
from dynmap_cli.ingest.seen_motion.turns import Headings, ScanTurns, turns_of
from dynmap_cli.ingest.settings import IngestSettings

_FARTHEST_LASER_M = 20.0
_AT_CENTRE = Mounting(np.zeros(3), is_upside_down=False, is_level=True, moves=False, is_assumed=True)


def mounting_of(choice: LaserChoice, settings: IngestSettings, joined: RawRecording) -> Mounting:
    """How a used laser sits on the robot: as set, as found, or at the centre with a warning."""
    if settings.laser_pose is not None:
        return Mounting(np.array(settings.laser_pose), is_upside_down=False, is_level=True, moves=False)
    laser, found = choice.view.laser, choice.view.mounting
    if found is not None:
        away_m = float(np.hypot(*found.robot_from_sensor[:2]))
        if away_m > _FARTHEST_LASER_M:
            msg = (
                f"{joined.name}: {laser.name} would sit {away_m:.0f} m from the centre of the robot (at most "
                f"{_FARTHEST_LASER_M:.0f} m). Its transform is wrong; pass --laser-pose X,Y,YAW."
            )
            raise LogError(msg)
        return found
    frame = f"frame '{laser.frame}'" if laser.frame else "the laser"
    joined.warnings.append(
        f"{laser.name}: the recording does not say where {frame} sits on the robot; "
        "taken to be its centre. Pass --laser-pose X,Y,YAW"
    )
    return _AT_CENTRE


def robot_turns(choice: LaserChoice, mounting: Mounting, headings: Headings) -> ScanTurns:
    """How the robot turned by the sweeps of a laser, above all where odometries turn."""
    turns = turns_of(choice.view.laser, headings)
    if mounting.is_upside_down:
        seen = replace(turns.pairs, bearings_rad=-turns.pairs.bearings_rad)
        turns = replace(turns, turns_rad=-turns.turns_rad, pairs=seen)
    return replace(turns, robot_from_sensor=mounting.robot_from_sensor)


def turned_over(mounting: Mounting, name: str, joined: RawRecording) -> Mounting:
    """The other way up, which is said."""
    way = "the right way up" if mounting.is_upside_down else "upside down"
    joined.warnings.append(
        f"{name}: its scans turn left where the odometry turns right; its beams are taken to run the other way, as "
        f"where the laser hangs {way} and the recording does not say so; if it does not, the odometry turns the wrong "
        "way, and the map is wrong or a mirror image"
    )
    return replace(mounting, is_upside_down=not mounting.is_upside_down)
