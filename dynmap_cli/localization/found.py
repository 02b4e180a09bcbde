"""What the filter finds along a recording: poses, states of the sub-maps in view, and the health of each update."""

from __future__ import annotations

from dataclasses import dataclass, field

from dynmap_cli.arrays import B1, F64
from dynmap_cli.domain.poses import Trajectory
from dynmap_cli.localization.particles.motion import Motion
from dynmap_cli.localization.particles.particle_filter import Particles
from dynmap_cli.localization.pose_rows import PoseRow
from dynmap_cli.localization.watching.health import ScanHealth


@dataclass(frozen=True, slots=True)
class StateRow:
    """Belief in the states of one sub-map after one scan.

    Attributes
    ----------
    stamp_ns : int
    submap : int
        Index in the pool.
    belief : (n_states,) float64
    objects_in_view : (n_objects,) bool
        Which of its objects beams tell on from off.
    """

    stamp_ns: int
    submap: int
    belief: F64
    objects_in_view: B1


@dataclass(frozen=True, slots=True)
class HealthRow:
    """How one update went.

    Attributes
    ----------
    stamp_ns : int
    health : ScanHealth
    log_likelihood_per_beam : float
        Of the ends at the best pose.
    effective_particles : float
    patch_entropy_bits : float
        Of the states of all sub-maps in view, added up.
    verdict : str
        tracking, changed or lost.
    lost : float
        How much speaks for a wrong pose, see `Verdict.measure`.
    contradiction : float
        How much of that the scans say, see `Verdict.contradiction`.
    """

    stamp_ns: int
    health: ScanHealth
    log_likelihood_per_beam: float
    effective_particles: float
    patch_entropy_bits: float
    verdict: str
    lost: float = 0.0
    contradiction: float = 0.0


@dataclass(frozen=True, slots=True)
class Localization:
    """Where the robot was and what the world looked like.

    Attributes
    ----------
    trajectory : Trajectory
        One pose per scan.
    poses : list of PoseRow
        One per update.
    states : list of StateRow
    health : list of HealthRow
        One per update.
    searches : list of int
        Stamps at which the robot was lost for so long that the whole map was searched for it.
    clouds : list of (stamp_ns, Particles)
        Weighted particles of every update; empty unless they are asked for.
    warnings : list of str
        What was left out, one sentence each.
    laser_motions : dict of int to Motion
        From the update before, to the scan of an update, where its scans were matched; else that of the odometry.
    alike : list of str
        Drives that fit the map from several places, one sentence each.
    """

    trajectory: Trajectory
    poses: list[PoseRow]
    states: list[StateRow]
    health: list[HealthRow]
    searches: list[int]
    clouds: list[tuple[int, Particles]]
    warnings: list[str]
    laser_motions: dict[int, Motion] = field(default_factory=dict)
    alike: list[str] = field(default_factory=list)
