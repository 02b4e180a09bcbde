"""From what was found and decided to the report."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.ingest.choices.frames import FrameTree, Mounting
from dynmap_cli.ingest.choices.lasers import LaserChoice
from dynmap_cli.ingest.choices.merging import Drive
from dynmap_cli.ingest.choices.odometry_sources import Odometry
from dynmap_cli.ingest.choices.ranges import NoReturn
from dynmap_cli.ingest.choices.timing import timing_of
from dynmap_cli.ingest.choices.track_quality import quality_of
from dynmap_cli.ingest.raw.recording import RawRecording, file_name
from dynmap_cli.ingest.report import IngestReport, LaserReport, RecordingReport


def report_on(
    drive: Drive,
    joined: RawRecording,
    choices: Sequence[LaserChoice],
    mountings: Sequence[Mounting],
    verdicts: Sequence[NoReturn],
    masked: Sequence[str],
    odometry: Odometry,
    log: ScanLog,
    out_of_order: int,
    base: str,
    tree: FrameTree,
) -> IngestReport:
    """Say what was found and decided."""
    used = [choice for choice in choices if choice.used]
    decided = {
        id(choice): found
        for choice, found in zip(used, zip(mountings, verdicts, masked, strict=True), strict=True)
    }
    span_s = float(log.stamps_ns[-1] - log.stamps_ns[0]) * 1e-9
    return IngestReport(
        recordings=tuple(
            RecordingReport(file_name(found.name), found.kind, found.n_read, tuple(found.topics))
            for found in drive.recordings
        ),
        lasers=tuple(_laser_report(choice, decided.get(id(choice))) for choice in choices),
        scans=log.n_scans,
        geometries=log.sensor_poses.shape[0],
        span_s=round(span_s, 3),
        out_of_order=out_of_order,
        base_frame=base,
        frames=tree.frames,
        odometry=odometry.source,
        odometry_why=odometry.why,
        odometry_rejected=odometry.rejected,
        odometry_path_m=round(odometry.path_m, 3),
        odometry_longest_gap_s=round(odometry.longest_gap_s, 3),
        odometry_rate_hz=round(odometry.rate_hz, 3),
        odometry_quality=quality_of(log),
        scans_without_odometry=int(np.count_nonzero(~log.has_odometry)),
        dropped=dict(joined.dropped),
        warnings=tuple(joined.warnings),
        notes=tuple(joined.notes),
        why_apart=drive.why_apart,
        first_stamp_ns=int(log.stamps_ns[0]),
        damage=tuple(joined.damage),
    )


def _laser_report(choice: LaserChoice, decided: tuple[Mounting, NoReturn, str] | None) -> LaserReport:
    """Say what is known of one laser."""
    laser = choice.view.laser
    lengths, _ = laser.lengths_counted
    stated = laser.usual_shape.range_max_m
    timing = timing_of(laser)
    mounting, verdict, masked = decided or (choice.view.mounting, None, "")
    pose = None
    if mounting is not None:
        x, y, yaw = (round(float(value), 6) for value in mounting.robot_from_sensor)
        pose = (x, y, yaw)
    return LaserReport(
        name=laser.name,
        frame=laser.frame,
        used=choice.used,
        why=choice.why,
        scans=laser.n_scans,
        beams=(int(lengths[0]), int(lengths[-1])),
        field_of_view_deg=round(float(np.degrees(choice.view.field_of_view_rad)), 2),
        rate_hz=timing.rate_hz,
        reach_m=round(stated, 3) if np.isfinite(stated) else None,
        pose=pose,
        is_pose_known=mounting is not None and not mounting.is_assumed,
        upside_down=mounting.is_upside_down if mounting else False,
        no_return=verdict.policy if verdict else "",
        no_return_why=verdict.why if verdict else "",
        share_no_return=round(verdict.share_no_return, 5) if verdict else 0.0,
        share_no_measurement=round(verdict.share_nothing, 5) if verdict else 0.0,
        timing=timing,
        masked=masked,
    )
