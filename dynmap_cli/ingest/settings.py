"""Settings of room 1."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class IngestSettings(BaseModel):
    """How recordings are read."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    scan_topic: str | None = Field(None, description="Topic of the laser scans; none = found on its own.")
    odom: str | None = Field(
        None,
        description="Topic of the odometry, 'tf', or 'none' to use no odometry; empty = found on its own.",
    )
    laser_pose: tuple[float, float, float] | None = Field(
        None, description="Pose of the laser on the robot, x m, y m, yaw rad; none = from tf or the log."
    )
    no_return: Literal["auto", "free", "ignore"] = Field(
        "auto",
        description="What a beam without return says: free up to the usable range, nothing, or found per recording.",
    )
