"""MCAP files for Foxglove and Lichtblick: messages in JSON, and the schemas of poses, scenes, images and points.

Frames: world is z up, bodies are x forward, y left, z up; quaternions are xyzw, body to world. Times are whole nanoseconds.

Source: Foxglove, *Message schemas* (github foxglove/foxglove-sdk, schemas/jsonschema); MCAP specification (mcap.dev/spec).
"""

import json
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from aerial_gym.config.shape import PartCfg, ShapeCfg
from aerial_gym.extras import optional_import
from aerial_gym.sim2real.arrays import Array

CHUNK_BYTES = 2**16  # A killed recording loses its last chunk, at most so many bytes before compression
SECOND = 1_000_000_000  # [ns]
WORLD = "world"  # Frame that all others hang on
OPTICAL = (-0.5, 0.5, -0.5, 0.5)  # From a camera's axes (x forward) to those of its image: x right, y down, z forward
IDENTITY = (0.0, 0.0, 0.0, 1.0)
PLANE_M = 200.0  # Edge of the square that stands for an endless plane [m]
UNITS = {
    "t": "s", "p": "m", "q": "1", "v": "m/s", "omega": "rad/s", "acc": "m/s²", "rotor": "rad/s", "cmd": "rad/s", "share": "1",
    "vbat": "V", "yaw": "rad", "thrust": "1", "specific": "m/s²", "action": "see controller",
}  # fmt: skip
"""Unit by the first word of a column name, behind ``sp_`` of setpoints."""

Json = dict[str, Any]
PRIMITIVES = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")


@dataclass(frozen=True)
class McapMessage:
    """A message of one topic."""

    time: int  # [ns]
    topic: str
    content: Json  # Bytes are written in base64
    schema: str = ""  # Name, such as ``foxglove.PoseInFrame``; none without
    units: Mapping[str, str] = field(default_factory=dict)  # Unit of each field, for the metadata of the topic


class McapFile:
    """An MCAP file with an index; a killed writer leaves a file for readers that need no index."""

    def __init__(self, path: Path, library: str) -> None:
        """Create the file; ``library`` names its writer."""
        with optional_import("writing MCAP"):
            from mcap.writer import Writer
        self._stream = path.open("wb")
        self._writer = Writer(self._stream, chunk_size=CHUNK_BYTES)
        self._writer.start(profile="", library=library)
        self._channels: dict[str, int] = {}
        self._schemas: dict[tuple[str, bytes], int] = {}

    def write(self, message: McapMessage) -> None:
        """Append a message; the first one of a topic determines its schema."""
        topic, time = message.topic, message.time
        if topic not in self._channels:
            schema, units = self._find_schema(message), dict(message.units)
            number = self._writer.register_channel(topic, "json", schema_id=schema, metadata=units)
            self._channels[topic] = number
        data = json.dumps(message.content, default=lambda part: b64encode(part).decode()).encode()
        self._writer.add_message(self._channels[topic], log_time=time, publish_time=time, data=data)
        self._stream.flush()

    def _find_schema(self, message: McapMessage) -> int:
        text = json.dumps({"title": message.schema, **json_schema(message.content)}).encode()
        key = (message.schema, text)
        if message.schema and key not in self._schemas:
            self._schemas[key] = self._writer.register_schema(name=message.schema, encoding="jsonschema", data=text)
        return self._schemas.get(key, 0)

    def close(self) -> None:
        """Write the index and close the file."""
        self._writer.finish()
        self._stream.close()


def json_schema(value: object) -> Json:
    """Return the JSON schema of a value, without references and alternatives, which Lichtblick does not read."""
    if isinstance(value, Mapping):
        return {"type": "object", "properties": {name: json_schema(part) for name, part in value.items()}}
    if isinstance(value, list):
        return {"type": "array", "items": json_schema(value[0] if value else {})}
    if isinstance(value, bytes):
        return {"type": "string", "contentEncoding": "base64"}
    return {"type": {bool: "boolean", str: "string", int: "integer"}.get(type(value), "number")}


def column_units(columns: Iterable[str]) -> dict[str, str]:
    """Return the unit of each column in the layout of this package."""
    return {column: UNITS[column.removeprefix("sp_").split("_")[0]] for column in columns}


def number_message(time: int, topic: str, values: Mapping[str, float]) -> McapMessage:
    """Return numbers by column name for plots; those that are not finite become null."""
    content = {name: value if isfinite(value) else None for name, value in values.items()}
    return McapMessage(time, topic, content, f"aerial_gym.{topic.rsplit('/', 1)[-1]}", column_units(values))


