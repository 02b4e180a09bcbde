"""The door of the room: a run and the scans of a recording -> comparison.csv, over_time.csv and two figures."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dynmap_cli.arrays import F64
from dynmap_cli.comparison.conclusion import conclusion
from dynmap_cli.comparison.courses import Course, course_in, true_positions_m
from dynmap_cli.comparison.maps import ComparedMap, compared_maps
from dynmap_cli.config import Config
from dynmap_cli.domain.poses import Trajectory, compose, interpolate, inverse
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.errors import ArtifactError, LogError
from dynmap_cli.evaluation.association import associate, known_poses
from dynmap_cli.evaluation.trajectories import LEAST_POSES, align, read_reference
from dynmap_cli.files.areas_digest import KEY, areas_digest
from dynmap_cli.files.patch_archive import read_names
from dynmap_cli.files.registered import with_mountings_of
from dynmap_cli.files.scan_log import read_scan_log
from dynmap_cli.files.trajectory import format_stamp, read_tum
from dynmap_cli.localization.beliefs.parts import believed_parts
from dynmap_cli.localization.odometry import with_sound_odometry
from dynmap_cli.localization.particles.particle_filter import estimate_pose
from dynmap_cli.localization.sensing.map_pool import make_map_pool
from dynmap_cli.localization.stage import outside
from dynmap_cli.localization.starting.global_start import global_start, is_usable
from dynmap_cli.progress import progress
from dynmap_cli.stage import Stage, StageContext

SUMMARY_HEADER = (
    "map,updates,particle_error_mean_m,pose_error_mean_m,pose_error_p95_m,pose_error_max_m,spread_mean_m,"
    "log_likelihood_per_beam_mean,lost_share,away_from_patch_map_mean_m,away_from_patch_map_max_m"
)
OVER_TIME_HEADER = (
    "stamp_s,map,x_m,y_m,yaw_rad,particle_error_m,pose_error_m,spread_m,log_likelihood_per_beam,"
    "away_from_patch_map_m,is_lost"
)


TABLES = ("comparison.csv", "over_time.csv")
ERRORS_NAME, SPREAD_NAME, STATES_NAME = "pose_error.png", "spread.png", "states.png"
"""Without truth there are no errors; without a sub-map in view there are no states."""


@dataclass(frozen=True, slots=True)
class TruthFiles:
    """Where the truth stands.

    Attributes
    ----------
    recording : Path or None
        True poses of the recording.
    mapped : Path or None
        True poses of the recording that the run was made of, in the same frame: they tell how the map lies in it.
        Without it the truth is in the frame of the map.
    """

    recording: Path | None = None
    mapped: Path | None = None

    def paths(self) -> tuple[Path, ...]:
        """Those that were given."""
        return tuple(path for path in (self.recording, self.mapped) if path is not None)


def stage_of(truth_files: TruthFiles, most_states: int) -> Stage:
    """The comparison as a stage: its files take their place together, and it is not done twice."""
    return Stage(
        name="compare",
        title="localizing in each of the maps",
        section="localization",
        folder="",
        reads=("scans/", "map/", "patches/"),
        writes=TABLES,
        run=lambda context: compare(context, truth_files, most_states),
        seeded=True,
    )


def compare(context: StageContext, truth_files: TruthFiles, most_states: int) -> dict[str, Any]:
    """Localize the scans in each map from the same start, and write what that shows."""
    from dynmap_cli.comparison.figures import draw_beliefs, draw_courses

    run_dir, config = context.run_dir, context.config
    log = read_scan_log(context.scans_dir)
    truth = read_truth(run_dir, truth_files)
    if truth is not None and not np.isfinite(true_positions_m(truth, log.stamps_ns)).any():
        msg = (
            f"{truth_files.recording}: says nothing at the times of the recording, "
            f"{format_stamp(int(log.stamps_ns[0]))} to {format_stamp(int(log.stamps_ns[-1]))} s. "
            "Is it the truth of this recording?"
        )
        raise ArtifactError(msg)
    log, mounted_words = with_mountings_of(log, run_dir / "scans", run_dir / "map")
    log, _ = with_sound_odometry(log, config.localization)
    maps, left_out = compared_maps(run_dir, most_states)
    start, by = common_start(log, maps[0], config, truth, context.threads)
    settings = config.localization.model_copy(
        update={"start": tuple(start.tolist()), "save_particles": False}
    )
    with progress("compare", log.n_scans * len(maps), "scans") as tick:
        courses = [
            course_in(one, log, settings, truth, seed=config.seed, threads=context.threads, tick=tick)
            for one in maps
        ]
    archive = run_dir / "patches" / "patches.zip"
    called = {
        number: f"{number} ({name})" if name else str(number) for number, name in read_names(archive).items()
    }
    first_ns = int(log.stamps_ns[0])
    figure = draw_courses(courses, first_ns, with_truth=truth is not None)
    contents = {
        TABLES[0]: as_summary(courses).encode("ascii"),
        TABLES[1]: as_table(courses).encode("ascii"),
        SPREAD_NAME if truth is None else ERRORS_NAME: figure,
    }
    if courses[0].states:
        contents[STATES_NAME] = draw_beliefs(courses[0], called, first_ns)
    for name, content in contents.items():
        (context.out_dir / name).write_bytes(content)
    return {
        "maps": {course.compared.name: _plain(_numbers(course, courses[0])) for course in courses},
        "start": [round(value, 4) for value in start.tolist()],
        "left_out": left_out,
        KEY: areas_digest(archive),
        "lines": [
            f"start {start[0]:.2f}, {start[1]:.2f} m, {np.degrees(start[2]):.0f} degrees, {by}",
            *(_sentence(course, courses[0]) for course in courses),
            *([mounted_words] if mounted_words else []),
            conclusion(courses, called, first_ns),
            *([] if courses[0].states else ["no sub-map came into view, so there is no states.png"]),
            *_left_out(left_out, log.n_drives),
        ],
    }


def _left_out(n_maps: int, n_drives: int) -> list[str]:
    """What was not compared, or not from the common start."""
    lines = []
    if n_maps:
        states = "map of a rarer state is" if n_maps == 1 else "maps of rarer states are"
        lines.append(f"{n_maps} {states} left out; --states allows more")
    if n_drives > 1:
        lines.append(f"only the first of {n_drives} drives has a common start; the others start unknown")
    return lines


def _plain(numbers: dict[str, float]) -> dict[str, float | None]:
    """Numbers as JSON has them: None where nothing is known."""
    return {name: value if np.isfinite(value) else None for name, value in numbers.items()}


def read_truth(run_dir: Path, files: TruthFiles) -> Trajectory | None:
    """True poses in the frame of the map; None where nobody gave any.

    Raises
    ------
    ArtifactError
        If a file is damaged, or has no times in common with the run.
    """
    if files.recording is None:
        return None
    truth = known_poses(read_reference(files.recording))
    if files.mapped is None:
        return truth
    mapped, reference, _ = associate(
        read_tum(run_dir / "map" / "trajectory.tum"), read_reference(files.mapped)
    )
    if mapped.shape[0] < LEAST_POSES:
        msg = f"{files.mapped}: no times in common with {run_dir}/map/trajectory.tum. Is it the truth of its recording?"
        raise ArtifactError(msg)
    map_from_truth = inverse(align(mapped[:, :2], reference[:, :2]))
    return Trajectory(truth.stamps_ns, compose(map_from_truth, truth.poses))


def common_start(
    log: ScanLog, patch_map: ComparedMap, config: Config, truth: Trajectory | None, threads: int
) -> tuple[F64, str]:
    """Pose of the first usable scan, and where it comes from: given, of the truth, or found in the patch map."""
    settings = config.localization
    if settings.start is not None:
        return np.array(settings.start), "as given"
    first = next((scan for scan in range(log.n_scans) if is_usable(log, scan, settings)), None)
    if first is None:
        msg = (
            f"{', '.join(log.recordings)}: no scan has enough returns to be localized. Check the laser topic."
        )
        raise LogError(msg)
    if truth is not None:
        true = interpolate(truth.stamps_ns, truth.poses, log.stamps_ns[first : first + 1])[0]
        if bool(np.isfinite(true).all()):
            if why := outside(patch_map.grid.frame, float(true[0]), float(true[1])):
                msg = (
                    f"--truth: the robot starts at {true[0]:.2f}, {true[1]:.2f}, {why}. Where the truth has another "
                    "frame than the map, pass --map-truth, the truth of the recording of which the map was made."
                )
                raise ArtifactError(msg)
            return np.asarray(true), "of the truth"
    parts = believed_parts(patch_map.patch_sets, patch_map.visits, settings.states)
    pool = make_map_pool(patch_map.grid, [part.states for part in parts], settings)
    random = np.random.default_rng(config.seed)
    with ThreadPoolExecutor(max_workers=max(threads, 1)) as executor:
        particles = global_start(log, first, pool, settings, random, executor)
    return estimate_pose(particles).pose, "found in the patch map"


def as_summary(courses: Sequence[Course]) -> str:
    """One line per map; empty where nothing is known."""
    lines = [SUMMARY_HEADER]
    for course in courses:
        numbers = _numbers(course, courses[0])
        words = [_word(value) for value in list(numbers.values())[1:]]
        lines.append(",".join([course.compared.name, str(course.stamps_ns.size), *words]))
    return "\n".join(lines) + "\n"


def as_table(courses: Sequence[Course]) -> str:
    """One line per map and update."""
    lines = [OVER_TIME_HEADER]
    for course in courses:
        away = course.away_from_m(courses[0])
        columns = (course.error_m, course.pose_error_m, course.spread_m, course.log_likelihood, away)
        for k, stamp in enumerate(course.stamps_ns.tolist()):
            pose = ",".join(f"{value:.6f}" for value in course.poses[k].tolist())
            words = ",".join(_word(float(column[k])) for column in columns)
            lines.append(
                f"{format_stamp(stamp)},{course.compared.name},{pose},{words},{int(course.is_lost[k])}"
            )
    return "\n".join(lines) + "\n"


def _numbers(course: Course, patch_map: Course) -> dict[str, float]:
    """The line of a map."""
    particles, error = _known(course.error_m), _known(course.pose_error_m)
    away = _known(course.away_from_m(patch_map))
    return {
        "updates": float(course.stamps_ns.size),
        "particle_error_mean_m": float(particles.mean()),
        "pose_error_mean_m": float(error.mean()),
        "pose_error_p95_m": float(np.quantile(error, 0.95)),
        "pose_error_max_m": float(error.max()),
        "spread_mean_m": float(course.spread_m.mean()),
        "log_likelihood_per_beam_mean": float(course.log_likelihood.mean()),
        "lost_share": float(course.is_lost.mean()),
        "away_from_patch_map_mean_m": float(away.mean()),
        "away_from_patch_map_max_m": float(away.max()),
    }


def _known(values: F64) -> F64:
    """Those that are numbers; one NaN where there is none."""
    known = values[np.isfinite(values)]
    return known if known.size else np.array([np.nan])


def _sentence(course: Course, patch_map: Course) -> str:
    """What a map was good for."""
    numbers = _numbers(course, patch_map)
    words = []
    if np.isfinite(numbers["pose_error_mean_m"]):
        mean, most = numbers["pose_error_mean_m"], numbers["pose_error_p95_m"]
        words.append(f"error of the pose {mean:.3f} m (95 % below {most:.3f} m)")
        words.append(f"of the particles {numbers['particle_error_mean_m']:.3f} m")
    words.append(f"spread {numbers['spread_mean_m']:.3f} m")
    words.append(f"log-likelihood per beam {numbers['log_likelihood_per_beam_mean']:.2f}")
    words.append(f"lost {100 * numbers['lost_share']:.0f} %")
    if course is not patch_map:
        words.append(f"{numbers['away_from_patch_map_mean_m']:.3f} m from the patch map")
    return f"{course.compared.name}, {course.compared.about}: {', '.join(words)}"


def _word(value: float) -> str:
    return f"{value:.6f}" if np.isfinite(value) else ""
