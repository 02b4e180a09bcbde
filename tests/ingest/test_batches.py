"""Messages decoded many at a time: the same as one by one with the library, whatever is in them."""

import numpy as np
import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Bag2Writer

from dynmap_cli.ingest.containers import bags, mcap_chunks
from dynmap_cli.ingest.containers.bag1_chunks import bag1_blocks
from dynmap_cli.ingest.containers.bags import open_bag, read_bag
from dynmap_cli.ingest.containers.db3_blocks import db3_blocks
from dynmap_cli.ingest.messages import batches, blocks
from dynmap_cli.ingest.messages.blocks import block_of
from dynmap_cli.ingest.messages.layouts import layout_of
from dynmap_cli.ingest.space import Space
from tests.ingest.written import (
    ODOMETRY,
    ROS1,
    ROS2,
    SCAN,
    START_NS,
    TF,
    World,
    build,
    odometry,
    transform,
    write_bag1,
    write_bag2,
    write_mcap,
)

N = 60


def odd_world():
    """Beam counts, frames, numbers of transforms and stamps that change from message to message."""

    def change(number, fields):
        if number % 5 == 2:
            fields["ranges"] = fields["ranges"][:7]
        if number % 11 == 3:
            fields["intensities"] = np.ones(9, dtype=np.float32)
        if number == 20:
            fields["angle_min"] = np.nan
        if number == 21:
            fields["ranges"] = np.zeros(0, dtype=np.float32)
        if number == 22:
            fields["header"]["stamp"] = {"sec": -5, "nanosec": 0}
        if number == 23:
            fields["time_increment"] = np.inf
        if number == 24:
            fields["header"]["frame_id"] = "another_laser"

    world = World(n_scans=N, change=change)
    for number in range(N):
        stamp_ns = START_NS + 10**8 * number + 7
        count = number % 3
        moves = [transform(f"a{number % 2}", f"b{n}", stamp_ns, (n, 0, 0, 0, 0, 0, 1)) for n in range(count)]
        world.extra.append(("/tf", TF, stamp_ns, {"transforms": moves}))
        world.extra.append(
            (
                "/tf_static",
                TF,
                stamp_ns,
                {"transforms": [transform("a0", "b0", stamp_ns, (9, 0, 0, 0, 0, 0, 1))]},
            )
        )
        turn = (0.0, 0.0, 0.0, 3.0 if number == 9 else 1.0)
        place = (np.inf if number == 5 else float(number), 0.0, 0.0)
        world.extra.append(
            ("/wheels", ODOMETRY, stamp_ns, odometry("odom", "base_link", stamp_ns, (*place, *turn)))
        )
    return world


def content_of(recording):
    """All that was read, in plain values."""
    lasers = {
        name: (
            laser.frame,
            laser.stamps_ns.tolist(),
            laser.logged_ns.tolist(),
            [laser.shape_of(n) for n in range(laser.n_scans)],
            [laser.ranges_of(n).tobytes() for n in range(laser.n_scans)],
            laser.beam_interval_s.tobytes(),
        )
        for name, laser in recording.lasers.items()
    }
    tracks = {
        name: (track.frame, track.child, track.stamps_ns.tolist(), track.poses.tobytes())
        for name, track in recording.odometry.items()
    }
    moves = {
        pair: (raw.is_static, raw.stamps_ns.tolist(), raw.values.tobytes())
        for pair, raw in recording.transforms.items()
    }
    return lasers, tracks, moves, dict(recording.dropped), sorted(recording.damage), recording.n_read


def write(path, world, how):
    if how == "bag":
        return write_bag1(path / "a.bag", world), "ROS 1 bag"
    if how == "db3":
        return write_bag2(path / "a", world), "ROS 2 bag"
    if how == "folder":
        return write_bag2(path / "a", world, StoragePlugin.MCAP), "ROS 2 bag"
    return write_mcap(path / "a.mcap", world, "ros2"), "MCAP file"