def stamp(time: int) -> Json:
    """Return a time as Foxglove writes it."""
    return {"sec": time // SECOND, "nsec": time % SECOND}


def vector(values: Iterable[float], axes: str = "xyzw") -> Json:
    """Return a vector (3,) or a quaternion (4,), with 7 decimals."""
    return {axis: round(float(value), 7) for axis, value in zip(axes, values, strict=False)}


def pose(position: Iterable[float], attitude: Iterable[float] = IDENTITY) -> Json:
    """Return a pose from a position [m] and a quaternion."""
    return {"position": vector(position), "orientation": vector(attitude)}


def transform(time: int, parent: str, child: str, position: Iterable[float], attitude: Iterable[float]) -> Json:
    """Return the place of the frame ``child`` in the frame ``parent``."""
    frames = {"timestamp": stamp(time), "parent_frame_id": parent, "child_frame_id": child}
    return {**frames, "translation": vector(position), "rotation": vector(attitude)}


def transforms_message(time: int, transforms: list[Json]) -> McapMessage:
    """Return the message with all places of frames at one time."""
    return McapMessage(time, "/tf", {"transforms": transforms}, "foxglove.FrameTransforms")


def frame_message(time: int, topic: str, schema: str, frame: str, **content: object) -> McapMessage:
    """Return a message of Foxglove that lies in a frame."""
    return McapMessage(time, topic, {"timestamp": stamp(time), "frame_id": frame, **content}, f"foxglove.{schema}")


def scene_message(time: int, topic: str, shapes: Mapping[str, Mapping[str, list[Json]]]) -> McapMessage:
    """Return the primitives by frame, with which they move, in place of the former ones of the topic."""
    common = {"timestamp": stamp(time), "lifetime": stamp(0), "frame_locked": True, "metadata": []}
    entities = [
        {"frame_id": frame, "id": frame, **common, **{kind: primitives.get(kind, []) for kind in PRIMITIVES}}
        for frame, primitives in shapes.items()
    ]
    return McapMessage(time, topic, {"deletions": [], "entities": entities}, "foxglove.SceneUpdate")


def line_primitive(points: Array) -> Json:
    """Return a blue line of 2 pixels through points [m], (N, 3)."""
    return {
        "type": 0, "pose": pose((0.0, 0.0, 0.0)), "thickness": 2.0, "scale_invariant": True, "colors": [], "indices": [],
        "points": [vector(point) for point in points], "color": vector((0.1, 0.4, 0.8, 1.0), "rgba"),
    }  # fmt: skip


def part_primitives(parts: Iterable[tuple[PartCfg, Iterable[float], Iterable[float]]]) -> dict[str, list[Json]]:
    """Return the primitives of parts, each on a carrier with a position [m], (3,), and an attitude, (4,)."""
    primitives: dict[str, list[Json]] = {kind: [] for kind in PRIMITIVES}
    for part, position, attitude in parts:
        carrier = Rotation.from_quat(attitude)
        turn = carrier * Rotation.from_euler("ZYX", part.euler[::-1])
        for kind, shift, content in _shape_primitives(part.shape):
            place = position + carrier.apply(part.position) + turn.apply(shift)
            primitives[kind].append({"pose": pose(place, turn.as_quat()), **content})
    return primitives


def _shape_primitives(shape: ShapeCfg) -> Sequence[tuple[str, Iterable[float], Json]]:
    """Return kind, position in the frame of the shape [m], and content of each primitive; a mesh becomes its bounding box."""
    from aerial_gym.assets.appearance import DEFAULT_COLORS

    color = {"color": vector((*(shape.color or DEFAULT_COLORS[shape.kind]), 1.0), "rgba")}
    width, height, middle = 2.0 * (shape.radius or 0.0), shape.height or 0.0, (0.0, 0.0, 0.0)
    if shape.kind in ("sphere", "cylinder", "capsule"):
        ends = {"sphere": (0.0,), "cylinder": (), "capsule": (0.5 * height, -0.5 * height)}[shape.kind]
        rod = {"size": vector((width, width, height)), "bottom_scale": 1.0, "top_scale": 1.0, **color}
        rods = [] if shape.kind == "sphere" else [("cylinders", middle, rod)]
        return rods + [("spheres", (0.0, 0.0, end), {"size": vector((width,) * 3), **color}) for end in ends]
    if shape.kind == "mesh":
        from aerial_gym.assets.mesh_files import load_mesh

        low, high = load_mesh(str(shape.path), scale=shape.scale, up=shape.up).bounds
        return [("cubes", 0.5 * (low + high), {"size": vector(high - low), **color})]
    size = shape.size or (PLANE_M, PLANE_M, 0.01)
    return [("cubes", (0.0, 0.0, 0.0 if shape.size else -0.005), {"size": vector(size), **color})]


def depth_message(time: int, topic: str, frame: str, distance: Array) -> McapMessage:
    """Return distances [m], (H, W), as an image in millimetres; NaN becomes 0, as ROS REP 118 states."""
    pixels = np.clip(np.nan_to_num(1000.0 * distance).round(), 0.0, 65535.0).astype("<u2")
    height, width = pixels.shape
    size = {"width": width, "height": height, "encoding": "16UC1", "step": 2 * width}
    return frame_message(time, topic, "RawImage", frame, **size, data=pixels.tobytes())


def points_message(time: int, topic: str, frame: str, points: Array) -> McapMessage:
    """Return points [m], (N, 3), in a frame."""
    fields = [{"name": axis, "offset": 4 * place, "type": 7} for place, axis in enumerate("xyz")]  # 7: float32
    layout = {"pose": pose((0.0, 0.0, 0.0)), "point_stride": 12, "fields": fields}
    return frame_message(time, topic, "PointCloud", frame, **layout, data=points.astype("<f4").tobytes())
