"""Speed of reading recordings, each container beside the bare library (or, for text, bare numbers) in the same run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from tests.bench import beams
from tests.bench.measured import dynmap, stage_seconds
from tests.bench.tables import Row, Table
from tests.bench.worlds import Bench

_STORE = get_typestore(Stores.ROS2_HUMBLE)
_SCAN = "sensor_msgs/msg/LaserScan"
_WORLD = "office_two_hours"
_GOAL = "80 % of bare"


def reading_rows(bench: Bench, table: Table, cpu_s: Callable[[Callable[[], object]], float]) -> None:
    """One row for each container."""
    for name, path in _containers(bench).items():
        table.add(f"reading {name}, scans per s", lambda path=path: _row(path, cpu_s))
    table.add("ingest of MCAP, the whole stage, scans per s", lambda: _stage_row(bench))


def _row(path: Path, cpu_s: Callable[[Callable[[], object]], float]) -> Row:
    """Everything that is decided while reading included, without the start of the program."""
    log, _ = read_recordings([path], IngestSettings())
    ours = cpu_s(lambda: read_recordings([path], IngestSettings()))
    is_text = path.suffix == ".log"
    alone = cpu_s(lambda: _bare_text(path) if is_text else _bare_bag(path))
    what = "splitting and float() alone" if is_text else "rosbags alone, all read, scans decoded"
    return [
        f"{log.n_scans / ours:.0f}",
        "20000" if is_text else _GOAL,
        f"{log.n_scans} scans of {log.n_beams} beams; {what}: {log.n_scans / alone:.0f} ({alone / ours:.0%})",
    ]


def _stage_row(bench: Bench) -> Row:
    """With the start of the libraries, writing and checksums."""
    recording = bench.recorded(_WORLD, f"{_WORLD}-cut", lane=beams.CUT[_WORLD])
    run_dir, _ = bench.built(f"{_WORLD}-cut", recording)
    n_scans = np.load(run_dir / "scans" / "stamps_ns.npy").size
    seconds = stage_seconds(run_dir)["ingest"]
    return [f"{n_scans / seconds:.0f}", "", f"{seconds:.2f} s with imports, writing and checksums"]


def _containers(bench: Bench) -> dict[str, Path]:
    """The same drive in every container."""
    mcap = bench.recorded(_WORLD, f"{_WORLD}-cut", lane=beams.CUT[_WORLD])
    found = {"MCAP": mcap}
    for name, suffix in (("a ROS 1 bag", ".bag"), ("CARMEN text", ".log")):
        found[name] = mcap.with_suffix(suffix)
        if not found[name].exists():
            dynmap(
                "simulate",
                mcap.with_suffix(".yaml"),
                "-o",
                found[name],
                "--force",
                log=bench.folder / "simulate.txt",
            )
    found["a ROS 2 .db3"] = mcap.with_name(f"{mcap.stem}-db3")
    if not found["a ROS 2 .db3"].exists():
        _write_db3(mcap, found["a ROS 2 .db3"])
    return found


def _write_db3(mcap: Path, folder: Path) -> None:
    """The same messages in SQLite."""
    with (
        AnyReader([mcap]) as reader,
        Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer,
    ):
        into = {
            connection.id: writer.add_connection(connection.topic, connection.msgtype, typestore=_STORE)
            for connection in reader.connections
        }
        for connection, logged_ns, data in reader.messages():
            writer.write(into[connection.id], logged_ns, data)


def _bare_bag(path: Path) -> int:
    """Read all messages with the library, decode the scans."""
    with AnyReader([path], default_typestore=_STORE) as reader:
        return sum(
            reader.deserialize(data, connection.msgtype).ranges.size > 0
            for connection, _, data in reader.messages()
            if connection.msgtype == _SCAN
        )


def _bare_text(path: Path) -> int:
    """Turn the numbers of the scans into arrays, nothing else."""
    count = 0
    for line in path.read_bytes().splitlines():
        if line.startswith((b"FLASER", b"ROBOTLASER")):
            count += np.array(line.split()[2:-2], dtype=np.float64).size
    return count
