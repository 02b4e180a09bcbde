"""The door of the room: everything a run found -> report.html and figures/."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dynmap_cli.arrays import F64
from dynmap_cli.domain.grid import GridFrame, OccupancyGrid
from dynmap_cli.domain.mapped import give_back
from dynmap_cli.domain.patches import PatchSet, Visit
from dynmap_cli.domain.scans import ScanLog, end_points
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.errors import ArtifactError
from dynmap_cli.files.counting_map import beams_in_parts
from dynmap_cli.files.damage import refusing_damage
from dynmap_cli.files.documents import read_text
from dynmap_cli.files.manifest import Manifest, read_manifest
from dynmap_cli.files.patch_archive import read_patches, read_rounds, read_visits
from dynmap_cli.files.pgm import read_map
from dynmap_cli.files.registered import read_registered
from dynmap_cli.files.scan_log import read_scan_log
from dynmap_cli.files.submaps import read_submaps
from dynmap_cli.report.page import Picture, Section, write_page
from dynmap_cli.stage import Stage, StageContext

if TYPE_CHECKING:
    from PIL import Image

    from dynmap_cli.config import Config
    from dynmap_cli.report.curves import RoundRow

DYNAMIC_BELOW = 0.5
"""A beam with a smaller e hit something that moves."""
_FIGURES_BYTES = 20_000_000
_STAGES = (
    ("ingest", "scans", "ingest", "Recordings"),
    ("map", "map", "map", "Path, map and moving beams"),
    ("segment", "submaps", "segmentation", "Areas that change"),
    ("cluster", "patches", "clustering", "States of each area"),
)
"""Name of the stage, its folder, its section of the settings, title on the page."""


def needs(context: StageContext) -> tuple[str, int]:
    """Room for the figures, which are as large for a large map as for a small one, and once more in the page."""
    return "report.html and figures/", _FIGURES_BYTES


def run(context: StageContext) -> dict[str, Any]:
    """Read, draw, write."""
    manifests = {name: _manifest(context.run_dir / folder, name) for name, folder, _, _ in _STAGES}
    submaps = read_submaps(context.run_dir / "submaps")
    patches = context.run_dir / "patches" / "patches.zip"
    patch_sets, visits = read_patches(patches), read_visits(patches)
    log = read_scan_log(context.scans_dir)
    pictures = {
        "map": _map_pictures(context, submaps),
        "segment": (),
        "cluster": _state_pictures(context.run_dir, submaps, patch_sets, visits, int(log.stamps_ns[0])),
    }
    sections = [
        Section(
            title,
            _lines(manifests[name]),
            _recordings(manifests[name]) if name == "ingest" else (),
            pictures.get(name, ()),
        )
        for name, _, _, title in _STAGES
    ]
    sections.append(_settings_section(context.config, manifests))
    _write(context.out_dir, write_page(f"dynmap: {', '.join(log.recordings)}", sections), sections)
    count = sum(len(section.pictures) for section in sections)
    return {"figures": count, "lines": [f"{count} figures in figures/, and all of them in report.html"]}


def _manifest(folder: Path, stage: str) -> Manifest:
    """Manifest of a stage that must be done."""
    found = read_manifest(folder, stage)
    if found is None:
        msg = f"{folder}: stage '{stage}' is not done here. Run `dynmap build` first."
        raise ArtifactError(msg)
    return found


def _lines(manifest: Manifest) -> tuple[str, ...]:
    """What a stage said, also when the recordings of before an update were read."""
    return tuple(str(line) for kind in ("earlier_lines", "lines") for line in manifest.summary.get(kind, ()))


def _recordings(manifest: Manifest) -> tuple[tuple[str, str], ...]:
    """Names and digests of what was read."""
    return tuple((Path(name).name, f"sha256 {digest[:16]}…") for name, digest in manifest.inputs.items())


def _settings_section(config: Config, manifests: Mapping[str, Manifest]) -> Section:
    """The settings of the stages that are not the default."""
    rows = []
    for name, _, section, _ in _STAGES:
        defaults = type(getattr(config, section))().model_dump(mode="json")
        rows += [
            (f"{section}.{key}", f"{value} (default {defaults.get(key)})")
            for key, value in manifests[name].settings.items()
            if value != defaults.get(key)
        ]
    lines = () if rows else ("all settings are the defaults",)
    return Section("Settings that are not the default", lines, tuple(rows))


def _map_pictures(context: StageContext, submaps: Sequence[SubMap]) -> tuple[Picture, ...]:
    """The map with path, removed beams and sub-maps; what the filter did to it."""
    from dynmap_cli.report.curves import draw_rounds
    from dynmap_cli.report.filtering import draw_filtered, draw_rounds_of_map
    from dynmap_cli.report.pictures import MapPicture

    folder = context.run_dir / "map"
    log, trajectory = read_registered(context.scans_dir, folder)
    poses = trajectory.poses
    grid, _ = read_map(folder / "map.yaml")
    removed, n_removed = _removed_ends(folder / "beams.npz", log, poses, grid.frame)
    paths = [poses[log.drive_index == number, :2] for number in range(log.n_drives)]
    unfiltered, _ = read_map(folder / "unfiltered.yaml")
    curves = draw_rounds(_read_rounds(folder / "em.csv"))
    caption = (
        "Black: walls. White: free. Grey: never seen. Blue: the path. "
        f"Orange: {n_removed} end points of beams that hit something that moves, left out of the map. "
        + (
            "Frames: sub-maps (areas that change), with their numbers; each has its colour in all figures."
            if submaps
            else "No area was seen in two states."
        )
    )
    return (
        Picture("map.png", _png(MapPicture(grid).draw(removed, paths, submaps)), caption),
        Picture(
            "dynamic.png",
            _png(draw_filtered(grid, removed, n_removed)),
            "The map with every end point in it, and the filtered one. Orange: where the removed beams ended.",
        ),
        Picture(
            "em.png",
            _png(draw_rounds_of_map(_rounds_of_map(folder, unfiltered), grid, curves)),
            "Rounds of registration and filtering. Orange: cells that the final map does not have. Below: how well "
            "all beams are explained, how many are called dynamic; poses change between rounds, so the first may "
            "fall. What stands for a while is judged after the last round, by looks, and may add to the share.",
        ),
    )


def _removed_ends(path: Path, log: ScanLog, poses: F64, frame: GridFrame) -> tuple[F64, int]:
    """End points (n, 2) of removed beams, the first in each cell of the map, and how many beams were removed."""
    is_shown = np.zeros(frame.shape, dtype=bool)
    ends, count = [], 0
    for rows, e in beams_in_parts(path, (log.n_scans, log.n_beams)):
        points = end_points(log.select(rows), poses[rows], e < DYNAMIC_BELOW)
        give_back(log.ranges_m)
        count += points.shape[0]
        cells = frame.to_cells(points)
        inside = ((cells >= 0) & (cells < np.array(frame.shape))).all(axis=1)
        points, (row, col) = points[inside], cells[inside].T
        _, first = np.unique(row * frame.cols + col, return_index=True)
        first = first[~is_shown[row[first], col[first]]]
        is_shown[row[first], col[first]] = True
        ends.append(points[first])
    return np.concatenate([np.empty((0, 2)), *ends]), count


def _rounds_of_map(folder: Path, unfiltered: OccupancyGrid) -> list[tuple[str, OccupancyGrid]]:
    """The map before the filter and after the rounds that were kept, with titles."""
    numbers = sorted(int(path.stem.removeprefix("round_")) for path in folder.glob("round_*.yaml"))
    rounds = [(f"round {number}", read_map(folder / f"round_{number}.yaml")[0]) for number in numbers]
    return [("all beams", unfiltered), *rounds]


def _read_rounds(path: Path) -> list[RoundRow]:
    """Read map/em.csv."""
    from dynmap_cli.report.curves import RoundRow

    with refusing_damage(
        f"{path}: not a readable table of rounds", "Run `dynmap map` again with --force.", ArtifactError
    ):
        return [
            RoundRow(float(row["log_likelihood"]), float(row["dynamic_share"]))
            for row in csv.DictReader(io.StringIO(read_text(path)))
        ]


def _state_pictures(
    run_dir: Path,
    submaps: Sequence[SubMap],
    patch_sets: Sequence[PatchSet],
    visits: Sequence[Visit],
    first_ns: int,
) -> tuple[Picture, ...]:
    """When which state was seen, and what the states look like."""
    from dynmap_cli.report.clusters import draw_clusters
    from dynmap_cli.report.curves import draw_visits
    from dynmap_cli.report.patch_map import draw_patch_map
    from dynmap_cli.report.pictures import draw_states

    pictures = []
    if visits:
        caption = (
            "Visits: one bar each, coloured by the state it saw; grey where it has none. "
            "A line joins visits that saw the same state one after the other."
        )
        pictures.append(Picture("visits.png", draw_visits(visits, submaps, first_ns), caption))
    if patch_sets:
        grid, _ = read_map(run_dir / "map" / "map.yaml")
        caption = (
            "The patch map: in each sub-map of the map the mean of its states, and beside the map the states "
            "with their numbers. Red: cells that change."
        )
        pictures.append(Picture("patch_map.png", _png(draw_patch_map(grid, submaps, patch_sets)), caption))
    places = {submap.submap_id: submap for submap in submaps}
    rounds = read_rounds(run_dir / "patches" / "patches.zip")
    for patch_set in patch_sets:
        number = patch_set.submap_id
        caption = f"Sub-map {places[number].called} at {places[number].place} m. Red: cells that change."
        pictures.append(Picture(f"submap_{number:03d}.png", _png(draw_states(patch_set)), caption))
        if len(rounds[number]) > 1:
            caption = (
                f"Sub-map {places[number].called}: 1, 2, ... states are tried; the tiles show what each would be. The "
                "largest BIC is chosen, which weighs what they explain against their number; states that differ in too "
                "few cells are then one. Red: occupied. Grey: unknown, or the same in all states."
            )
            picture = _png(draw_clusters(patch_set, rounds[number]))
            pictures.append(Picture(f"clusters_{number:03d}.png", picture, caption))
    return tuple(pictures)


def _png(image: Image.Image) -> bytes:
    """Bytes of a PNG file."""
    stream = io.BytesIO()
    image.save(stream, format="PNG")
    return stream.getvalue()


def _write(out_dir: Path, page: str, sections: Sequence[Section]) -> None:
    """Write the page, and its pictures once more as files."""
    (out_dir / "figures").mkdir()
    for picture in (picture for section in sections for picture in section.pictures):
        (out_dir / "figures" / picture.name).write_bytes(picture.png)
    (out_dir / "report.html").write_text(page, encoding="utf-8", errors="backslashreplace")


STAGE = Stage(
    name="report",
    title="drawing the report",
    section="report",
    folder="",
    reads=("scans/", "map/", "submaps/", "patches/"),
    writes=("report.html", "figures/"),
    run=run,
    needs=needs,
)
