"""Check MCAP files against Foxglove's published schemas, with readers and templates that share no code with the writer.

Source of the templates: github foxglove/foxglove-sdk, schemas/jsonschema, fields listed as required.
"""

import base64
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

TIME = {"sec": int, "nsec": int}
VECTOR = dict.fromkeys("xyz", float)
QUATERNION = dict.fromkeys("xyzw", float)
POSE = {"position": VECTOR, "orientation": QUATERNION}
COLOR = dict.fromkeys("rgba", float)
CYLINDER = {"pose": POSE, "size": VECTOR, "bottom_scale": float, "top_scale": float, "color": COLOR}
LINE = {
    "type": int, "pose": POSE, "thickness": float, "scale_invariant": bool, "points": [VECTOR], "color": COLOR,
    "colors": [COLOR], "indices": [int],
}  # fmt: skip
TRIANGLES = {"pose": POSE, "points": [VECTOR], "color": COLOR, "colors": [COLOR], "indices": [int]}
BALL = {"pose": POSE, "size": VECTOR, "color": COLOR}
ENTITY = {
    "timestamp": TIME, "frame_id": str, "id": str, "lifetime": TIME, "frame_locked": bool, "metadata": [], "arrows": [],
    "cubes": [BALL], "spheres": [BALL], "cylinders": [CYLINDER], "lines": [LINE], "triangles": [TRIANGLES],
    "texts": [], "models": [],
}  # fmt: skip
PUBLISHED: dict[str, Any] = {
    "foxglove.FrameTransforms": {"transforms": [{
        "timestamp": TIME, "parent_frame_id": str, "child_frame_id": str, "translation": VECTOR, "rotation": QUATERNION,
    }]},
    "foxglove.PoseInFrame": {"timestamp": TIME, "frame_id": str, "pose": POSE},
    "foxglove.SceneUpdate": {"deletions": [], "entities": [ENTITY]},
    "foxglove.CompressedImage": {"timestamp": TIME, "frame_id": str, "data": bytes, "format": str},
    "foxglove.RawImage": {
        "timestamp": TIME, "frame_id": str, "width": int, "height": int, "encoding": str, "step": int, "data": bytes,
    },
    "foxglove.PointCloud": {
        "timestamp": TIME, "frame_id": str, "pose": POSE, "point_stride": int,
        "fields": [{"name": str, "offset": int, "type": int}], "data": bytes,
    },
}  # fmt: skip


def matches(value: Any, template: Any) -> bool:
    """Return whether a value has exactly the fields of a template, with their types."""
    if isinstance(template, dict):
        same = isinstance(value, dict) and value.keys() == template.keys()
        return same and all(matches(value[name], part) for name, part in template.items())
    if isinstance(template, list):
        return isinstance(value, list) and all(bool(template) and matches(one, template[0]) for one in value)
    if template is bytes:
        return bool(base64.b64decode(value, validate=True))
    return type(value) is template


def read_and_check(path: Path) -> dict[str, list[tuple[int, Any]]]:
    """Return log time [ns] and content of the messages of each topic of a complete file; assert what viewers need."""
    jsonschema, reader = pytest.importorskip("jsonschema"), pytest.importorskip("mcap.reader")
    topics: dict[str, list[tuple[int, Any]]] = {}
    with path.open("rb") as stream:
        opened = reader.make_reader(stream, validate_crcs=True)
        summary = opened.get_summary()
        assert summary.chunk_indexes
        written = [*opened.iter_messages(log_time_order=False)]
    assert [m.log_time for *_, m in written] == sorted(m.log_time for *_, m in written)
    assert summary.statistics.message_count == len(written)
    for schema, channel, message in written:
        content = json.loads(message.data)
        topics.setdefault(channel.topic, []).append((message.log_time, content))
        if schema is not None and schema.name.startswith("foxglove."):
            jsonschema.validate(content, json.loads(schema.data))
            assert matches(content, PUBLISHED[schema.name]), (schema.name, content)
    check_frames(topics)
    return topics


def check_frames(topics: Mapping[str, list[tuple[int, Any]]]) -> None:
    """Assert that frames have one root and all uses of them a place, stamps are log times, and quaternions unit."""
    parents, used = {}, set()
    for at, content in (message for messages in topics.values() for message in messages):
        entities = content.get("entities", []) + [content] * ("frame_id" in content) + content.get("transforms", [])
        for one in entities:
            assert one["timestamp"] == {"sec": at // 10**9, "nsec": at % 10**9}
            used |= {one["frame_id"]} if "frame_id" in one else set()
        for one in content.get("transforms", []):
            assert parents.setdefault(one["child_frame_id"], one["parent_frame_id"]) == one["parent_frame_id"]
            assert sum(part**2 for part in one["rotation"].values()) == pytest.approx(1.0, abs=1e-6)
    roots = set(parents.values()) - parents.keys()
    assert len(roots) == 1
    assert used <= parents.keys() | roots
