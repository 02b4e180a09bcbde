"""The filter of Eq. 1.24 along a recording: pose, states of the sub-maps in view, and health of every update."""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from dynmap_cli.arrays import F64, I64
from dynmap_cli.domain.poses import Trajectory, compose, inverse
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.errors import LogError
from dynmap_cli.localization.beliefs.states import (
    LEAST_BEAMS,
    PlacedSweep,
    StateEvidence,
    entropy_bits,
    place_sweep,
    state_evidence,
    update_belief,
)
from dynmap_cli.localization.beliefs.world import World
from dynmap_cli.localization.found import HealthRow, Localization, StateRow
from dynmap_cli.localization.particles.motion import (
    Motion,
    predicted_step,
    sample_motion,
    step_between,
    updated_velocity,
)
from dynmap_cli.localization.particles.particle_filter import (
    ONE_MODE_SHARE,
    Estimate,
    Particles,
    estimate_pose,
    resample,
    reweigh,
)
from dynmap_cli.localization.particles.particle_states import carry_states
from dynmap_cli.localization.pose_rows import pose_row
from dynmap_cli.localization.sensing.map_pool import MapPool
from dynmap_cli.localization.sensing.sensor import Sweep, scan_log_likelihoods, sweep_of, temper
from dynmap_cli.localization.sensing.weighing import Weighing, weighing_of
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.localization.starting.global_start import (
    LEAST_RETURNS,
    draw_start,
    given_start,
    is_usable,
    possible_starts,
    search_again,
)
from dynmap_cli.localization.starting.modes import is_near
from dynmap_cli.localization.starting.undecided import moved_words, undecided_words
from dynmap_cli.localization.watching.health import LOST, Novelties, Patience, Verdict, scan_health
from dynmap_cli.localization.watching.unmapped import Unmapped
from dynmap_cli.progress import Tick, no_tick

WIDEST_SPREAD_M = 0.5
"""States are learned only while the particles in the heaviest place agree this well on the pose; the few that are
far away say nothing of how well."""
SETTLED_SHARE = 0.99
"""Weight in one place from which on its states are those that all particles believe in; until then, and again when
less than `ONE_MODE_SHARE` is in one place, each particle has its own, so that a wrong place spoils nothing."""


def localize_log(
    log: ScanLog,
    pool: MapPool,
    settings: LocalizationSettings,
    *,
    seed: int,
    threads: int = 1,
    tick: Tick = no_tick,
) -> Localization:
    """Track pose and states through all drives of a log.

    Every drive starts anew, the first one at the given pose if there is one: between two drives a robot may have been
    carried anywhere. What was learned about states is kept, and grows old. Odometry and times between beams are taken
    as they are, see `with_sound_odometry`.

    Raises
    ------
    LogError
        If no scan has enough returns.
    """
    poses = np.full((log.n_scans, 3), np.nan)
    result = Localization(Trajectory(log.stamps_ns, poses), [], [], [], [], [], [])
    random = np.random.default_rng(seed)
    world = World(pool)
    with ThreadPoolExecutor(max_workers=max(threads, 1)) as executor:
        for scans in _drives(log):
            first = next((scan for scan in scans.tolist() if is_usable(log, scan, settings)), None)
            if first is None:
                names = ", ".join(log.recordings_of(int(log.drive_index[scans[0]])))
                result.warnings.append(f"{names}: no scan has enough returns")
                continue
            is_given = settings.start is not None and scans[0] == 0
            if is_given:
                particles = given_start(np.array(settings.start), settings, random)
            else:
                starts = possible_starts(log, first, pool, settings, executor)
                if words := undecided_words(starts, log.recordings_of(int(log.drive_index[first]))):
                    result.alike.append(words)
                particles = draw_start(starts, settings, random)
            tracker = _Tracker(log, pool, settings, random, executor, world, result, is_given=is_given)
            tracker.run(scans, first, particles, tick)
    if log.n_scans and not bool(np.isfinite(poses).any()):
        msg = (
            f"{', '.join(log.recordings)}: no scan has enough returns to be localized. Check the laser topic."
        )
        raise LogError(msg)
    _fill_gaps(poses)
    return result


