"""What is known of a recording's odometry."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

ENOUGH_SCANS = 100
"""Steps that must match well for a calibration."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """What is wrong with a recording's odometry, as far as the scans tell.

    Attributes
    ----------
    lag_scans : float
        The odometry of scan i is that of scan i + lag_scans; 0 where the lag is given in seconds.
    lag_s : float
        The same in seconds of the scan stamps.
    rotation_scale : float
        True turn per turn of the odometry.
    rotation_bias_rad_m : float
        Additional turn per metre travelled.
    translation_scale : float
    turn_noise_rad, turn_noise_share : float
        Standard deviation of a turn: constant part, and share of the turn.
    shift_noise_m, shift_noise_share : float
        The same for the shift.
    reversible : bool
        The odometry has no sign: the robot reverses, the odometry never does.
    step_noise_m, step_noise_rad : float
        Standard deviation of shift and turn of a step of corrected odometry against the scans, as measured (robust).
    n_steps : int
        Steps this was found from; 0 = too few, the odometry is taken as it is.
    sweep : str
        In which order the beams of a sweep were seen to be made: "first to last", "last to first", or "at once"
        where the scans fit best without correction for the motion during the sweep.
    is_revolution : bool
        A sweep lasts from its stamp to the next, though the recording says that it is made in much less.
    """

    lag_scans: float = 0.0
    lag_s: float = 0.0
    rotation_scale: float = 1.0
    rotation_bias_rad_m: float = 0.0
    translation_scale: float = 1.0
    turn_noise_rad: float = 0.005
    turn_noise_share: float = 0.1
    shift_noise_m: float = 0.01
    shift_noise_share: float = 0.2
    reversible: bool = False
    step_noise_m: float = 0.0
    step_noise_rad: float = 0.0
    n_steps: int = 0
    sweep: str = "at once"
    is_revolution: bool = False

    def sentence(self) -> str:
        """All of it in one line for people."""
        if self.n_steps == 0:
            return f"odometry taken as it is: less than {ENOUGH_SCANS} steps in it match well"
        lag = f"{self.lag_s:+.3f} s" if self.lag_s else f"{self.lag_scans:+.2f} scans"
        sign = "no sign, " if self.reversible else ""
        return (
            f"odometry: lag {lag}, turns x {self.rotation_scale:.3f} "
            f"{np.degrees(self.rotation_bias_rad_m):+.2f} deg per metre, distance x {self.translation_scale:.3f}, "
            f"{sign}then {1e3 * self.step_noise_m:.1f} mm and {np.degrees(self.step_noise_rad):.2f} deg "
            f"from the scans per step ({self.n_steps} steps)"
        )
