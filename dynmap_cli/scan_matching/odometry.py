"""Calibration of the odometry, on each recording, before it is trusted.

Time lag, rotation scale and bias, translation scale and noise come from a first pass of scan matching.
"""

from __future__ import annotations

import numpy as np

from dynmap_cli.arrays import B1, F64
from dynmap_cli.domain.poses import between, wrap_angle
from dynmap_cli.scan_matching.calibration import ENOUGH_SCANS, Calibration

_MAX_LAG_SCANS, _MAX_LAG_S = 3.0, 0.6
_ENOUGH_BACKWARDS = 10
_ENOUGH_TURNING = 30
_STEP_M = 0.02
_LAG_STEPS, _SMOOTHING = 5, np.array([1.0, 2.0, 3.0, 2.0, 1.0]) / 9.0
_TURN_CAP_RAD = 0.05
_CLEARLY_LESS, _LESS_THAN_WITHOUT = 0.95, 0.97
_BLOCK_RAD, _BLOCK_M = 0.1, 1.0
_SCALE_PRIOR_RAD, _BIAS_PRIOR_M, _SCALE_ROUNDS = 3.0, 10.0, 3


def corrected_motion(odometry: F64, times_s: F64, calibration: Calibration) -> F64:
    """Motion of each step in the frame of the scan before, corrected; row 0 is zero, NaN where odometry is missing.

    Parameters
    ----------
    odometry : (n, 3) float64
        odom_from_robot per scan.
    times_s : (n,) float64
        Ascending times of the scans.
    calibration : Calibration

    Returns
    -------
    (n, 3) float64
    """
    if odometry.shape[0] < 2:
        return np.zeros_like(odometry)
    shifted = _shifted(odometry, times_s, calibration.lag_scans, calibration.lag_s)
    motion = np.zeros_like(odometry)
    motion[1:] = between(shifted[:-1], shifted[1:])
    motion[:, :2] *= calibration.translation_scale
    distance = np.linalg.norm(motion[:, :2], axis=1)
    motion[:, 2] = calibration.rotation_scale * motion[:, 2] + calibration.rotation_bias_rad_m * distance
    return motion


def calibrate(
    odometry: F64,
    times_s: F64,
    matched: F64,
    is_good: B1,
    is_sure: B1,
    *,
    reversible: bool,
    in_seconds: bool = False,
) -> Calibration:
    """Estimate lag, scales, bias and noise from the steps that scan matching found.

    Parameters
    ----------
    odometry : (n, 3) float64
    times_s : (n,) float64
        Ascending.
    matched : (n, 3) float64
        Poses of the first pass.
    is_good : (n,) bool
        Scans whose match can be trusted.
    is_sure : (n,) bool
        Scans whose match fixes the position in both directions; only those tell distances.
    reversible : bool
        Shifts are compared without their sign.
    in_seconds : bool
        Whether the lag is to be given in seconds in any case.
    """
    steps = between(matched[:-1], matched[1:])
    usable = (
        is_good[1:]
        & is_good[:-1]
        & np.isfinite(odometry[1:]).all(axis=1)
        & np.isfinite(odometry[:-1]).all(axis=1)
    )
    if int(usable.sum()) < ENOUGH_SCANS:
        return Calibration(reversible=reversible)
    lag_scans, loss_scans = _best_lag(odometry, times_s, steps, usable, in_seconds=False)
    lag_s, loss_s = _best_lag(odometry, times_s, steps, usable, in_seconds=True)
    if in_seconds or loss_s < _CLEARLY_LESS * loss_scans:
        lag_scans = 0.0
    else:
        lag_s = 0.0
    motion = corrected_motion(odometry, times_s, Calibration(lag_scans=lag_scans, lag_s=lag_s))[1:]
    turns, distances = motion[:, 2], np.linalg.norm(motion[:, :2], axis=1)
    scale, bias = _robust_turns(turns[usable], distances[usable], steps[usable, 2])
    forward = np.abs(steps[:, 0]) if reversible else steps[:, 0]
    fixed = usable & is_sure[1:] & is_sure[:-1]
    straight = fixed & (np.abs(turns) < 0.02) & (distances > 0.02)
    translation = (
        float(np.median(forward[straight] / distances[straight])) if int(straight.sum()) > 50 else 1.0
    )
    residual = np.abs(wrap_angle(steps[:, 2] - scale * turns - bias * distances))
    turning = usable & (np.abs(turns) > 0.02)
    still = usable & (np.abs(turns) <= 0.02)
    share = _spread(residual[turning] / np.abs(turns[turning])) if turning.any() else 0.1
    constant = _spread(residual[still]) if still.any() else 0.005
    translation = translation if 0.5 < translation < 2.0 else 1.0
    travelled = np.linalg.norm(steps[:, :2], axis=1)
    return Calibration(
        lag_scans=lag_scans,
        lag_s=lag_s,
        rotation_scale=scale,
        rotation_bias_rad_m=bias,
        translation_scale=translation,
        turn_noise_rad=float(np.clip(constant, 0.002, 0.02)),
        turn_noise_share=float(np.clip(share, 0.05, 0.4)),
        reversible=reversible,
        step_noise_m=_spread(travelled[fixed] - translation * distances[fixed]),
        step_noise_rad=_spread(residual[usable]),
        n_steps=int(usable.sum()),
    )


