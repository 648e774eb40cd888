"""Units and up axes of mesh files: by themselves, in URDF files, and as hulls of robots."""

from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
import warp as wp

from aerial_gym.assets import load_mesh, load_urdf
from aerial_gym.assets.shapes import ShapeTable
from aerial_gym.config.environment import ShapeCfg
from aerial_gym.config.shape import PartCfg
from aerial_gym.errors import ConfigError
from aerial_gym.robots.importers.file_vehicle import part_collision_shape

pytest.importorskip("collada", reason="pycollada is not installed: pip install 'aerial-gym[urdf]'")

wp.init()

LOW, HIGH = np.array([-0.1, -0.2, -0.3]), np.array([0.4, 0.6, 0.9])
"""Corners of a box whose three axes all differ [m], as the file's own axes have them."""

THICKER = 2e-4
"""Bounding boxes in the shape table are larger by 1e-4 of the radius, 1.15 m here, and by 1e-5 of their edges."""

TURNED = {
    "X_UP": ([-0.6, -0.9, -0.1], [0.2, 0.3, 0.4]),  # (x, y, z) of the file stands at (-y, -z, x)
    "Y_UP": ([-0.1, -0.9, -0.2], [0.4, 0.3, 0.6]),  # at (x, -z, y)
    "Z_UP": ([-0.1, -0.2, -0.3], [0.4, 0.6, 0.9]),
}
"""The same corners with the file's up axis along z."""


def collada(folder: Path, *, unit: str = '<unit name="metre" meter="1"/>', up: str = "Z_UP", per_metre: float = 1.0):
    corners = trimesh.creation.box(bounds=per_metre * np.array([LOW, HIGH]))
    numbers = " ".join(f"{value:.9g}" for value in corners.vertices.ravel())
    faces = " ".join(str(index) for index in corners.faces.ravel())
    axis = f"<up_axis>{up}</up_axis>" if up else ""
    path = folder / "box.dae"
    path.write_text(
        '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
        f"<asset><created>2020-01-01T00:00:00</created><modified>2020-01-01T00:00:00</modified>{unit}{axis}</asset>"
        f'<library_geometries><geometry id="g"><mesh><source id="p"><float_array id="a" count="24">{numbers}</float_array>'
        '<technique_common><accessor source="#a" count="8" stride="3"><param name="X" type="float"/>'
        '<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>'
        '<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>'
        f'<triangles count="12"><input semantic="VERTEX" source="#v" offset="0"/><p>{faces}</p></triangles></mesh>'
        '</geometry></library_geometries><library_visual_scenes><visual_scene id="s"><node id="n">'
        '<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>'
        '<scene><instance_visual_scene url="#s"/></scene></COLLADA>'
    )
    return path


def gltf(folder: Path, name: str) -> Path:
    trimesh.creation.box(bounds=[LOW, HIGH]).export(folder / name)
    return folder / name


def urdf(folder: Path, mesh: Path, *, scale: str = "") -> Path:
    shape = f'<collision><geometry><mesh filename="{mesh.name}"{scale}/></geometry></collision>'
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="r"><link name="l">{shape}</link></robot>')
    return path


def bounds_in_urdf(folder: Path, mesh: Path, **kwargs) -> np.ndarray:
    """Return the corners of what rays and contact see of a mesh in a URDF, (2, 3)."""
    pytest.importorskip("yourdfpy")
    shape = load_urdf(urdf(folder, mesh, **kwargs))
    table = ShapeTable([shape], device=torch.device("cpu"))
    row = table.array.numpy()[0]
    return np.array([row["center"] - row["half"], row["center"] + row["half"]])


@pytest.mark.parametrize(("unit", "per_metre"), [
    ('<unit name="millimeter" meter="0.001"/>', 1000.0),
    ('<unit name="centimeter" meter="0.01"/>', 100.0),
    ('<unit name="inch" meter="0.0254"/>', 1.0 / 0.0254),
    ('<unit meter="1e-2"/>', 100.0),
    ('<unit name="meter"/>', 1.0),
    ("", 1.0),
])  # fmt: skip
def test_the_unit_of_a_collada_file_counts(unit: str, per_metre: float, tmp_path: Path) -> None:
    """Coordinates times ``meter`` are metres; without the element, or the attribute, one is a metre (COLLADA 1.4.1)."""
    path = collada(tmp_path, unit=unit, per_metre=per_metre)
    np.testing.assert_allclose(load_mesh(path, scale=1.0).bounds, [LOW, HIGH], rtol=1e-6)
    np.testing.assert_allclose(load_mesh(path, scale=2.0).bounds, [2 * LOW, 2 * HIGH], rtol=1e-6)
    np.testing.assert_allclose(bounds_in_urdf(tmp_path, path), [LOW, HIGH], atol=THICKER)
    scaled = bounds_in_urdf(tmp_path, path, scale=' scale="3 3 3"')
    np.testing.assert_allclose(scaled, [3 * LOW, 3 * HIGH], atol=3 * THICKER)