@pytest.mark.parametrize("world", [World(n_scans=N), odd_world()], ids=["plain", "odd"])
@pytest.mark.parametrize("how", ["bag", "db3", "folder", "mcap"])
@pytest.mark.parametrize("batch", [1, 7, 512])
def test_batches_read_what_the_library_reads(tmp_path, monkeypatch, how, world, batch):
    path, kind = write(tmp_path, world, how)
    monkeypatch.setattr(batches, "_BATCH", batch)
    found = content_of(read_bag(path, "a", kind, Space()))
    monkeypatch.setattr(batches, "has_layout", lambda _: False)
    monkeypatch.setattr(bags, "_from_storage", lambda *_: None)
    assert found == content_of(read_bag(path, "a", kind, Space()))


def test_most_messages_are_read_in_batches(tmp_path, monkeypatch):
    path = write_mcap(tmp_path / "a.mcap", World(n_scans=N), "ros2")
    monkeypatch.setattr(batches.Batches, "_take_alone", lambda *_: pytest.fail("read one by one"))
    assert read_bag(path, "a", "MCAP file", Space()).lasers["/scan"].n_scans == N


def test_broken_messages_among_whole_ones_are_counted(tmp_path, monkeypatch):
    path, broken = tmp_path / "a.mcap", {3: -5, 8: 4, 20: -30}
    with path.open("wb") as stream:
        writer = McapWriter(stream, compression=CompressionType.NONE)
        writer.start(profile="ros2", library="test")
        channels = {}
        for number, (topic, kind, logged_ns, fields) in enumerate(World(n_scans=N).messages()):
            if topic not in channels:
                definition = ROS2.generate_msgdef(kind, ros_version=2)[0].encode()
                schema = writer.register_schema(kind, "ros2msg", definition)
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            data = bytes(ROS2.serialize_cdr(build(ROS2, kind, fields), kind))
            cut = broken.get(number, 0)
            data = data[:cut] if cut < 0 else data + bytes(cut)
            writer.add_message(channels[topic], logged_ns, data, logged_ns)
        writer.finish()
    found = read_bag(path, "a", "MCAP file", Space())
    assert sum(found.dropped.values()) == 3
    monkeypatch.setattr(batches, "has_layout", lambda _: False)
    assert content_of(found) == content_of(read_bag(path, "a", "MCAP file", Space()))


@pytest.mark.parametrize(("store", "is_cdr"), [(ROS1, False), (ROS2, True)])
@pytest.mark.parametrize("kind", [SCAN, ODOMETRY, TF])
def test_no_message_that_is_cut_off_or_altered_reads_outside_itself(store, is_cdr, kind):
    fields = next(fields for _, found, _, fields in World().messages() if found == kind)
    message = build(store, kind, fields)
    data = bytes(store.serialize_cdr(message, kind) if is_cdr else store.serialize_ros1(message, kind))
    assert layout_of(data, kind, is_cdr=is_cdr).parts
    for length in range(len(data) - 3):
        with pytest.raises(ValueError, match=r"encoding|cut off|length|end"):
            layout_of(data[:length], kind, is_cdr=is_cdr)
    for place in range(min(len(data) - 4, 60)):
        altered = data[:place] + b"\xff\xff\xff\x7f" + data[place + 4 :]
        try:
            layout = layout_of(altered, kind, is_cdr=is_cdr)
        except ValueError:
            continue
        assert all(at + wanted.size <= len(data) for at, wanted, _ in layout.spans)


@pytest.mark.parametrize("swapped", [False, True])
def test_chunks_that_overlap_in_time_come_in_the_order_of_rosbags(tmp_path, swapped):
    path = tmp_path / "a.mcap"
    draw = np.random.default_rng(4)
    with path.open("wb") as stream:
        writer = McapWriter(stream, chunk_size=300, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="test")
        schema = writer.register_schema(SCAN, "ros2msg", b"")
        channels = [writer.register_channel(topic, "cdr", schema) for topic in ("/a", "/b")]
        for number in range(200):
            at = number // 5 * 10 + int(draw.integers(0, 25)) * swapped
            writer.add_message(channels[number % 2], at, f"message {number:4}".encode(), at)
        writer.finish()
    with AnyReader([path]) as reader:
        expected = [(at, bytes(data)) for _, at, data in reader.messages()]
        storage = reader.readers[0].storage
        assert mcap_chunks.are_orderly(storage.chunks)
        blocks = list(mcap_chunks.ordered_messages(storage, {1: 0, 2: 1}))
        found = [
            (at, block.data_of(row)) for block in blocks for row, at in enumerate(block.logged_ns.tolist())
        ]
    assert found == expected


