"""Recordings with known content as messages of Foxglove, in JSON and protobuf; the bytes are made by hand."""

import json
import struct

from mcap.writer import Writer

STRING, MESSAGE, DOUBLE, INT64, INT32 = 9, 11, 1, 3, 5
# type -> (name, number, kind, type name or "", is repeated)
TYPES = {
    "google.protobuf.Timestamp": [("seconds", 1, INT64, "", False), ("nanos", 2, INT32, "", False)],
    "foxglove.Vector3": [(axis, number, DOUBLE, "", False) for number, axis in enumerate("xyz", 1)],
    "foxglove.Quaternion": [(axis, number, DOUBLE, "", False) for number, axis in enumerate("xyzw", 1)],
    "foxglove.Pose": [
        ("position", 1, MESSAGE, "foxglove.Vector3", False),
        ("orientation", 2, MESSAGE, "foxglove.Quaternion", False),
    ],
    "foxglove.LaserScan": [
        ("timestamp", 1, MESSAGE, "google.protobuf.Timestamp", False),
        ("frame_id", 2, STRING, "", False),
        ("pose", 3, MESSAGE, "foxglove.Pose", False),
        ("start_angle", 4, DOUBLE, "", False),
        ("end_angle", 5, DOUBLE, "", False),
        ("ranges", 6, DOUBLE, "", True),
    ],
    "foxglove.FrameTransform": [
        ("timestamp", 1, MESSAGE, "google.protobuf.Timestamp", False),
        ("parent_frame_id", 2, STRING, "", False),
        ("child_frame_id", 3, STRING, "", False),
        ("translation", 4, MESSAGE, "foxglove.Vector3", False),
        ("rotation", 5, MESSAGE, "foxglove.Quaternion", False),
    ],
    "foxglove.FrameTransforms": [("transforms", 1, MESSAGE, "foxglove.FrameTransform", True)],
    "foxglove.PoseInFrame": [
        ("timestamp", 1, MESSAGE, "google.protobuf.Timestamp", False),
        ("frame_id", 2, STRING, "", False),
        ("pose", 3, MESSAGE, "foxglove.Pose", False),
    ],
}


def varint(value):
    value &= (1 << 64) - 1
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def sized(number, data):
    return varint(number << 3 | 2) + varint(len(data)) + data


def whole(number, value):
    return varint(number << 3) + varint(value)


def descriptors():
    """FileDescriptorSet with a file for each package."""
    files = b""
    for package in ("google.protobuf", "foxglove"):
        types = b""
        for name, fields in TYPES.items():
            if name.rpartition(".")[0] != package:
                continue
            content = sized(1, name.rpartition(".")[2].encode())
            for field, number, kind, type_name, is_repeated in fields:
                one = (
                    sized(1, field.encode())
                    + whole(3, number)
                    + whole(4, 3 if is_repeated else 1)
                    + whole(5, kind)
                )
                content += sized(2, one + (sized(6, f".{type_name}".encode()) if type_name else b""))
            types += sized(4, content)
        files += sized(1, sized(1, f"{package}.proto".encode()) + sized(2, package.encode()) + types)
    return files


def protobuf(kind, fields):
    """A message; numbers that are zero are left out, as its libraries do."""
    data = b""
    for name, number, field_kind, type_name, is_repeated in TYPES[kind]:
        value = fields.get(name)
        if value is None:
            continue
        if is_repeated and field_kind == DOUBLE:
            data += sized(number, struct.pack(f"<{len(value)}d", *value))
        elif field_kind == MESSAGE:
            for one in value if is_repeated else [value]:
                data += sized(number, protobuf(type_name, one))
        elif field_kind == STRING:
            data += sized(number, value.encode())
        elif field_kind == DOUBLE and value != 0.0:
            data += varint(number << 3 | 1) + struct.pack("<d", value)
        elif field_kind in (INT64, INT32) and value:
            data += whole(number, value)
    return data


def in_foxglove(kind, fields, encoding):
    """Type and fields of the message of Foxglove that says what one of ROS says."""

    def stamp(header):
        names = ("seconds", "nanos") if encoding == "protobuf" else ("sec", "nsec")
        return dict(zip(names, (header["stamp"]["sec"], header["stamp"]["nanosec"]), strict=True))

    if kind == "tf2_msgs/msg/TFMessage":
        moves = [
            {
                "timestamp": stamp(one["header"]),
                "parent_frame_id": one["header"]["frame_id"],
                "child_frame_id": one["child_frame_id"],
                "translation": one["transform"]["translation"],
                "rotation": one["transform"]["rotation"],
            }
            for one in fields["transforms"]
        ]
        return "foxglove.FrameTransforms", {"transforms": moves}
    common = {"timestamp": stamp(fields["header"]), "frame_id": fields["header"]["frame_id"]}
    if kind == "nav_msgs/msg/Odometry":
        return "foxglove.PoseInFrame", {**common, "pose": fields["pose"]["pose"]}
    return "foxglove.LaserScan", {
        **common,
        "pose": fields.get("pose"),
        "start_angle": fields["angle_min"],
        "end_angle": fields["angle_max"],
        "ranges": [float(value) for value in fields["ranges"]],
    }


def write_foxglove(path, world, encoding, profile="", **options):
    """An MCAP file of messages of Foxglove."""
    schema = descriptors() if encoding == "protobuf" else b'{"type": "object"}'
    with path.open("wb") as stream:
        writer = Writer(stream, **{"chunk_size": 2000, **options})
        writer.start(profile=profile, library="test")
        channels = {}
        for topic, kind, logged_ns, fields in world.messages():
            name, said = in_foxglove(kind, fields, encoding)
            if topic not in channels:
                suffix = "protobuf" if encoding == "protobuf" else "jsonschema"
                number = writer.register_schema(name, suffix, schema)
                channels[topic] = writer.register_channel(topic, encoding, number)
            if encoding == "json":
                said = {key: value for key, value in said.items() if value is not None}
                if "ranges" in said and "pose" not in said:
                    said["pose"] = None
            data = protobuf(name, said) if encoding == "protobuf" else json.dumps(said).encode()
            writer.add_message(channels[topic], logged_ns, data, logged_ns)
        writer.finish()
    return path
