"""From recordings to scans: read, choose, merge. The work of the room, in its order."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dynmap_cli.arrays import B1, F32, F64
from dynmap_cli.domain.mapped import give_back
from dynmap_cli.domain.poses import compose
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.errors import LogError
from dynmap_cli.files.tables import new_table
from dynmap_cli.ingest.account import report_on
from dynmap_cli.ingest.choices.clock_offsets import align_clocks
from dynmap_cli.ingest.choices.clock_sets import join_set_clocks
from dynmap_cli.ingest.choices.clock_steps import mend_clock_steps
from dynmap_cli.ingest.choices.clocks import part_clocks
from dynmap_cli.ingest.choices.doubts import (
    drop_impossible,
    note_damaged_pack,
    note_few_beams,
    note_odometry,
    note_shared_stamps,
    note_stamps,
    note_track,
    refuse_frozen,
    stamps_jump,
)
from dynmap_cli.ingest.choices.frames import FrameTree, Mounting, make_edge
from dynmap_cli.ingest.choices.free_space import Sweeps
from dynmap_cli.ingest.choices.lasers import LaserChoice, choose_lasers, view_lasers
from dynmap_cli.ingest.choices.merging import (
    Columns,
    Drive,
    columns_of,
    find_drives,
    find_restart,
    join_recordings,
    joined_logs,
)
from dynmap_cli.ingest.choices.mountings import mounting_of, robot_turns, turned_over
from dynmap_cli.ingest.choices.odometry import ends_without_odometry, find_odometry
from dynmap_cli.ingest.choices.odometry_axes import mend_heading
from dynmap_cli.ingest.choices.odometry_sources import Odometry, find_candidates
from dynmap_cli.ingest.choices.own_body import mask, unused_sectors
from dynmap_cli.ingest.choices.ranges import NoReturn, apply_no_return, judge_no_return
from dynmap_cli.ingest.choices.renamed import join_renamed
from dynmap_cli.ingest.choices.repeats import drop_repeats
from dynmap_cli.ingest.choices.restarts import join_restarts
from dynmap_cli.ingest.choices.robot_frames import find_base
from dynmap_cli.ingest.choices.two_robots import part_tracks, refuse_two_lasers
from dynmap_cli.ingest.choices.units import mend_units
from dynmap_cli.ingest.containers.opening import find_sources
from dynmap_cli.ingest.loading import load_all
from dynmap_cli.ingest.raw.columns import blocks_of, known_rows, picked, picked_rows, put_rows, spans
from dynmap_cli.ingest.raw.laser import most_used
from dynmap_cli.ingest.raw.recording import RawRecording, file_name
from dynmap_cli.ingest.refusals import damage_refused, losses_of, require_lasers
from dynmap_cli.ingest.report import IngestReport, join_reports
from dynmap_cli.ingest.seen_motion.agreement import agreement_at
from dynmap_cli.ingest.seen_motion.turns import ReferenceLaser
from dynmap_cli.ingest.settings import IngestSettings
from dynmap_cli.ingest.space import Space


def read_recordings(
    paths: Sequence[Path], settings: IngestSettings, folder: Path | None = None
) -> tuple[ScanLog, IngestReport]:
    """Read recordings into scans.

    Parameters
    ----------
    paths : sequence of Path
        Files or folders. Those that continue one another are one drive; others are drives of their own.
    settings : IngestSettings
    folder : Path or None
        On which disk nameless files are put for ranges that do not fit into memory; None = that of temporary files.

    Returns
    -------
    ScanLog
        All accepted sweeps in time order.
    IngestReport
        What was found, what was used and why, what was left out.

    Raises
    ------
    LogError
        If there is nothing to read, it is damaged, or it holds no laser.
    """
    return merge_recordings(load_recordings(paths, settings, Space(folder)), settings, folder)


def merge_recordings(
    recordings: Sequence[RawRecording], settings: IngestSettings, folder: Path | None = None
) -> tuple[ScanLog, IngestReport]:
    """Decide what is used of recordings that were loaded, and bring it into time order."""
    require_lasers(recordings)
    part_clocks(recordings, settings.max_gap_s)
    waiting = find_drives(recordings, settings.max_gap_s)
    drives = [*waiting]
    merged: list[tuple[ScanLog, IngestReport]] = []
    while waiting:
        drive = waiting.pop(0)
        log, report = _merge_drive(drive, drives, settings, folder)
        restart = find_restart(log.recording_index, log.stamps_ns, log.odometry)
        if restart is None:
            merged.append((log, report))
        else:
            waiting[:0] = drive.split(*restart)
    return joined_logs([log for log, _ in merged], folder), join_reports([report for _, report in merged])


def _merge_drive(
    drive: Drive, drives: Sequence[Drive], settings: IngestSettings, folder: Path | None
) -> tuple[ScanLog, IngestReport]:
    """Decide what is used of the recordings of one drive, and bring it into time order."""
    joined = join_recordings(drive, drives)
    names = tuple(recording.name for recording in drive.recordings)
    tree = FrameTree({pair: make_edge(raw) for pair, raw in joined.transforms.items()})
    base = find_base(joined, tree, settings)
    join_renamed(joined, tree, base)
    choices = _chosen_lasers(joined, tree, base, settings)
    used = [choice for choice in choices if choice.used]
    mountings = [mounting_of(choice, settings, joined) for choice in used]
    columns, out_of_order = columns_of([choice.view.laser for choice in used], joined.dropped, folder)
    joined.give_back()
    candidates = find_candidates(
        joined, tree, base, [choice.view.laser for choice in used], columns.stamps_ns, settings
    )
    headings = candidates.headings(columns.stamps_ns)
    turns = [
        robot_turns(choice, mounting, headings) for choice, mounting in zip(used, mountings, strict=True)
    ]
    odometry = find_odometry(joined, tree, base, candidates, columns.stamps_ns, turns[0], settings)
    odometry = mend_heading(odometry, columns, turns[0], mountings[0], joined)
    for number, choice in enumerate(used):
        if agreement_at(turns[number], columns.stamps_ns, odometry.poses).is_mirrored:
            mountings[number] = turned_over(mountings[number], choice.view.laser.name, joined)
    joined.give_back()
    poses = _cut_ends(columns, odometry, joined)
    note_stamps([choice.view.laser for choice in used], joined)
    note_few_beams(
        [choice.view.laser for choice in used],
        joined,
        has_odometry=bool(known_rows(poses).any()),
    )
    refuse_frozen(columns, odometry.path_m, joined.name)
    refuse_two_lasers(columns, joined)
    note_shared_stamps(columns, joined)
    note_track(joined, odometry.source)
    note_odometry(columns, poses, joined)
    follows_arrival = stamps_jump(columns, out_of_order, joined)
    bearings_rad = _bearing_table(columns, mountings)
    joined.warnings += unused_sectors(settings.mask_sectors, [choice.view.laser.name for choice in choices])
    masked = [
        mask(
            columns,
            number,
            choice.view.laser,
            bearings_rad,
            mounting.robot_from_sensor[2],
            poses,
            settings.mask_sectors,
        )
        for number, (choice, mounting) in enumerate(zip(used, mountings, strict=True))
    ]
    verdicts = [
        _rewrite_ranges(
            columns,
            number,
            choice,
            bearings_rad,
            _sensor_poses(poses, mounting, folder),
            settings,
            folder,
        )
        for number, (choice, mounting) in enumerate(zip(used, mountings, strict=True))
    ]
    poses = _drop_empty(columns, poses, joined)
    joined.give_back()
    log = _scan_log(
        columns, poses, bearings_rad, mountings, verdicts, tuple(file_name(name) for name in names)
    )
    if follows_arrival:
        arrival = np.argsort(np.argsort(columns.reading_index, kind="stable"), kind="stable")
        log = replace(log, arrival_index=arrival.astype(np.int32))
    report = report_on(
        drive, joined, choices, mountings, verdicts, masked, odometry, log, out_of_order, base, tree
    )
    return log, report


def load_recordings(
    paths: Sequence[Path], settings: IngestSettings, space: Space | None = None
) -> list[RawRecording]:
    """Read all recordings as they are."""
    space = space or Space()
    with tempfile.TemporaryDirectory(prefix="dynmap-") as scratch:
        limit_bytes = int(settings.max_unpacked_gib * 2**30)
        sources = [find_sources(path, Path(scratch), limit_bytes) for path in paths]
        loaded = [pair for found in sources for pair in load_all(found, settings, space)]
    recordings = [recording for _, recording in loaded]
    for source, recording in loaded:
        if source.damage and source.damage not in recording.damage:
            note_damaged_pack(recording, source.damage)
        if settings.strict and recording.damage:
            raise damage_refused(recording)
        mend_units(recording)
        drop_repeats(recording)
        mend_clock_steps(recording)
        join_set_clocks(recording)
        laser = most_used(recording.lasers.values())
        reference = None if laser is None else ReferenceLaser(laser)
        if reference is not None:
            align_clocks(recording, reference)
        part_tracks(recording, reference)
        join_restarts(recording)
        drop_impossible(recording)
    return recordings


def _chosen_lasers(
    joined: RawRecording, tree: FrameTree, base: str, settings: IngestSettings
) -> list[LaserChoice]:
    """Choose lasers; a pose that was passed is that of one laser, so others are left out then."""
    choices = choose_lasers(joined.name, view_lasers(joined, tree, base), settings.scan_topic)
    if settings.laser_pose is None:
        return choices
    best = next(choice for choice in choices if choice.used and not choice.why.endswith("merged"))
    return [
        choice
        if choice is best or not choice.used
        else LaserChoice(choice.view, False, "one laser pose was set")
        for choice in choices
    ]


def _cut_ends(columns: Columns, odometry: Odometry, joined: RawRecording) -> F64:
    """Drop the few sweeps before and after the odometry; returns the poses of those that stay."""
    kept = ends_without_odometry(odometry.poses)
    cut = columns.stamps_ns.size - (kept.stop - kept.start)
    if cut:
        joined.dropped["scan before the first or after the last odometry"] += cut
        columns.keep(kept)
    poses = odometry.poses[kept]
    missing = poses.shape[0] - int(np.count_nonzero(known_rows(poses)))
    if missing and odometry.source != "none":
        joined.warnings.append(f"{missing} scans have no odometry")
    return poses


def _sensor_poses(poses: F64, mounting: Mounting, folder: Path | None) -> F64:
    """odom_from_sensor (n, 3) from odom_from_robot; in blocks, to save memory."""
    result: F64 = new_table(poses.shape[0], 3, folder, np.float64)
    for rows in spans(poses.shape[0], poses, result):
        result[rows] = compose(poses[rows], mounting.robot_from_sensor)
    return result


def _bearing_table(columns: Columns, mountings: Sequence[Mounting]) -> F64:
    """Directions of the beams of each geometry (n_geometries, n_beams); they run backwards where upside down."""
    table = np.full((len(columns.geometries), columns.ranges_m.shape[1]), np.nan)
    for row, (laser, shape) in enumerate(columns.geometries):
        sign = -1.0 if mountings[laser].is_upside_down else 1.0
        table[row, : shape.n_beams] = sign * shape.bearings_rad
    return table


def _rewrite_ranges(
    columns: Columns,
    number: int,
    choice: LaserChoice,
    bearings_rad: F64,
    odom_from_sensor: F64,
    settings: IngestSettings,
    folder: Path | None,
) -> NoReturn:
    """Find what beams without return say for one laser, and rewrite its ranges."""
    rows = np.flatnonzero(columns.laser == number)
    is_only_one = rows.size == columns.laser.size
    shape = choice.view.laser.usual_shape
    sweeps = Sweeps(
        columns.ranges_m if is_only_one else picked_rows(columns.ranges_m, rows, folder),
        bearings_rad,
        picked(columns.geometry_index, rows),
        picked(odom_from_sensor, rows),
    )
    verdict = judge_no_return(sweeps, shape.range_min_m, shape.range_max_m, settings.no_return)
    apply_no_return(sweeps.ranges_m, shape.range_min_m, verdict)
    give_back(odom_from_sensor)
    if not is_only_one:
        put_rows(columns.ranges_m, rows, sweeps.ranges_m)
    return verdict


def _drop_empty(columns: Columns, poses: F64, joined: RawRecording) -> F64:
    """Drop sweeps in which no beam says anything; returns the poses of those that stay."""
    says_something, has_return = _content_of(columns.ranges_m)
    if not has_return:
        _, shape = columns.geometries[0]
        reach = f"{shape.range_max_m:g} m" if np.isfinite(shape.range_max_m) else "a reach that is not stated"
        order = "" if shape.range_min_m < shape.range_max_m else ", for range_min is not below range_max"
        msg = (
            f"{joined.name}: no beam of any scan is a return between {shape.range_min_m:g} m and {reach}{order}"
            f"{losses_of(joined)}. Check range_min and range_max of the driver, or pass another --scan-topic."
        )
        raise LogError(msg)
    if says_something.all():
        return poses
    joined.dropped["scan without any measurement"] += int(np.count_nonzero(~says_something))
    columns.keep(says_something)
    return np.asarray(poses[says_something])


def _content_of(ranges_m: F32) -> tuple[B1, bool]:
    """Which sweeps (n,) have a beam that says something, and whether any beam has a return."""
    says_something = np.zeros(ranges_m.shape[0], dtype=bool)
    has_return = False
    for rows in blocks_of(ranges_m):
        block = ranges_m[rows]
        says_something[rows] = ~np.isnan(block).all(axis=1)
        has_return = has_return or bool(np.isfinite(block).any())
        give_back(ranges_m)
    return says_something, has_return


def _scan_log(
    columns: Columns,
    poses: F64,
    bearings_rad: F64,
    mountings: Sequence[Mounting],
    verdicts: Sequence[NoReturn],
    names: tuple[str, ...],
) -> ScanLog:
    """Build the geometry table and put everything together."""
    return ScanLog(
        stamps_ns=columns.stamps_ns,
        ranges_m=columns.ranges_m,
        odometry=poses,
        geometry_index=columns.geometry_index,
        bearings_rad=bearings_rad,
        sensor_poses=np.array([mountings[laser].robot_from_sensor for laser, _ in columns.geometries]),
        range_limits_m=np.array(
            [(shape.range_min_m, verdicts[laser].reach_m) for laser, shape in columns.geometries]
        ),
        beam_interval_s=columns.beam_interval_s,
        recording_index=columns.recording_index,
        recordings=names,
    )