class _Tracker:
    """The filter on one drive."""

    def __init__(
        self,
        log: ScanLog,
        pool: MapPool,
        settings: LocalizationSettings,
        random: np.random.Generator,
        executor: ThreadPoolExecutor,
        world: World,
        result: Localization,
        *,
        is_given: bool,
    ) -> None:
        self._log, self._pool, self._settings = log, pool, settings
        self._random, self._executor, self._world, self._result = random, executor, world, result
        self._novelties, self._verdict, self._patience = (
            Novelties(pool),
            Verdict(is_given=is_given),
            Patience(is_given=is_given),
        )
        self._velocity, self._has_odometry = np.zeros(3), log.has_odometry
        self._predicts = not bool(self._has_odometry.all())
        self._sweep: tuple[int, Sweep] | None = None
        self._carries_states = True
        self._unmapped = Unmapped(log, pool, settings)
        self._is_given, self._given_at = is_given, -1
        self._placed_at = len(result.health)

    def run(self, scans: I64, first: int, particles: Particles, tick: Tick) -> None:
        """Go through the scans of the drive; those before the first usable one are put in at the end."""
        poses = self._result.trajectory.poses
        self._choose_states(estimate_pose(particles))
        self._given_at = first if self._is_given else -1
        updated = first
        for scan in range(first, int(scans[-1]) + 1):
            motion = self._motion(updated, scan)
            if scan == first or self._is_due(updated, scan, motion):
                particles = self._update(updated, scan, motion, particles)
                updated = scan
            else:
                poses[scan] = compose(poses[updated], motion.step)
            tick()
        for scan in range(first - 1, int(scans[0]) - 1, -1):
            poses[scan] = compose(poses[first], inverse(self._motion(scan, first).step))
            tick()

    def _motion(self, start: int, end: int) -> Motion:
        """From odometry where both scans have it, else as before."""
        odometry = self._log.odometry
        if self._has_odometry[start] and self._has_odometry[end]:
            return Motion(step_between(odometry[start], odometry[end]), measured=True)
        seconds = (self._log.stamps_ns[end] - self._log.stamps_ns[start]) * 1e-9
        return Motion(predicted_step(self._velocity, float(seconds)), measured=False)

    def _is_due(self, updated: int, scan: int, motion: Motion) -> bool:
        """Whether a scan is weighed: after some way, turn or time; without odometry always."""
        settings = self._settings
        seconds = (self._log.stamps_ns[scan] - self._log.stamps_ns[updated]) * 1e-9
        is_due = (
            not motion.measured
            or math.hypot(motion.step[0], motion.step[1]) >= settings.update_min_d
            or abs(float(motion.step[2])) >= settings.update_min_a
            or float(seconds) >= settings.update_max_s
        )
        return is_due and self._sweep_at(scan).n_returns >= LEAST_RETURNS

    def _sweep_at(self, scan: int) -> Sweep:
        """The beams of a scan; the last one is kept, as it is asked for twice."""
        if self._sweep is None or self._sweep[0] != scan:
            self._sweep = scan, sweep_of(self._log, scan, self._settings.laser_max_range)
        return self._sweep[1]

    def _update(self, updated: int, scan: int, motion: Motion, particles: Particles) -> Particles:
        """Predict, weigh, learn the states in view, judge, resample."""
        settings, stamp = self._settings, int(self._log.stamps_ns[scan])
        seconds = (stamp - int(self._log.stamps_ns[updated])) * 1e-9
        sweep = self._sweep_at(scan)
        before = particles.poses
        motion = self._unmapped.improved(scan, motion)
        if motion.sigmas is not None:
            self._result.laser_motions[scan] = motion
        every_end = weighing_of(sweep, self._pool, settings)
        weighing = self._unmapped.weighed(every_end, motion)
        if scan != updated:
            particles = replace(particles, poses=sample_motion(before, motion, settings, self._random))
        if self._carries_states:
            particles, estimate, in_view = self._weigh_with_states(particles, sweep, weighing, seconds, stamp)
            placed = place_sweep(sweep, estimate.pose)
        else:
            particles = self._weigh(particles, weighing, stamp)
            estimate = estimate_pose(particles)
            placed = place_sweep(sweep, estimate.pose)
            in_view = self._learn_states(estimate, placed, stamp)
        if scan != updated and self._predicts:
            self._velocity = updated_velocity(
                self._velocity, before, particles.poses, particles.weights, seconds
            )
        self._remember(scan, placed, every_end.ends_m, particles, estimate, in_view)
        if self._carries_states or estimate.share < ONE_MODE_SHARE:
            self._choose_states(estimate)
        verdict = self._verdict
        if self._patience.is_over(is_in_doubt=verdict.is_in_doubt, is_off_map=verdict.is_off_map):
            found = self._search(scan, estimate.pose)
            if found is not None:
                return found
        if particles.effective < particles.count / 2:
            particles = resample(particles, settings, self._random)
        return particles

    def _search(self, scan: int, pose: F64) -> Particles | None:
        """Look for the robot in the whole map; what fits better elsewhere was lost.

        A given start that is confirmed is no search for a robot that was lost.
        """
        result = self._result
        is_given = scan == self._given_at
        if self._verdict.is_off_map and not self._verdict.placement.speaks_for_it:
            found: Particles | None = self._start_anew(scan)
        else:
            found = search_again(
                self._log,
                scan,
                pose,
                self._pool,
                self._settings,
                self._random,
                self._executor,
                is_given=is_given,
            )
        if found is not None or self._verdict.is_in_doubt:
            result.searches.append(int(self._log.stamps_ns[scan]))
        if found is None:
            return None
        if is_given:
            self._result.warnings.append(moved_words(pose, estimate_pose(found).pose))
        self._verdict.found_elsewhere()
        result.health[-1] = replace(result.health[-1], verdict="lost", lost=self._verdict.measure)
        if not is_near(estimate_pose(found).pose[None, :], pose)[0]:
            self._leave_place()
        self._verdict = Verdict()
        self._unmapped.jumped()
        self._choose_states(estimate_pose(found))
        return found

    def _start_anew(self, scan: int) -> Particles:
        """Particles wherever the next scans fit the map, as if the drive began here."""
        starts = possible_starts(self._log, scan, self._pool, self._settings, self._executor)
        return draw_start(starts, self._settings, self._random)

    def _leave_place(self) -> None:
        """A place that was never confirmed, and is left for a better one, was wrong from its beginning on."""
        rows = self._result.health
        if not self._verdict.placement.is_confirmed:
            rows[self._placed_at : -1] = [
                row if row.verdict == "lost" else replace(row, verdict="lost", lost=row.lost + LOST)
                for row in rows[self._placed_at : -1]
            ]
        self._placed_at = len(rows)

    def _choose_states(self, estimate: Estimate) -> None:
        """Let each particle have states of its own until they agree on a place well enough to have learned its states.

        In a map that shows all states at once particles shift to where nothing changes.
        """
        self._carries_states = self._settings.states == "sampled" or not _is_settled(estimate, SETTLED_SHARE)

    def _weigh(self, particles: Particles, weighing: Weighing, stamp: int) -> Particles:
        """Weigh every particle by the scan, in the map as it is believed to be."""
        middle = particles.weights @ particles.poses[:, :2]
        self._world.show(self._world.near(middle, self._settings.laser_max_range), stamp)
        log_likelihoods = weighing.log_likelihoods(particles.poses, None, self._executor)
        return reweigh(particles, weighing.tempered(log_likelihoods, particles.weights))

    def _learn_states(self, estimate: Estimate, placed: PlacedSweep, stamp: int) -> list[StateRow]:
        """Weigh the states of all sub-maps in view by the scan at the best pose."""
        if not _is_settled(estimate, ONE_MODE_SHARE):
            return []
        exponent, rows = temper(placed.lengths_m.size, self._settings), []
        for number, evidence in self._evidence(placed):
            belief = update_belief(self._world.belief(number, stamp), exponent * evidence.log_likelihoods)
            self._world.learn(number, stamp, belief)
            rows.append(StateRow(stamp, number, belief, evidence.objects_in_view))
        return rows

    def _weigh_with_states(
        self, particles: Particles, sweep: Sweep, weighing: Weighing, seconds: float, stamp: int
    ) -> tuple[Particles, Estimate, list[StateRow]]:
        """Weigh every particle by the scan, each with a state of its own.

        What the particles say of the states is what is believed once they agree on a place.
        """
        settings, world = self._settings, self._world
        is_sampled = settings.states == "sampled"
        carried = carry_states(
            particles,
            weighing,
            seconds=seconds,
            within_m=settings.near_m,
            entering=world.alike if is_sampled else lambda number: world.belief(number, stamp),
            executor=self._executor,
        )
        estimate, rows = estimate_pose(carried.weighed()), []
        if _is_settled(estimate, ONE_MODE_SHARE):
            # Also under the beam model: particles shift by a cell to explain a door they passed, the mean does not.
            exponent = temper(sweep.ranges_m.size, settings)
            for number, evidence in self._evidence(place_sweep(sweep, estimate.pose)):
                more = carried.with_evidence(number, exponent * evidence.through)
                belief = more.belief(number, evidence.through.size)
                if belief is not None:
                    carried = more
                    rows.append(StateRow(stamp, number, belief, evidence.objects_in_view))
            estimate = estimate_pose(carried.weighed())
        if is_sampled or _is_settled(estimate, SETTLED_SHARE):
            for row in rows:
                world.learn(row.submap, stamp, row.belief)
        return carried.drawn(self._random), estimate, rows

    def _evidence(self, placed: PlacedSweep) -> Iterator[tuple[int, StateEvidence]]:
        """What the scan says at the best pose about each sub-map in view."""
        for number in self._world.near(placed.sensor_m, self._settings.view_m):
            evidence = state_evidence(placed, self._pool, self._pool.submaps[number], self._settings)
            if evidence.n_beams >= LEAST_BEAMS:
                yield number, evidence

    def _remember(
        self,
        scan: int,
        placed: PlacedSweep,
        ends: F64,
        particles: Particles,
        estimate: Estimate,
        in_view: list[StateRow],
    ) -> None:
        """Keep pose, states and health of an update."""
        result, stamp = self._result, int(self._log.stamps_ns[scan])
        result.trajectory.poses[scan] = estimate.pose
        result.poses.append(pose_row(stamp, scan, particles, estimate))
        likeliest = self._world.likeliest(
            self._world.near(estimate.pose[:2], self._settings.laser_max_range), stamp
        )
        health = scan_health(placed, self._pool, likeliest, self._novelties, stamp * 1e-9)
        verdict = self._verdict.judge(self._unmapped.excused(health), estimate)
        settled_at = estimate.pose if _is_settled(estimate, ONE_MODE_SHARE) else None
        self._unmapped.watch(health, settled_at, is_in_doubt=self._verdict.is_in_doubt)
        total = scan_log_likelihoods(self._pool.pool, self._pool.frame, estimate.pose[None, :], ends)
        result.states.extend(in_view)
        result.health.append(
            HealthRow(
                stamp_ns=stamp,
                health=health,
                log_likelihood_per_beam=float(total[0]) / max(ends.shape[0], 1),
                effective_particles=particles.effective,
                patch_entropy_bits=sum(entropy_bits(row.belief) for row in in_view),
                verdict=verdict,
                lost=self._verdict.measure,
                contradiction=self._verdict.contradiction,
            )
        )
        if self._settings.save_particles:
            result.clouds.append((stamp, particles))


def _is_settled(estimate: Estimate, least_share: float) -> bool:
    """Whether the particles agree on a place well enough to learn from it what the world looks like."""
    return estimate.share >= least_share and estimate.cluster_spread_m <= WIDEST_SPREAD_M


def _drives(log: ScanLog) -> Iterator[I64]:
    """Scans of each stretch that comes from one drive."""
    if log.n_scans:
        cuts = np.flatnonzero(np.diff(log.drive_index)) + 1
        yield from np.split(np.arange(log.n_scans), cuts)


def _fill_gaps(poses: F64) -> None:
    """Give scans of a recording that could not be localized the nearest known pose."""
    known = np.flatnonzero(np.isfinite(poses).all(axis=1))
    for scan in np.flatnonzero(~np.isfinite(poses).all(axis=1)):
        poses[scan] = poses[known[np.argmin(np.abs(known - scan))]]