def lacks_sign(odometry: F64, matched: F64, is_sure: B1) -> bool:
    """Whether the robot reverses, the odometry never does, and says forward instead.

    Parameters
    ----------
    odometry, matched : (n, 3) float64
    is_sure : (n,) bool
        Scans whose match fixes the position in both directions; along a bare corridor any step fits.
    """
    forward = between(odometry[:-1], odometry[1:])[:, 0]
    if not (np.nansum(forward > _STEP_M) > ENOUGH_SCANS and np.nansum(forward < -_STEP_M / 2) == 0):
        return False
    found = between(matched[:-1], matched[1:])[:, 0]
    backwards = is_sure[1:] & is_sure[:-1] & (forward > _STEP_M) & (found < -_STEP_M)
    # Robots reverse for a while; a single step is more likely a wrong match.
    in_a_row = backwards[:-1] & backwards[1:]
    return int(in_a_row.sum()) >= _ENOUGH_BACKWARDS


def _spread(residual: F64) -> float:
    """Robust standard deviation around zero, 0 without values."""
    return 1.48 * float(np.median(np.abs(residual))) if residual.size else 0.0


def _shifted(odometry: F64, times_s: F64, lag_scans: float, lag_s: float) -> F64:
    """Odometry at the scans' times plus the lag; ends are held."""
    index = np.arange(odometry.shape[0], dtype=np.float64)
    if lag_s:
        index = np.interp(times_s + lag_s, times_s, index)
    index = np.clip(index + lag_scans, 0, odometry.shape[0] - 1)
    left = np.minimum(index.astype(np.int64), odometry.shape[0] - 2)
    share = (index - left)[:, None]
    delta = odometry[left + 1] - odometry[left]
    delta[:, 2] = wrap_angle(delta[:, 2])
    return np.asarray(odometry[left] + share * delta)


def _best_lag(
    odometry: F64, times_s: F64, steps: F64, usable: B1, *, in_seconds: bool
) -> tuple[float, float]:
    """Lag with the least residual turn, by a grid and a parabola; returns lag and loss.

    Headings are smoothed, and turns over several steps are compared, each time with the scale that fits best: where
    turns are counted an eighth too small, that is most of what is left of them, whatever the lag. A lag is only seen in
    turns: where there are few, or it is no better in these, there is none. Between two scans odometry is interpolated,
    which averages the noise of single steps, so a lag has to be better by more than that.
    """
    limit = _MAX_LAG_S if in_seconds else _MAX_LAG_SCANS
    lags = np.linspace(-limit, limit, 61)
    length = _LAG_STEPS + _SMOOTHING.size - 1
    whole = np.convolve(usable, np.ones(length), mode="valid") > length - 0.5
    if int(whole.sum()) < ENOUGH_SCANS:
        return 0.0, 0.0
    found = _smooth_turns(np.concatenate([[0.0], np.cumsum(steps[:, 2])]))[whole]
    is_turning = np.abs(found) > _TURN_CAP_RAD
    if int(is_turning.sum()) < _ENOUGH_TURNING:
        return 0.0, 0.0
    losses, in_turns = np.empty(lags.size), np.empty(lags.size)
    for k, lag in enumerate(lags):
        shifted = _shifted(odometry, times_s, 0.0 if in_seconds else lag, lag if in_seconds else 0.0)
        residual = np.abs(_without_scale(found, _smooth_turns(np.unwrap(shifted[:, 2]))[whole]))
        capped = np.minimum(residual, _TURN_CAP_RAD * np.sqrt(_LAG_STEPS))
        losses[k], in_turns[k] = capped.mean(), capped[is_turning].mean()
    best, none = int(np.argmin(losses)), lags.size // 2
    scans = lags / (float(np.median(np.diff(times_s))) if in_seconds else 1.0)
    # The lag itself, or one of the whole scans beside it, which average nothing.
    is_near = np.abs(scans - scans[best]) <= 1.0
    is_less = in_turns[is_near] <= _LESS_THAN_WITHOUT * in_turns[none] * _noise_left(scans[is_near])
    if not 0 < best < lags.size - 1 or not is_less.any():
        return 0.0, float(losses[none])
    before, here, after = losses[best - 1 : best + 2]
    bend = before - 2.0 * here + after
    offset = 0.5 * (before - after) / bend if bend > 0 else 0.0
    return float(lags[best] + offset * (lags[1] - lags[0])), float(here)


