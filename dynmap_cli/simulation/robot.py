"""What a scenario says of the robot: its path, its lasers, its wheels."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from dynmap_cli.simulation.quantities import (
    Coordinate,
    Degrees,
    Length,
    Mean,
    Part,
    Point,
    Rate,
    Scale,
    Seconds,
    Share,
    Speed,
    Spread,
)

_MOST_STEPS = 20_000


class Step(Part):
    """One step of the robot's path: go somewhere, wait, be switched off, or be carried."""

    to: Point | None = None
    backwards: bool = Field(False, description="Drive there in reverse.")
    wait_s: Seconds = Field(0.0, description="Stand afterwards, measuring.")
    off_s: Seconds = Field(0.0, description="Stand afterwards, switched off: nothing is recorded.")
    carried_to: tuple[Coordinate, Coordinate, Degrees] | None = Field(
        None,
        description="Then be lifted and set down here, x, y in m, yaw in deg; the wheels do not count it.",
    )
    carried_s: Seconds = Field(
        0.0, description="How long that takes, measuring: the laser is tilted meanwhile."
    )


def _step_from_point(value: Any) -> Any:
    """Let a plain point stand for a step that goes there."""
    return {"to": value} if isinstance(value, list | tuple) else value


class Robot(Part):
    """How the robot drives."""

    path: tuple[Annotated[Step, BeforeValidator(_step_from_point)], ...] = Field(
        (), description="Empty in a generated world: then each visit takes its own way."
    )
    repeat: int = Field(1, ge=1, le=10_000, description="Visits on a day: how often the path is driven.")
    pause_s: Seconds = Field(0.0, description="Time between two visits, switched off.")
    days: int = Field(1, ge=1, le=1000)
    night_s: Seconds = Field(57_600.0, description="Time between two days, switched off.")
    speed_mps: Speed = 0.8
    turn_rate_degps: Annotated[float, Field(ge=0.1, le=3600.0)] = 60.0
    corner_m: Spread = Field(0.5, description="Length by which corners are cut; 0 = turn on the spot.")

    @model_validator(mode="after")
    def _check_path(self) -> Robot:
        """The first step says where the robot starts."""
        if self.path and self.path[0].to is None:
            msg = "the first step of the path must be a place [x, y]: there the robot starts"
            raise ValueError(msg)
        if self.repeat * self.days * max(len(self.path), 1) > _MOST_STEPS:
            msg = f"{self.days} days of {self.repeat} visits are more than {_MOST_STEPS} steps of the path"
            raise ValueError(msg)
        return self


class Laser(Part):
    """A scanning laser."""

    name: str = Field("laser", pattern=r"^[a-z][a-z0-9_]*$")
    pose: tuple[Coordinate, Coordinate, Degrees] = Field(
        (0.0, 0.0, 0.0), description="On the robot: x, y in m, yaw in deg."
    )
    beams: int = Field(181, ge=2, le=20_000)
    fov_deg: float = Field(180.0, gt=0.0, le=360.0)
    clockwise: bool = False
    min_range_m: Spread = 0.05
    max_range_m: Length = 30.0
    rate_hz: Rate = 10.0
    beam_interval_s: Seconds = Field(0.0, description="Time from one beam to the next; 0 = all at once.")
    noise_m: Spread = Field(0.01, description="Standard deviation of a range.")
    noise_share: Spread = Field(0.0, description="Further standard deviation as a share of the range.")
    dropout_share: Share = Field(0.0, description="Share of beams that come back with nothing, at any angle.")
    grazing_deg: float = Field(
        0.0, ge=0.0, lt=90.0, description="Below this angle to a surface returns get lost, all of them at 0."
    )
    mixed_share: Share = Field(0.0, description="Share of edge beams that end between the two surfaces.")
    no_return: Literal["inf", "max", "zero"] = Field(
        "inf", description="What the recording says where nothing is."
    )
    sees: Literal["legs", "torso"] = Field("legs", description="Height: people's legs or trunks.")

    @model_validator(mode="after")
    def _check_times(self) -> Laser:
        """A sweep ends before the next begins."""
        if self.beam_interval_s * (self.beams - 1) > 1.0 / self.rate_hz:
            msg = (
                f"{self.beams} beams at {self.beam_interval_s:g} s each do not fit into 1/{self.rate_hz:g} s"
            )
            raise ValueError(msg)
        return self


class Odometry(Part):
    """How wheels count."""

    rate_hz: Rate = 20.0
    translation_scale: Scale = 1.0
    rotation_scale: Scale = 1.0
    bias_degpm: Degrees = Field(0.0, description="Turn that is counted per metre driven, degrees.")
    sigma_m_per_sqrt_m: Spread = Field(0.02, description="Noise of the length after one metre.")
    sigma_deg_per_sqrt_m: Spread = Field(0.5, description="Noise of the direction after one metre.")
    sigma_deg_per_sqrt_turn: Spread = Field(3.0, description="Noise of the direction after a full turn.")
    slips_per_100m: Spread = Field(0.0, description="How often a wheel slips.")
    slip_deg: Spread = Field(10.0, description="Standard deviation of the turn that a slip feigns.")
    lag_s: float = Field(
        0.0, ge=-60.0, le=60.0, description="How late its time stamps are; negative = early."
    )
    signed: bool = Field(True, description="False: reversing is counted as driving forwards.")
    freezes_per_hour: Spread = 0.0
    freeze_s: Mean = Field(3.0, description="Length of a freeze: motion meanwhile is not counted.")
