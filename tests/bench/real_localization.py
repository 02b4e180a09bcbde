"""Localization in real recordings: one half is mapped, the other found in it; motion capture or relations judge."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynmap_cli.arrays import F64
from dynmap_cli.domain.poses import Trajectory, compose, interpolate, wrap_angle
from dynmap_cli.evaluation.relations import read_relations, relation_errors
from dynmap_cli.evaluation.trajectories import absolute_errors_m, align
from dynmap_cli.files.trajectory import read_tum
from tests.bench.cut_recordings import cut, poses_in_bag
from tests.bench.real_logs import AbsentError
from tests.bench.tables import Row, Table, number, percent
from tests.bench.worlds import Bench

HALVES = {"first": (0.0, 0.5), "second": (0.5, 1.0)}


@dataclass(frozen=True)
class RealDrive:
    """A recording of which one part is mapped.

    Attributes
    ----------
    name, file : str
    truth_topic : str
        Poses of motion capture or beacons in the bag; "" where there are none.
    relations : str
        File of relations that were checked by hand; "" where there is none.
    options : tuple of str
        Of both commands.
    """

    name: str
    file: str
    truth_topic: str = ""
    relations: str = ""
    options: tuple[str, ...] = ()


DRIVES = (
    RealDrive("Intel", "benchmark/intel.clf.bz2", relations="benchmark/intel.relations"),
    RealDrive("AGV in a lab (jarvis)", "bags/jarvis_complex_path_fast.bag", "/pose_ground_truth"),
    RealDrive("scaled cars, two robots", "bags/two_robots.bag", "/mocap_pose"),
    RealDrive("scaled cars, intersection", "bags/intersection.bag", "/ego_pose"),
)
LAB_BAG, LAB_MAP = "bags/turtlebot4_mac", "mac_1st_floor_final.yaml"


@dataclass(frozen=True)
class Errors:
    """Of poses against the truth.

    Attributes
    ----------
    position_m, heading_deg : (n,) float64
        Of each pose for which there is truth.
    """

    position_m: F64
    heading_deg: F64

    def cells(self) -> Row:
        """Mean, median, 95 % and mean heading."""
        if self.position_m.size == 0:
            return ["-", "-", "-", "-"]
        return [
            number(float(self.position_m.mean())),
            number(float(np.median(self.position_m))),
            number(float(np.quantile(self.position_m, 0.95))),
            number(float(self.heading_deg.mean()), 2),
        ]


def against_truth(found: Trajectory, mapped: Trajectory, truth: Trajectory) -> Errors:
    """Errors in the frame of the truth, into which the path of the mapped part is laid.

    The heading of what motion capture follows may be turned against the robot's; the median turn of the mapped part is
    taken off.
    """
    there, true = _pairs(mapped, truth)
    frame = align(there[:, :2], true[:, :2])
    turned = float(np.median(wrap_angle(true[:, 2] - compose(frame, there)[:, 2])))
    poses, true = _pairs(found, truth)
    poses = compose(frame, poses)
    away = np.hypot(poses[:, 0] - true[:, 0], poses[:, 1] - true[:, 1])
    return Errors(away, np.degrees(np.abs(wrap_angle(true[:, 2] - poses[:, 2] - turned))))


def own_error_m(path: Trajectory, truth: Trajectory) -> float:
    """Mean distance of a path from the truth, after it was laid on it by itself."""
    there, true = _pairs(path, truth)
    return float(absolute_errors_m(there, true).mean())


def _pairs(found: Trajectory, truth: Trajectory) -> tuple[F64, F64]:
    """Poses and true poses of the same times."""
    true = interpolate(truth.stamps_ns, truth.poses, found.stamps_ns)
    known = np.isfinite(true).all(axis=1)
    return found.poses[known], true[known]


def against_relations(found: Trajectory, relations: Path) -> Errors:
    """Errors of the relations between two times of the localized part."""
    errors = relation_errors(found, read_relations(relations))
    errors = errors[np.isfinite(errors).all(axis=1)]
    return Errors(np.hypot(errors[:, 0], errors[:, 1]), np.abs(np.degrees(errors[:, 2])))


def rows_of(bench: Bench, drive: RealDrive, mapped_half: str) -> list[Row]:
    """Cut, build, localize, measure: a row for the filter and one for the same looked back on."""
    recording = bench.data / drive.file
    if not recording.exists():
        raise AbsentError
    other_half = next(half for half in HALVES if half != mapped_half)
    slug = recording.name.split(".")[0]
    suffix = ".bag" if recording.suffix == ".bag" else ".log"

    def part(half: str) -> Path:
        to = bench.folder / "parts" / f"{slug}_{half}{suffix}"
        return bench.jobs.once(("cut", slug, half), lambda: cut(recording, *HALVES[half], to))

    run_dir, _ = bench.built(f"{slug}-{mapped_half}-half", part(mapped_half), *drive.options)
    name = f"{slug}-{other_half}-half"
    out_dir, cost = bench.localized(name, run_dir, part(other_half), "--smooth", *drive.options)
    mapped = read_tum(run_dir / "map" / "trajectory.tum")
    truth = poses_in_bag(recording, drive.truth_topic) if drive.truth_topic else None
    rows = []
    for way, folder in (("filter", out_dir), ("looked back", out_dir / "smoothed")):
        found = read_tum(folder / "trajectory.tum")
        if truth is None:
            errors, shapes = against_relations(found, bench.data / drive.relations), ["-", "-"]
        else:
            errors = against_truth(found, mapped, truth)
            shapes = [number(own_error_m(path, truth)) for path in (found, mapped)]
        scans = found.stamps_ns.size
        lost = percent(float(_summary(out_dir)["lost"]))
        ms = f"{1000 * cost.cpu_s / scans:.1f}" if way == "filter" else ""
        rows.append(
            [f"{other_half} half in {mapped_half}", way, str(scans), lost, *errors.cells(), *shapes, ms]
        )
    return rows


def lab_row(bench: Bench) -> Row:
    """A robot in the map that its lab made of the same floor: there is no truth, only whether it agrees."""
    folder = bench.data / LAB_BAG
    if not folder.exists():
        raise AbsentError
    words = ("--map", folder / LAB_MAP, folder, "--smooth")
    (out_dir, cost), (again, _) = (
        bench.localized(f"turtlebot4-seed-{seed}", *words, "--seed", seed) for seed in (0, 1)
    )
    found, other = (read_tum(one / "trajectory.tum") for one in (out_dir, again))
    apart_m = np.linalg.norm((found.poses - other.poses)[:, :2], axis=1)
    with (out_dir / "health.csv").open(newline="") as stream:
        explained = np.mean([float(row["explained"]) for row in csv.DictReader(stream)])
    scans = found.stamps_ns.size
    return [
        "all in the map of the lab",
        "filter",
        str(scans),
        percent(float(_summary(out_dir)["lost"])),
        f"two seeds {float(apart_m.mean()):.3f} apart",
        number(float(np.median(apart_m))),
        number(float(np.quantile(apart_m, 0.95))),
        f"{100 * explained:.0f} % of the beams explained",
        "-",
        "-",
        f"{1000 * cost.cpu_s / scans:.1f}",
    ]


def _summary(out_dir: Path) -> dict[str, object]:
    content: dict[str, dict[str, object]] = json.loads((out_dir / "localize.manifest.json").read_text())
    return content["summary"]


def _short(row: Row) -> str:
    """Mean and median error of a row."""
    return f"{row[4]} m, median {row[5]} m"


def tables(bench: Bench) -> list[Table]:
    """One table."""
    table = Table(
        "Localization in real recordings",
        [
            "Each recording is cut in two; one half is built, the other is localized in it from a global start, with "
            "default settings and `--smooth`. Errors are distances from motion capture or beacons, in whose frame the "
            "path of the mapped half was laid; for Intel those of the relations within the localized half, which also "
            "leads through a room that the mapped half does not show. A path laid on the truth by itself has errors "
            "of its shape only, without those of the frame. "
            "CPU of the whole process, start and reading included.",
        ],
        [
            "recording",
            "part",
            "way",
            "scans",
            "lost",
            "error, m",
            "error median, m",
            "error 95 %, m",
            "error, deg",
            "laid on truth itself, m",
            "mapped half, laid itself, m",
            "CPU ms per scan",
        ],
    )
    drives = [drive for drive in DRIVES if not (bench.quick and drive.relations)]
    jobs = {
        (drive.name, half): bench.jobs.start(rows_of, bench, drive, half)
        for drive in drives
        for half in (("first",) if drive.relations else HALVES)
    }
    lab = bench.jobs.start(lab_row, bench)
    for (name, _), job in jobs.items():
        for k in range(2):
            table.add(name, lambda job=job, k=k: job.result()[k])
    table.add("TurtleBot 4", lab.result)
    for (name, half), job in jobs.items():
        table.remark(
            f"localization, {name}, mapped from the {half} half",
            lambda job=job: f"{_short(job.result()[0])}; looked back {_short(job.result()[1])}",
        )
    return [table]
