"""The two sample recordings through the whole chain, beside what was really there."""

from __future__ import annotations

import csv
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from click.testing import CliRunner

from dynmap_cli.cli import main
from dynmap_cli.domain.grid import FREE, OCCUPIED, GridFrame, OccupancyGrid
from dynmap_cli.domain.poses import compose, inverse, transform_points
from dynmap_cli.evaluation.trajectories import align
from dynmap_cli.files.patch_archive import read_patches
from dynmap_cli.files.pgm import read_map, write_map
from dynmap_cli.files.trajectory import parse_stamp, read_tum
from dynmap_cli.simulation import SimulatedRun, load_scenario, simulate

STATES = ("closed", "open")
_OCCUPIED, _FREE = 0.2, 0.1


@dataclass(frozen=True)
class Corridor:
    """Monday's run, Tuesday localized in it, and the truth of both."""

    run_dir: Path
    out_dir: Path
    monday: SimulatedRun
    tuesday: SimulatedRun

    @property
    def truth_from_map(self):
        return align(self.mapped[:, :2], self.monday.true_poses[:, :2])

    @property
    def mapped(self):
        """Poses of Monday in the map."""
        return read_tum(self.run_dir / "map" / "trajectory.tum").poses

    @property
    def patch_sets(self):
        return read_patches(self.run_dir / "patches" / "patches.zip")

    def doors(self):
        """Door -> (hinge, latch) in the map, in the order of the objects of the truth."""
        map_from_truth = inverse(self.truth_from_map)
        return {
            door.name: transform_points(map_from_truth, np.array([door.hinge, door.latch]))
            for door in self.monday.scenario.world.doors
        }

    def submap_of(self, door):
        """The patch set that holds the middle of a door."""
        middle = self.doors()[door].mean(axis=0)
        inside = [one for one in self.patch_sets if away_m(one.frame, middle[None])[0] == 0.0]
        assert len(inside) == 1
        return inside[0]

    def meanings(self, door):
        """Patch number -> "closed" or "open", by what lies on the line from hinge to latch."""
        one, (hinge, latch) = self.submap_of(door), self.doors()[door]
        line = hinge + np.linspace(0.15, 0.85, 15)[:, None] * (latch - hinge)
        found = {}
        for patch in one.patches:
            beside = [np.nanmax(_around(patch.reflectance, cell)) for cell in one.frame.to_cells(line)]
            found[patch.patch_id] = STATES[0] if np.median(beside) >= _OCCUPIED else STATES[1]
        return found

    def beliefs(self, door):
        """Scan of Tuesday -> {"closed": probability, "open": probability}, where the door was in view."""
        submap, meanings = str(self.submap_of(door).submap_id), self.meanings(door)
        numbers = {stamp: k for k, stamp in enumerate(self.tuesday.log.stamps_ns.tolist())}
        beliefs = defaultdict(lambda: dict.fromkeys(STATES, 0.0))
        with (self.out_dir / "states.csv").open(newline="") as stream:
            for row in csv.DictReader(stream):
                if row["submap"] == submap:
                    state = meanings[int(row["patch"])]
                    beliefs[numbers[parse_stamp(row["stamp_s"])]][state] += float(row["probability"])
        return beliefs

    def errors_m(self, out_dir):
        """Distance from the true position at each scan of Tuesday."""
        estimate = compose(self.truth_from_map, read_tum(out_dir / "trajectory.tum").poses)
        return np.linalg.norm(estimate[:, :2] - self.tuesday.true_poses[:, :2], axis=1)


def _around(values, cell):
    row, col = cell
    return values[max(row - 2, 0) : row + 3, max(col - 2, 0) : col + 3]


def away_m(frame: GridFrame, points):
    """Distance of points from the rectangle of a frame."""
    low = np.array([frame.origin_x_m, frame.origin_y_m])
    high = low + np.array([frame.cols, frame.rows]) * frame.resolution_m
    return np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=1)


def dynmap(*words):
    """Run the command line; it has to succeed."""
    result = CliRunner().invoke(main, [str(word) for word in words])
    assert result.exit_code == 0, result.output
    return result


def make_corridor(sample_logs: Path, folder: Path, *, threads: int) -> Corridor:
    """Build Monday, localize Tuesday."""
    recordings = [sample_logs / f"corridor_{day}.mcap" for day in ("monday", "tuesday")]
    dynmap("build", recordings[0], "-o", folder / "run", "--threads", threads, "-q")
    dynmap("localize", folder / "run", recordings[1], "-o", folder / "out", "--threads", threads, "-q")
    truths = [simulate(load_scenario(sample_logs / f"corridor_{day}.yaml")) for day in ("monday", "tuesday")]
    return Corridor(folder / "run", folder / "out", *truths)


def paint_plain_map(corridor: Corridor, state: str, folder: Path) -> Path:
    """Write the map with all doors in one state, as a map_server pair without patches."""
    grid, _ = read_map(corridor.run_dir / "map" / "map.yaml")
    cells = np.array(grid.cells)
    for door in corridor.doors():
        one = corridor.submap_of(door)
        number = next(number for number, name in corridor.meanings(door).items() if name == state)
        values = next(patch.reflectance for patch in one.patches if patch.patch_id == number)
        row, col = np.round(
            (
                np.array([one.frame.origin_y_m, one.frame.origin_x_m])
                - [grid.frame.origin_y_m, grid.frame.origin_x_m]
            )
            / grid.frame.resolution_m
        ).astype(int)
        window = cells[row : row + one.frame.rows, col : col + one.frame.cols]
        window[values >= _OCCUPIED] = OCCUPIED
        window[values < _FREE] = FREE
    folder.mkdir(parents=True, exist_ok=True)
    write_map(folder, state, OccupancyGrid(grid.frame, cells))
    return folder / f"{state}.yaml"


def compare_with_plain_maps(corridor: Corridor, recording: Path, folder: Path) -> dict[str, dict[str, float]]:
    """Position error of Tuesday in the patch map, and of plain MCL in maps with the doors open and closed."""
    errors = {"patch map": corridor.errors_m(corridor.out_dir)}
    for state in STATES:
        plain = paint_plain_map(corridor, state, folder)
        dynmap("localize", "--map", plain, recording, "-o", folder / state, "-q")
        errors[f"plain MCL, doors {state}"] = corridor.errors_m(folder / state)
    return {
        name: {
            "rmse_m": float(np.sqrt(np.mean(error**2))),
            "median_m": float(np.median(error)),
            "max_m": float(error.max()),
        }
        for name, error in errors.items()
    }