def _noise_left(lags_scans: F64) -> F64:
    """Shares (n,) of the noise of smoothed headings that interpolation by lags (n,) leaves; 1 for whole scans."""
    shares = (lags_scans - np.floor(lags_scans))[:, None]
    earlier, later = np.pad(_SMOOTHING, (0, 1)), np.pad(_SMOOTHING, (1, 0))
    left = np.linalg.norm((1.0 - shares) * earlier + shares * later, axis=1)
    return np.asarray(left / np.linalg.norm(_SMOOTHING))


def _smooth_turns(headings: F64) -> F64:
    """Turns over some steps between smoothed headings, one for each run of steps that enters."""
    smooth = np.convolve(headings, _SMOOTHING, mode="valid")
    return np.asarray(smooth[_LAG_STEPS:] - smooth[:-_LAG_STEPS])


def _without_scale(found: F64, turns: F64) -> F64:
    """What is left of turns (n,) of the scans without those of the odometry (n,), times their scale.

    The scale explains the turns of the odometry by those of the scans, reweighted, with a weak prior of 1, as that of
    all steps does.
    """
    share = 1.0
    prior = _SCALE_PRIOR_RAD * 1e-2
    for _ in range(_SCALE_ROUNDS):
        residual = turns - share * found
        spread = 1.48 * float(np.median(np.abs(residual))) + 1e-4
        weighted = found / (1.0 + (residual / (2.0 * spread)) ** 2)
        share = (float(weighted @ turns) + prior) / (float(weighted @ found) + prior)
        share = min(max(share, 0.5), 2.0)
    return found - turns / share


def _robust_turns(turns: F64, distances: F64, found: F64) -> tuple[float, float]:
    """Scale and bias of the turns by reweighted least squares, with weak priors 1 and 0.

    The turns of the odometry are explained by those that the scans found, not the other way round: the noise is in the
    odometry, and what is noisy has to stand on the left of a regression, or its noise pulls the scale towards zero.
    Steps are summed up until they make a turn or a way that stands out of the noise of the scans.
    """
    sums = np.cumsum(np.abs(found) / _BLOCK_RAD + distances / _BLOCK_M)
    block = np.unique(sums.astype(np.int64), return_inverse=True)[1]
    odometry, way, scans = (np.bincount(block, weights=each) for each in (turns, distances, found))
    design = np.column_stack([scans, way])
    prior = np.diag([_SCALE_PRIOR_RAD, _BIAS_PRIOR_M]) * 1e-2
    weights = np.ones(odometry.size)
    share, drift = 1.0, 0.0
    for _ in range(8):
        normal = design.T @ (weights[:, None] * design) + prior
        share, drift = np.linalg.solve(
            normal, design.T @ (weights * odometry) + prior @ np.array([1.0, 0.0])
        ).tolist()
        residual = odometry - design @ np.array([share, drift])
        spread = 1.48 * float(np.median(np.abs(residual))) + 1e-4
        weights = 1.0 / (1.0 + (residual / (2.0 * spread)) ** 2)
    return (1.0 / share, -drift / share) if 0.5 < share < 2.0 else (1.0, 0.0)
