"""Settings of room 5; names that AMCL has mean what they mean there."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

Coordinate = Annotated[float, Field(ge=-1e7, le=1e7)]
Angle = Annotated[float, Field(ge=-1e3, le=1e3)]


class LocalizationSettings(BaseModel):
    """How pose and state of the world are tracked."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    start: tuple[Coordinate, Coordinate, Angle] | None = Field(
        None, description="Pose at the first scan in the map, x m, y m, yaw rad; none = found on its own."
    )
    start_sigma_m: float = Field(0.25, ge=1e-9, le=5, description="How far a given start pose may be off.")
    start_sigma_rad: float = Field(0.15, ge=1e-9, le=3.15, description="How far its yaw may be off.")
    start_pitch_m: float = Field(0.25, ge=0.05, le=1, description="Pitch of the lattice of a global start.")
    start_pitch_deg: float = Field(4.0, ge=1, le=30, description="Its step in yaw.")
    start_scans: int = Field(
        12,
        ge=1,
        le=20,
        description="Scans, 0.5 m or 20 degrees apart, of a global start; more while places look alike.",
    )

    min_particles: int = Field(1000, ge=10, le=1_000_000, description="Particles at least.")
    max_particles: int = Field(
        3000, ge=10, le=1_000_000, description="Particles at most; time grows with them."
    )
    pf_err: float = Field(
        0.05, ge=0.001, lt=1, description="KLD sampling: error of the distribution allowed."
    )
    pf_z: float = Field(
        0.99, ge=0.01, le=10, description="KLD sampling: upper quantile of the normal distribution."
    )
    update_min_d: float = Field(
        0.1, ge=0, le=1000, description="Metres to travel before scans are weighed again."
    )
    update_min_a: float = Field(
        0.1, ge=0, le=1000, description="Radians to turn before scans are weighed again."
    )
    update_max_s: float = Field(
        1.0, ge=0, le=1e6, description="Seconds after which a standing robot weighs a scan."
    )

    alpha1: float = Field(0.1, ge=0, le=10, description="Odometry noise: rotation from rotation.")
    alpha2: float = Field(0.1, ge=0, le=10, description="Odometry noise: rotation from translation.")
    alpha3: float = Field(0.1, ge=0, le=10, description="Odometry noise: translation from translation.")
    alpha4: float = Field(0.1, ge=0, le=10, description="Odometry noise: translation from rotation.")
    drift_sigma_m: float = Field(
        0.01, ge=0, le=10, description="Noise of every update in position: maps and clocks are not exact."
    )
    drift_sigma_rad: float = Field(0.005, ge=0, le=10, description="Noise of every update in yaw.")
    prediction_sigma_m: float = Field(
        0.05,
        ge=0.001,
        le=10,
        description="Without odometry: noise of the predicted position, plus 30 % of the step.",
    )
    prediction_sigma_rad: float = Field(
        0.1,
        ge=0.0001,
        le=10,
        description="Without odometry: noise of the predicted yaw, plus 30 % of the turn.",
    )

    sensor: Literal["likelihood_field", "beam"] = Field(
        "likelihood_field",
        description="What weighs particles: how near beams end to the map, or also what they pass (paper, Eq. 1.1).",
    )
    static_prior: float = Field(
        0.95, gt=0.5, lt=1, description="Beam model: probability that a beam hit what is in the map."
    )
    max_beams: int = Field(60, ge=4, le=2000, description="Beams of a scan that weigh particles.")
    z_hit: float = Field(0.5, ge=0.001, le=1, description="Share of ends near something in the map.")
    z_rand: float = Field(0.5, ge=0.001, le=1, description="Share of ends anywhere within laser_max_range.")
    sigma_hit: float = Field(0.1, ge=0.005, le=2, description="Metres that ends scatter around the map.")
    laser_likelihood_max_dist: float = Field(
        2.0, ge=0.05, le=10, description="Metres beyond which distance from the map no longer matters."
    )
    laser_max_range: float = Field(
        30.0, ge=0.5, le=1000, description="Metres; ends further away weigh nothing."
    )
    independent_beams: float = Field(
        15.0, ge=0.1, le=2000, description="How many independent beams a scan is worth; tempers the weights."
    )

    states: Literal["belief", "sampled"] = Field(
        "belief",
        description="States: a belief for what changes together, or a patch in every particle as in the paper.",
    )
    prior: Literal["uniform", "support", "hour"] = Field(
        "uniform",
        description="Belief before a state was looked at: all alike, as often as seen, or so at that hour (UTC).",
    )
    near_m: float = Field(
        2.0,
        ge=0,
        le=20,
        description="Particles this close to a rectangle are in that sub-map, where each has a state of its own.",
    )
    view_m: float = Field(
        8.0, ge=0.1, le=1000, description="States are learned from beams that reach them within this."
    )
    smooth: bool = Field(
        False, description="Look back over the whole recording, and write smoothed poses and states as well."
    )
    save_particles: bool = Field(False, description="Write the particles of every update to particles.npz.")

    @field_validator("states", mode="before")
    @classmethod
    def _name_of_before(cls, value: object) -> object:
        """Say what does now what a value of before did."""
        if value == "objects":
            msg = "`belief` replaces it"
            raise ValueError(msg)
        return value

    @model_validator(mode="after")
    def _at_most_is_not_less_than_at_least(self) -> Self:
        """Refuse more particles at least than at most."""
        if self.min_particles > self.max_particles:
            msg = f"min_particles {self.min_particles} exceeds max_particles {self.max_particles}"
            raise ValueError(msg)
        return self