@pytest.mark.parametrize("up", ["X_UP", "Y_UP", "Z_UP", ""])
def test_the_up_axis_of_a_collada_file_counts_by_itself_and_not_in_a_urdf(up: str, tmp_path: Path) -> None:
    """By itself it is turned as COLLADA 1.4.1 says (y up if nothing is said); RViz, MoveIt and Gazebo do not turn it."""
    path = collada(tmp_path, up=up)
    np.testing.assert_allclose(load_mesh(path, scale=1.0).bounds, TURNED[up or "Y_UP"], rtol=1e-6)
    np.testing.assert_allclose(bounds_in_urdf(tmp_path, path), [LOW, HIGH], atol=THICKER)


@pytest.mark.parametrize("name", ["box.glb", "box.gltf"])
def test_gltf_is_y_up_everywhere(name: str, tmp_path: Path) -> None:
    """glTF 2.0, section 3.4: metres, y up; RViz 2 turns (x, y, z) to (x, -z, y) in a URDF as well."""
    path = gltf(tmp_path, name)
    np.testing.assert_allclose(load_mesh(path, scale=1.0).bounds, TURNED["Y_UP"], rtol=1e-6)
    np.testing.assert_allclose(bounds_in_urdf(tmp_path, path), TURNED["Y_UP"], atol=THICKER)


@pytest.mark.parametrize("name", ["box.stl", "box.obj", "box.ply"])
def test_formats_without_unit_and_up_axis_are_taken_as_they_are(name: str, tmp_path: Path) -> None:
    trimesh.creation.box(bounds=[LOW, HIGH]).export(tmp_path / name)
    np.testing.assert_allclose(load_mesh(tmp_path / name, scale=1.0).bounds, [LOW, HIGH], rtol=1e-6)


@pytest.mark.parametrize(("up", "expected"), [("x", "X_UP"), ("y", "Y_UP"), ("z", "Z_UP")])
def test_a_shape_may_name_the_up_axis_of_its_file(up: str, expected: str, tmp_path: Path) -> None:
    for path in (collada(tmp_path, up="X_UP"), gltf(tmp_path, "box.glb")):
        np.testing.assert_allclose(load_mesh(path, scale=1.0, up=up).bounds, TURNED[expected], rtol=1e-6)
        shapes = [ShapeCfg(kind="mesh", path=str(path), up=up), ShapeCfg(kind="mesh", path=str(path), up="z")]
        rows = ShapeTable(shapes, device=torch.device("cpu")).array.numpy()
        np.testing.assert_allclose(rows[0]["center"] - rows[0]["half"], TURNED[expected][0], atol=THICKER)
        np.testing.assert_allclose(rows[1]["center"] - rows[1]["half"], LOW, atol=THICKER)


def test_a_wrong_up_axis_is_refused() -> None:
    with pytest.raises(ConfigError):
        ShapeCfg(kind="mesh", path="a.obj", up="Z_UP")
    with pytest.raises(ConfigError):
        ShapeCfg(kind="sphere", radius=1.0, up="z")


@pytest.mark.parametrize("meter", ["0", "-1", "nan", "inf"])
def test_an_impossible_unit_is_refused(meter: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError):
        load_mesh(collada(tmp_path, unit=f'<unit name="u" meter="{meter}"/>'), scale=1.0)


def test_the_hull_of_a_robot_is_that_of_the_turned_mesh(tmp_path: Path) -> None:
    """The box around a mesh in millimetres, and around a glTF file: the centre and the edges of the corners in metres."""
    for path, corners in (
        (collada(tmp_path, unit='<unit name="millimeter" meter="0.001"/>', per_metre=1000.0), TURNED["Z_UP"]),
        (gltf(tmp_path, "box.glb"), TURNED["Y_UP"]),
    ):
        low, high = np.array(corners)
        box = part_collision_shape(
            PartCfg(shape=ShapeCfg(kind="mesh", path=str(path), scale=0.5), position=(1.0, 2.0, 3.0))
        )
        np.testing.assert_allclose(box.center, 0.25 * (low + high) + (1.0, 2.0, 3.0), rtol=1e-6)
        np.testing.assert_allclose(box.size, 0.5 * (high - low), rtol=1e-6)
