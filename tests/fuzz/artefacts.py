"""Whole files that dynmap wrote or was given, other than recordings, and how they are read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from dynmap_cli.config import load_config
from dynmap_cli.domain.corrections import Addition, Drop, Merge, Name, Place
from dynmap_cli.domain.grid import CountingMap, GridFrame
from dynmap_cli.domain.poses import Trajectory
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.domain.submaps import Rectangle
from dynmap_cli.evaluation.relations import read_relations
from dynmap_cli.evaluation.trajectories import read_reference
from dynmap_cli.files.counting_map import (
    read_beams,
    read_counting_map,
    read_unknown,
    write_beams,
    write_counting_map,
)
from dynmap_cli.files.edits import read_edits, write_edits
from dynmap_cli.files.manifest import Manifest, read_manifest, write_manifest
from dynmap_cli.files.patch_archive import read_patches, read_rounds, read_visits, write_patches
from dynmap_cli.files.pgm import read_map
from dynmap_cli.files.scan_log import read_scan_log, write_scan_log
from dynmap_cli.files.submaps import read_submaps, write_submaps
from dynmap_cli.files.trajectory import read_tum, write_tum
from dynmap_cli.simulation.run import count_scans
from dynmap_cli.simulation.scenario import load_scenario
from dynmap_cli.simulation.size import check_size
from tests.files.test_patch_archive import content

_PROJECT = Path(__file__).resolve().parent.parent.parent
_WORLDS = ("two_doors", "crowd", "glass_lobby")


def _settings(folder: Path) -> None:
    (folder / "a.yaml").write_bytes((_PROJECT / "configs" / "default.yaml").read_bytes())


def _scenarios(folder: Path) -> None:
    for name in _WORLDS:
        (folder / f"{name}.yaml").write_bytes((_PROJECT / "configs" / "worlds" / f"{name}.yaml").read_bytes())


def _read_scenarios(folder: Path) -> None:
    for name in _WORLDS:
        scenario = load_scenario(folder / f"{name}.yaml")
        if (folder / f"{name}.yaml").read_bytes() != (
            _PROJECT / "configs/worlds" / f"{name}.yaml"
        ).read_bytes():
            check_size(scenario)
            count_scans(scenario)


def _edits(folder: Path) -> None:
    place = Place(3, Rectangle(-1.25, 0.5, 2.0, 1.75))
    area = Addition(7, ((0.0, 0.0), (1.0, 0.0), (0.5, 2.0)))
    write_edits(folder, (Merge(place, (0, 2)), area, Name(place, "Labortür"), Drop(place)))


def _map(folder: Path) -> None:
    pixels = bytes(k * 7 % 256 for k in range(12 * 9))
    (folder / "m.pgm").write_bytes(b"P5\n# CREATOR: a map server 0.05 m/pix\n12 9\n255\n" + pixels)
    (folder / "m.yaml").write_text(
        "image: m.pgm\nmode: trinary\nresolution: 0.05\norigin: [-1.5, 2.0, 0.0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )


def _patches(folder: Path) -> None:
    write_patches(folder / "patches.zip", *content())


def _read_patches(folder: Path) -> None:
    for read in (read_patches, read_visits, read_rounds):
        read(folder / "patches.zip")


def _tum(folder: Path) -> None:
    stamps = np.arange(5) * 10**8 + 10**18
    write_tum(folder / "t.tum", Trajectory(stamps, np.arange(15.0).reshape(5, 3) / 10))


def _references(folder: Path) -> None:
    lines = [f"{k} {1000 + 0.1 * k:.3f} {k} 0 0.1 {k} 0 0.1\n" for k in range(4)]
    (folder / "a.ref.txt").write_text("".join(lines))
    (folder / "a.relations").write_text("1000.0 1000.1 1 0 0 0 0 0.1\n1000.1 1000.3 2 0 0 0 0 0.2\n")


def _read_references(folder: Path) -> None:
    read_reference(folder / "a.ref.txt")
    read_relations(folder / "a.relations")


def _scans(folder: Path) -> None:
    log = ScanLog(
        stamps_ns=np.array([5, 7, 7], dtype=np.int64),
        ranges_m=np.array([[1.0, np.inf], [np.nan, 2.0], [3.0, 4.0]], dtype=np.float32),
        odometry=np.array([[0.0, 0.0, 0.0], [np.nan] * 3, [1.0, 2.0, 3.0]]),
        geometry_index=np.array([0, 1, 0], dtype=np.int32),
        bearings_rad=np.array([[-0.1, 0.1], [0.0, np.nan]]),
        sensor_poses=np.array([[0.2, 0.0, 0.0], [-0.2, 0.0, 3.1]]),
        range_limits_m=np.array([[0.1, 8.0], [0.1, 30.0]]),
        beam_interval_s=np.array([0.0, 1e-4]),
        recording_index=np.zeros(3, dtype=np.int32),
        recordings=("a.bag",),
    )
    write_scan_log(folder, log)


def _counting(folder: Path) -> None:
    draw = np.random.default_rng(1)
    hits = draw.integers(0, 5, (4, 6)).astype(float)
    centroids = np.where(hits[..., None] > 0, draw.random((4, 6, 2)), np.nan)
    passed = draw.random((4, 6)).astype(np.float32).astype(float)
    frame = GridFrame(0.05, 1.0, -2.0, 4, 6)
    write_counting_map(folder / "m.npz", CountingMap.of_grids(frame, hits, 0.5 * hits, passed, centroids))
    probability = np.array([[0.5, np.nan], [1.0, 0.0]], dtype=np.float32)
    write_beams(folder / "b.npz", np.array([1, 2]), probability, np.zeros((2, 2), dtype=bool))


def _read_counting(folder: Path) -> None:
    read_counting_map(folder / "m.npz")
    read_beams(folder / "b.npz", (2, 2))
    read_unknown(folder / "b.npz", (2, 2))


def _manifest(folder: Path) -> None:
    write_manifest(
        folder, Manifest("map", {"x": 1}, {"in": "0" * 64}, {"a": "1" * 64}, {"lines": ["x"]}, 1.5, "0.1.0")
    )


SAMPLES: dict[str, tuple[Callable[[Path], object], Callable[[Path], object]]] = {
    "settings": (_settings, lambda folder: load_config(folder / "a.yaml", {})),
    "scenario": (_scenarios, _read_scenarios),
    "edits": (_edits, read_edits),
    "map": (_map, lambda folder: read_map(folder / "m.yaml")),
    "patches": (_patches, _read_patches),
    "submaps": (lambda folder: write_submaps(folder, content()[0]), read_submaps),
    "trajectory": (_tum, lambda folder: read_tum(folder / "t.tum")),
    "references": (_references, _read_references),
    "scans": (_scans, read_scan_log),
    "counting map": (_counting, _read_counting),
    "manifest": (_manifest, lambda folder: read_manifest(folder, "map")),
}
WITH_ARCHIVES = ("patches", "counting map")
