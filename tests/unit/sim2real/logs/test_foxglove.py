"""Recordings for Foxglove and Lichtblick: schemas, primitives, images, and files of writers that were stopped."""

import base64
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerial_gym.config.shape import PartCfg, ShapeCfg
from aerial_gym.sim2real.logs import foxglove as fox
from aerial_gym.sim2real.logs.readers.ros_files import read_message_sources
from tests.unit.sim2real.logs.foxglove_files import read_and_check

pytest.importorskip("mcap")

BOX = ShapeCfg(kind="box", size=(1.0, 2.0, 3.0), color=(1.0, 0.5, 0.0))
SHAPES = (
    BOX, ShapeCfg(kind="sphere", radius=0.5), ShapeCfg(kind="cylinder", radius=0.5, height=2.0),
    ShapeCfg(kind="capsule", radius=0.5, height=2.0), ShapeCfg(kind="plane"),
)  # fmt: skip
UNTURNED = (np.zeros(3), np.array((0.0, 0.0, 0.0, 1.0)))


def test_every_message_has_the_published_fields(tmp_path: Path) -> None:
    primitives = fox.part_primitives((PartCfg(shape=shape), *UNTURNED) for shape in SHAPES)
    assert {kind: len(each) for kind, each in primitives.items() if each} == {"cubes": 2, "spheres": 3, "cylinders": 2}
    primitives["lines"] = [fox.line_primitive(np.eye(3))]
    file, at = fox.McapFile(tmp_path / "a.mcap", "a test"), 1_234_567_890
    for message in (
        fox.transforms_message(at, [fox.transform(at, "world", "vehicle", (1.0, 2.0, 3.0), fox.OPTICAL)]),
        fox.frame_message(at, "/pose", "PoseInFrame", "world", pose=fox.pose((1.0, 2.0, 3.0))),
        fox.scene_message(at, "/scene", {"vehicle": primitives}),
        fox.depth_message(at, "/depth", "vehicle", np.array([[1.2344, np.nan], [100.0, 0.0]])),
        fox.frame_message(at, "/color", "CompressedImage", "vehicle", data=b"png", format="png"),
        fox.points_message(at, "/points", "vehicle", np.array([[1.0, 2.0, 3.0]])),
        fox.number_message(at, "/state", {"p_x": 1.0, "omega_x": float("nan")}),
    ):
        file.write(message)
    file.close()
    topics = read_and_check(tmp_path / "a.mcap")
    assert topics["/state"][0][1] == {"p_x": 1.0, "omega_x": None}
    depth = np.frombuffer(base64.b64decode(topics["/depth"][0][1]["data"]), dtype="<u2")
    assert depth.tolist() == [1234, 0, 65535, 0]  # millimetres, 0 for no measurement
    points = np.frombuffer(base64.b64decode(topics["/points"][0][1]["data"]), dtype="<f4")
    assert points.tolist() == [1.0, 2.0, 3.0]


def test_a_part_stands_where_its_carrier_and_its_own_pose_put_it() -> None:
    """A yaw of 90 degrees turns the part's offset x into y; its own roll follows."""
    turn = Rotation.from_euler("Z", np.pi / 2)
    part = PartCfg(shape=BOX, position=(1.0, 0.0, 0.5), euler=(0.3, 0.0, 0.0))
    (box,) = fox.part_primitives([(part, np.array((10.0, 0.0, 0.0)), turn.as_quat())])["cubes"]
    assert tuple(box["pose"]["position"].values()) == pytest.approx((10.0, 1.0, 0.5))
    attitude = Rotation.from_quat(list(box["pose"]["orientation"].values()))
    assert attitude.as_euler("ZYX") == pytest.approx((np.pi / 2, 0.0, 0.3), abs=1e-6)
    assert (box["size"], box["color"]) == ({"x": 1.0, "y": 2.0, "z": 3.0}, {"r": 1.0, "g": 0.5, "b": 0.0, "a": 1.0})


def test_the_image_axes_of_a_camera_point_right_down_and_forward() -> None:
    axes = Rotation.from_quat(fox.OPTICAL).as_matrix().T
    np.testing.assert_allclose(axes, [(0.0, -1.0, 0.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)], atol=1e-12)


def test_a_stopped_writer_leaves_all_but_its_last_chunk(tmp_path: Path) -> None:
    """The file is read while it is open, and after it was cut within a chunk."""
    path, count = tmp_path / "a.mcap", 5000
    file = fox.McapFile(path, "a test")
    for number in range(count):
        file.write(fox.number_message(number, "/state", {"p_x": float(number)}))
    (source,) = read_message_sources(path)
    assert source.times == list(range(len(source.times)))
    assert (count - len(source.times)) * len(source.messages[-1]) < fox.CHUNK_BYTES
    stream_reader = pytest.importorskip("mcap.stream_reader")
    records = stream_reader.StreamReader(path.open("rb"), emit_chunks=True).records
    assert sum(type(record).__name__ == "Chunk" for record in _until_the_end(records)) > 1
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    (rest,) = read_message_sources(path)
    assert 0 < len(rest.times) < len(source.times)
    assert [json.loads(one)["p_x"] for one in rest.messages] == [float(at) for at in rest.times]


def _until_the_end(records):
    from mcap.exceptions import EndOfFile

    try:
        yield from records
    except EndOfFile:
        return
