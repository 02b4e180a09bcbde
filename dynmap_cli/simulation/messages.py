"""A simulated run as ROS messages: LaserScan, Odometry, tf and tf_static, in the order of a recorder."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from dynmap_cli.arrays import F32
from dynmap_cli.domain.poses import between
from dynmap_cli.files.ros_messages import ODOMETRY, SCAN, TRANSFORMS, MessageMaker, ScanFields
from dynmap_cli.simulation.robot import Laser
from dynmap_cli.simulation.run import SimulatedRun

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore


class Recorded(NamedTuple):
    """One message as a recorder gets it."""

    time_ns: int
    topic: str
    message_type: str
    message: Any


def topics_of(run: SimulatedRun) -> dict[str, str]:
    """Topics of a run and their message types."""
    topics = {"/tf_static": TRANSFORMS}
    if run.odometry.stamps_ns.size:
        topics.update({"/odom": ODOMETRY, "/tf": TRANSFORMS})
    topics.update({_scan_topic(run, laser): SCAN for laser in run.scenario.lasers})
    return topics


def messages(run: SimulatedRun, store: Typestore) -> Iterator[Recorded]:
    """Yield all messages in the order of their arrival; a scan arrives when its last beam was measured."""
    maker = MessageMaker(store)
    yield from heapq.merge(
        _static_transforms(run, maker),
        _odometry(run, maker),
        _scans(run, maker),
        key=lambda entry: entry.time_ns,
    )


def reported_ranges(ranges_m: F32, laser: Laser) -> F32:
    """What the driver of a laser writes: its own code where nothing came back or a thing was too close."""
    if laser.no_return == "inf":
        return ranges_m
    code = laser.max_range_m if laser.no_return == "max" else 0.0
    out = np.where(np.isinf(ranges_m), np.float32(code), ranges_m)
    return np.asarray(np.where(np.isnan(out), np.float32(0.0), out), dtype=np.float32)


def _scan_topic(run: SimulatedRun, laser: Laser) -> str:
    """`/scan`, or one topic for each of several lasers."""
    return "/scan" if len(run.scenario.lasers) == 1 else f"/{laser.name}/scan"


def _static_transforms(run: SimulatedRun, maker: MessageMaker) -> Iterator[Recorded]:
    """Yield where the lasers sit, once."""
    if run.log.n_scans == 0:
        return
    stamp_ns = int(run.log.stamps_ns[0])
    poses = run.log.sensor_poses.tolist()
    transforms = [
        maker.transform(maker.header(stamp_ns, "base_link", 0), laser.name, pose)
        for laser, pose in zip(run.scenario.lasers, poses, strict=True)
    ]
    yield Recorded(stamp_ns, "/tf_static", TRANSFORMS, maker.transforms(transforms))


def _odometry(run: SimulatedRun, maker: MessageMaker) -> Iterator[Recorded]:
    """Yield odometry and the same as a transform."""
    series = run.odometry
    if series.stamps_ns.size == 0:
        return
    steps = between(series.poses[:-1], series.poses[1:])
    seconds = np.maximum(np.diff(series.stamps_ns) * 1e-9, 1e-6)
    speeds = np.concatenate([np.zeros((1, 3)), steps / seconds[:, None]]).tolist()
    rows = zip(series.stamps_ns.tolist(), series.poses.tolist(), speeds, strict=True)
    for number, (stamp_ns, pose, speed) in enumerate(rows):
        header = maker.header(stamp_ns, "odom", number)
        message = maker.odometry(header, "base_link", pose, speed)
        yield Recorded(stamp_ns, "/odom", ODOMETRY, message)
        moved = maker.transform(header, "base_link", pose)
        yield Recorded(stamp_ns, "/tf", TRANSFORMS, maker.transforms([moved]))


def _scans(run: SimulatedRun, maker: MessageMaker) -> Iterator[Recorded]:
    """Yield the sweeps of all lasers in the order of their ends."""
    log, lasers = run.log, run.scenario.lasers
    sweeps_ns = np.array([round(laser.beam_interval_s * (laser.beams - 1) * 1e9) for laser in lasers])
    ends_ns = log.stamps_ns + sweeps_ns[log.geometry_index]
    numbers = [0] * len(lasers)
    for row in np.argsort(ends_ns, kind="stable").tolist():
        which = int(log.geometry_index[row])
        laser, bearings = lasers[which], log.bearings_rad[which]
        fields = ScanFields(
            float(bearings[0]),
            float(bearings[laser.beams - 1]),
            float(bearings[1] - bearings[0]),
            laser.beam_interval_s,
            1.0 / laser.rate_hz,
            laser.min_range_m,
            laser.max_range_m,
        )
        header = maker.header(int(log.stamps_ns[row]), laser.name, numbers[which])
        message = maker.scan(header, fields, reported_ranges(log.ranges_m[row, : laser.beams], laser))
        numbers[which] += 1
        yield Recorded(int(ends_ns[row]), _scan_topic(run, laser), SCAN, message)
