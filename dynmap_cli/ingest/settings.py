"""Settings of room 1."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

Coordinate = Annotated[float, Field(ge=-20.0, le=20.0)]
Angle = Annotated[float, Field(ge=-10.0, le=10.0)]
Degrees = Annotated[float, Field(ge=-360.0, le=360.0)]
MaskSector = tuple[Degrees, Degrees] | tuple[Degrees, Degrees, str]


class IngestSettings(BaseModel):
    """How recordings are read."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    scan_topic: str | None = Field(None, description="Topic of the laser scans; none = found on its own.")
    odom: str | None = Field(
        None,
        description="Topic of the odometry, 'tf', or 'none' to use no odometry; empty = found on its own.",
    )
    laser_pose: tuple[Coordinate, Coordinate, Angle] | None = Field(
        None, description="Pose of the laser on the robot, x m, y m, yaw rad; none = from tf or the log."
    )
    mask_sectors: tuple[MaskSector, ...] = Field(
        (),
        max_length=100,
        description="Sectors [from deg, to deg] in the robot's frame, counter-clockwise, whose beams are left out, "
        "as those that see the robot; a third entry names the laser. What never moves is found on its own.",
    )
    base_frame: str | None = Field(None, description="Frame of the robot in tf; none = found on its own.")
    odom_frame: str | None = Field(
        None, description="Frame of the odometry in tf; none = the one with 'odom' in its name."
    )
    cloud_heights_m: tuple[Coordinate, Coordinate] = Field(
        (0.2, 1.2),
        description="Heights above the robot's frame, m, between which points of a PointCloud2 make a scan.",
    )
    no_return: Literal["auto", "free", "ignore"] = Field(
        "auto",
        description="What a beam without return says: free up to the usable range, nothing, or found per recording.",
    )
    max_gap_s: float = Field(
        60.0,
        ge=0.0,
        le=1e9,
        description="Longest pause, s, after which a further recording still counts as the same drive.",
    )
    strict: bool = Field(
        False, description="Refuse recordings that are damaged, instead of using what is whole in them."
    )
    max_unpacked_gib: float = Field(
        16.0,
        gt=0.0,
        le=1e6,
        description="Most GiB that one compressed recording may unpack to; guards the disk.",
    )

    @field_validator("mask_sectors")
    @classmethod
    def _are_sectors(cls, sectors: tuple[MaskSector, ...]) -> tuple[MaskSector, ...]:
        """None is empty or the whole circle, of which nobody knows which of the two was meant."""
        for start, end, *_ in sectors:
            if (end - start) % 360.0 == 0.0:
                msg = f"the sector from {start:g} to {end:g} deg is empty or the whole circle"
                raise ValueError(msg)
        return sectors

    @field_validator("cloud_heights_m")
    @classmethod
    def _is_a_slice(cls, heights_m: tuple[float, float]) -> tuple[float, float]:
        """The lower height comes first."""
        if heights_m[0] >= heights_m[1]:
            msg = f"{heights_m[0]:g} must be less than {heights_m[1]:g}"
            raise ValueError(msg)
        return heights_m