@pytest.mark.parametrize("swapped", [False, True])
def test_chunks_of_a_bag_come_in_the_order_of_rosbags(tmp_path, swapped):
    draw = np.random.default_rng(4)
    writer = Bag1Writer(tmp_path / "a.bag")
    writer.chunk_threshold = 300
    writer.set_compression(Bag1Writer.CompressionFormat.LZ4)
    with writer:
        connections = [writer.add_connection(topic, SCAN, typestore=ROS1) for topic in ("/a", "/b")]
        for number in range(200):
            at = number // 5 * 10 + int(draw.integers(0, 25)) * swapped
            writer.write(connections[number % 2], at, f"message {number:4}".encode())
    with AnyReader([tmp_path / "a.bag"]) as reader:
        expected = [(at, bytes(data)) for _, at, data in reader.messages()]
        (inner,) = reader.readers
        numbers = {connection.id: connection.id for connection in inner.connections}
        blocks = list(bag1_blocks(inner, inner.connections, numbers))
        found = [
            (at, block.data_of(row)) for block in blocks for row, at in enumerate(block.logged_ns.tolist())
        ]
    assert found == expected


def test_a_chunk_whose_index_does_not_fit_is_walked_through(tmp_path, monkeypatch):
    path = write_mcap(tmp_path / "a.mcap", World(n_scans=N), "ros2")
    found = content_of(read_bag(path, "a", "MCAP file", Space()))
    monkeypatch.setattr(mcap_chunks, "_indexed", lambda *_: None)
    assert found == content_of(read_bag(path, "a", "MCAP file", Space()))


def test_rows_of_a_db3_come_in_the_order_of_rosbags(tmp_path, monkeypatch):
    monkeypatch.setattr(blocks, "_MOST_AT_ONCE", 70)
    draw = np.random.default_rng(4)
    with Bag2Writer(tmp_path / "a", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connections = [writer.add_connection(topic, SCAN, typestore=ROS2) for topic in ("/a", "/b", "/c")]
        for number in range(400):
            at = number // 5 * 10 + int(draw.integers(0, 25))
            writer.write(
                connections[number % 3], at, bytes(draw.integers(0, 40)) + f"message {number}".encode()
            )
    with AnyReader([tmp_path / "a"]) as reader:
        asked = [connection for connection in reader.connections if connection.topic != "/b"]
        expected = [(connection.topic, at, bytes(data)) for connection, at, data in reader.messages(asked)]
    with open_bag(tmp_path / "a") as reader:
        (storage,) = reader.readers[0].storage.storages
        topics = {connection.id: connection.topic for connection in storage.connections}
        names = ["/c", "/a"]
        wanted = {number: names.index(topic) for number, topic in topics.items() if topic != "/b"}
        found = [
            (names[channel], at, block.data_of(row))
            for block in db3_blocks(storage, wanted)
            for row, (channel, at) in enumerate(zip(block.channels, block.logged_ns.tolist(), strict=True))
        ]
        counted = {connection.topic: connection.msgcount for connection in storage.connections}
    assert found == expected
    assert counted == {"/a": 134, "/b": 133, "/c": 133}


def test_a_time_of_recording_beyond_all_times_is_the_latest():
    """Found by `make fuzz`: a byte put into an MCAP made a time of over 2**63 ns."""
    block = block_of([b"ab", b"c"], [0, 0], (2**64 - 1, 5))
    assert block.logged_ns.tolist() == [2**63 - 1, 5]
    assert block.content.tobytes() == b"abc"
