"""Colour images: what surfaces are painted with, and the light of lamps, against closed forms and scipy's
interpolation. Light with ``ambient`` 1 shows the paint itself. Points of pixels are good to 1e-5 m, so weights of
corners are too."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from aerial_gym.assets import Scene
from aerial_gym.assets.appearance import DEFAULT_COLORS
from aerial_gym.config.environment import CheckerCfg, LampCfg, PartCfg, ShapeCfg
from aerial_gym.config.sensor import CameraCfg, LightCfg
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import quat_conjugate, quat_from_euler, quat_rotate
from tests.physics.sensor_rig import place_shapes, shoot
from tests.refusals import assert_refused

PAINT = LightCfg(sun=None, ambient=1.0, shadows=False, sky=(0.0, 0.0, 0.0))
DARK = LightCfg(sun=None, ambient=0.0, sky=(0.0, 0.0, 0.0))
CAMERA = CameraCfg(
    summary="test camera", width=48, height=36, hfov_deg=80.0, min_range=0.0, max_range=30.0, points="world",
    light=PAINT, source="chosen for the test",
)  # fmt: skip
DOWN = [0.0, np.pi / 2, 0.0]

pytestmark = pytest.mark.usefixtures("few_rays")


def look(cfg: CameraCfg, scene: Scene, position: list[float], euler: list[float]) -> tuple[Tensor, Tensor, Tensor]:
    pose = {"position": torch.tensor([position]), "attitude": quat_from_euler(torch.tensor([euler]))}
    images = shoot(cfg, scene, **pose).images
    return images.color[0, 0].cpu(), images.points[0, 0].cpu().double(), images.segmentation[0, 0].cpu()


def own_points(points: Tensor, position: list[float], euler: list[float]) -> Tensor:
    turn = quat_conjugate(quat_from_euler(torch.tensor(euler, dtype=torch.float64)))
    offset = points - torch.tensor(position, dtype=torch.float64)
    return quat_rotate(turn.expand(*offset.shape[:-1], 4), offset)


Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Turns rows (x, y, z) to (x, z, -y), as glTF has them."""


@pytest.mark.parametrize("kind", ["ply", "obj", "glb"])
def test_vertex_colors_are_weighed_by_the_areas_of_the_opposite_triangles(kind: str, device, tmp_path: Path) -> None:
    """At every pixel of a turned, scaled triangle: barycentric weights are areas over the whole area, in float64."""
    corners = np.array([[0.0, 0.0, 0.0], [2.0, 0.3, 0.0], [0.4, 1.5, 0.2]])
    colors = np.array([[255, 0, 51, 255], [0, 204, 0, 255], [102, 0, 255, 255]], dtype=np.uint8)
    path = tmp_path / f"triangle.{kind}"
    stored = corners @ Y_UP if kind == "glb" else corners
    trimesh.Trimesh(stored, [[0, 1, 2]], vertex_colors=colors, process=False).export(path)
    place, turn, scale = [3.0, -0.8, 0.6], [0.3, 1.1, 0.2], 1.5
    shape = ShapeCfg(kind="mesh", path=str(path), scale=scale)
    color, points, ids = look(CAMERA, place_shapes([shape], [(place, turn)], device), [0.0] * 3, [0.0] * 3)
    p, (a, b, c) = own_points(points, place, turn).numpy()[(ids == 0).numpy()], scale * corners
    assert len(p) > 100
    area = np.linalg.norm(np.cross(b - a, c - a))
    sides = ((b, c), (c, a), (a, b))
    weights = np.stack([np.linalg.norm(np.cross(i - p, j - p), axis=1) / area for i, j in sides], axis=1)
    np.testing.assert_allclose(color[ids == 0].numpy(), weights @ (colors[:, :3] / 255.0), atol=1e-4)


def test_colors_of_faces_and_of_an_inverted_mesh_stay_at_their_places(device, tmp_path: Path) -> None:
    """A cube is painted by place, rgb = 1/2 + p/2; stored inside out it is mended, which turns its triangles around."""
    for name, invert in (("right", False), ("inside_out", True)):
        cube = trimesh.creation.box((2.0, 2.0, 2.0)).subdivide()
        if invert:
            cube.invert()
        cube.visual = trimesh.visual.ColorVisuals(
            cube, vertex_colors=np.round(127.5 + 127.5 * cube.vertices).astype(np.uint8)
        )
        cube.export(tmp_path / f"{name}.ply")
        place, turn = [4.0, 0.2, 0.1], [0.4, 0.5, 0.6]
        shape = ShapeCfg(kind="mesh", path=str(tmp_path / f"{name}.ply"))
        color, points, ids = look(CAMERA, place_shapes([shape], [(place, turn)], device), [0.0] * 3, [0.0] * 3)
        expected = 0.5 + 0.5 * own_points(points, place, turn)[ids == 0]
        assert len(expected) > 200
        np.testing.assert_allclose(color[ids == 0].numpy(), expected.numpy(), atol=0.5 / 255 + 1e-4)  # stored as bytes


def test_each_face_may_have_a_color_of_its_own(device, tmp_path: Path) -> None:
    square = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]], process=False)
    square.visual.face_colors = np.array([[0, 0, 255, 255], [255, 0, 0, 255]], dtype=np.uint8)
    square.export(tmp_path / "square.ply")
    shape = ShapeCfg(kind="mesh", path=str(tmp_path / "square.ply"))
    color, points, ids = look(CAMERA, place_shapes([shape], [([0.0] * 3, [0.0] * 3)], device), [0.5, 0.5, 1.0], DOWN)
    below = points[..., 1] < points[..., 0]
    sure = (ids == 0) & ((points[..., 1] - points[..., 0]).abs() > 1e-3)
    expected = torch.where(below.unsqueeze(-1), torch.tensor([0.0, 0.0, 1.0]), torch.tensor([1.0, 0.0, 0.0]))
    assert (sure & below).sum() > 50
    torch.testing.assert_close(color[sure], expected[sure], rtol=0.0, atol=1e-6)


def write_square(
    folder: Path, kind: str, image: NDArray[np.uint8], *, factor: tuple[float, float, float], tiles: float
):
    """Write a square of 2 m about the origin whose image is repeated ``tiles`` times across it; return its path."""
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    uv = tiles * 0.5 * (corners[:, :2] + 1.0)
    if kind == "obj":
        Image.fromarray(image).save(folder / "image.png")
        rows = ["mtllib square.mtl", *(f"v {x} {y} {z}" for x, y, z in corners), *(f"vt {u} {v}" for u, v in uv)]
        (folder / "square.obj").write_text("\n".join([*rows, "usemtl tiles", "f 1/1 2/2 3/3", "f 1/1 3/3 4/4\n"]))
        lines = ["newmtl tiles", f"Kd {factor[0]} {factor[1]} {factor[2]}", "map_Kd image.png\n"]
        (folder / "square.mtl").write_text("\n".join(lines))
    else:
        material = trimesh.visual.material.PBRMaterial(
            baseColorTexture=Image.fromarray(image), baseColorFactor=[*factor, 1.0]
        )
        visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
        square = trimesh.Trimesh(corners @ Y_UP, [[0, 1, 2], [0, 2, 3]], visual=visual, process=False)
        square.export(folder / "square.glb")
    return str(folder / f"square.{kind}")


def test_materials_of_one_file_and_a_shared_file_are_kept_apart_and_stored_once(device, tmp_path: Path) -> None:
    """A square of a red triangle and a textured one, used by two shapes; a given colour replaces both of them."""
    Image.fromarray(np.full((3, 3, 3), (0, 128, 255), dtype=np.uint8)).save(tmp_path / "blue.png")
    (tmp_path / "two.mtl").write_text("newmtl red\nKd 0.9 0.1 0.2\nnewmtl blue\nmap_Kd blue.png\n")
    corners = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
    faces = "usemtl red\nf 1/1 2/2 3/3\nusemtl blue\nf 1/1 3/3 4/4\n"
    (tmp_path / "two.obj").write_text(f"mtllib two.mtl\n{corners}{faces}")
    shape = ShapeCfg(kind="mesh", path=str(tmp_path / "two.obj"))
    plain = replace(shape, color=(0.3, 0.2, 0.1))
    poses = [([float(x), 0.0, 0.0], [0.0] * 3) for x in (-1, 0, 1)]
    scene = place_shapes([shape, replace(shape), plain], poses, device)
    assert scene.shape_table.looks.corner_color.shape == (6,)
    color, points, ids = look(CAMERA, scene, [0.5, 0.5, 2.0], DOWN)
    x = points[..., 0] - (ids - 1)
    red = torch.tensor([0.9, 0.1, 0.2]).expand_as(color)
    blue = torch.tensor([0.0, 128 / 255, 1.0]).expand_as(color)
    painted = torch.where((points[..., 1] < x).unsqueeze(-1), red, blue)
    expected = torch.where((ids == 2).unsqueeze(-1), torch.tensor([0.3, 0.2, 0.1]), painted)
    sure = (ids >= 0) & ((points[..., 1] - x).abs() > 1e-3)
    assert set(ids[sure].tolist()) == {0, 1, 2}
    torch.testing.assert_close(color[sure], expected[sure], rtol=0.0, atol=1e-5)


def test_colors_come_from_the_shape_its_compound_or_its_kind(device) -> None:
    box = ShapeCfg(kind="box", size=(0.4, 0.4, 0.4))
    own, without = replace(box, color=(0.1, 0.9, 0.3)), ShapeCfg(kind="sphere", radius=0.2)
    parts = (PartCfg(shape=own), PartCfg(shape=without, position=(0.0, 0.6, 0.0)))
    painted = ShapeCfg(kind="compound", parts=parts, color=(0.8, 0.2, 0.6))
    poses = [([3.0, y, 0.0], [0.0] * 3) for y in (-1.4, 0.0, 1.0)]
    scene = place_shapes([box, ShapeCfg(kind="compound", parts=parts), painted], poses, device)
    color, points, ids = look(CAMERA, scene, [0.0] * 3, [0.0] * 3)

    def nearest_color(y: float) -> list[float]:
        nearest = ((points[..., 1] - y).abs() + points[..., 2].abs() + 10.0 * (ids < 0)).flatten().argmin()
        return color.reshape(-1, 3)[nearest].tolist()

    kinds = DEFAULT_COLORS
    expected = {-1.4: kinds["box"], 0.0: own.color, 0.6: kinds["sphere"], 1.0: own.color, 1.6: painted.color}
    for y, value in expected.items():
        assert nearest_color(y) == pytest.approx(value, abs=1e-6), y
    assert len(set(kinds.values())) == len(kinds)


def test_links_of_a_urdf_have_the_colors_of_their_materials(device, tmp_path: Path) -> None:
    pytest.importorskip("yourdfpy")
    geometry = '<geometry><box size="0.4 0.4 0.4"/></geometry>'
    links = {
        "a": f'<visual>{geometry}<material name="x"><color rgba="0.9 0.1 0.2 1"/></material></visual>',
        "b": f'<visual>{geometry}<material name="leaf"/></visual>',
        "c": "",
    }
    text = '<robot name="three"><material name="leaf"><color rgba="0.2 0.7 0.1 1"/></material>'
    text += "".join(f'<link name="{n}">{visual}<collision>{geometry}</collision></link>' for n, visual in links.items())
    for child, y in (("b", 1.0), ("c", 2.0)):
        joint = f'<joint name="to_{child}" type="fixed"><parent link="a"/><child link="{child}"/>'
        text += f'{joint}<origin xyz="0 {y} 0"/></joint>'
    (tmp_path / "three.urdf").write_text(text + "</robot>")
    shape = ShapeCfg(kind="urdf", path=str(tmp_path / "three.urdf"), color=(0.3, 0.3, 0.9), first_link_id=1)
    color, _, ids = look(CAMERA, place_shapes([shape], [([3.0, -1.0, 0.0], [0.0] * 3)], device), [0.0] * 3, [0.0] * 3)
    for link, value in ((1, (0.9, 0.1, 0.2)), (2, (0.2, 0.7, 0.1)), (3, (0.3, 0.3, 0.9))):
        seen = color[ids == link]
        assert len(seen) > 10
        torch.testing.assert_close(seen, torch.tensor(value).expand_as(seen), rtol=0.0, atol=1e-6)
    (tmp_path / "three.urdf").write_text(text.replace("0.9 0.1 0.2 1", "9 0.1 0.2 1") + "</robot>")
    with pytest.raises(ConfigError, match=r"link 'a': material 'x': rgba \[9.0"):
        place_shapes([shape], [([3.0, -1.0, 0.0], [0.0] * 3)], device)


@pytest.mark.parametrize("kind", ["plane", "box", "cylinder", "sphere", "capsule", "mesh"])
def test_fields_of_a_checkerboard_lie_where_its_cubes_are(kind: str, device, tmp_path: Path) -> None:
    """The cube that a point just inside the surface lies in has the second colour if the sum of its indices is odd; the
    corner is at the origin of the shape. Faces lie exactly between two layers of cubes, where rounding would choose."""
    size, first, second = 0.25, (0.9, 0.8, 0.7), (0.1, 0.2, 0.3)
    trimesh.creation.box((1.0, 1.5, 1.0)).export(tmp_path / "box.stl")
    numbers = {
        "plane": {}, "box": {"size": (1.0, 1.5, 1.0)}, "cylinder": {"radius": 0.6, "height": 1.0},
        "sphere": {"radius": 0.8}, "capsule": {"radius": 0.5, "height": 1.0},
        "mesh": {"path": str(tmp_path / "box.stl")},
    }  # fmt: skip
    shape = ShapeCfg(kind=kind, color=first, checker=CheckerCfg(size=size, color=second), **numbers[kind])
    place, turn = [0.1, 0.2, 0.0], [0.3, 0.2, 0.5]
    cfg = replace(CAMERA, normals="world")
    scene = place_shapes([shape], [(place, turn)], device)
    pose = {"position": torch.tensor([[-0.5, 0.4, 2.0]]), "attitude": quat_from_euler(torch.tensor([[0.0, 1.2, -0.2]]))}
    result = shoot(cfg, scene, **pose).images
    hit = (result.segmentation[0, 0] == 0).cpu()
    inside = result.points[0, 0].cpu().double() - 0.01 * size * result.normals[0, 0].cpu().double()
    cell = own_points(inside, place, turn) / size
    sure = hit & ((cell - cell.round()).abs().amin(dim=-1) > 2e-3)
    assert sure.sum() > 150
    odd = (cell.floor().sum(dim=-1) % 2 == 1).unsqueeze(-1)
    expected = torch.where(odd, torch.tensor(second), torch.tensor(first))
    torch.testing.assert_close(result.color[0, 0].cpu()[sure], expected[sure], rtol=0.0, atol=1e-6)


GROUND = ShapeCfg(kind="plane", color=(0.8, 0.5, 0.3))
HIGH = [0.4, -0.3, 3.0]


def lamp_brightness(points: Tensor, lamp: LampCfg) -> Tensor:
    """Return I c cos / r² on a horizontal plane, (..., 3): the cosine is the height of the lamp over its distance."""
    to = torch.tensor(lamp.position, dtype=torch.float64) - points
    r = to.norm(dim=-1, keepdim=True)
    return lamp.intensity * torch.tensor(lamp.color, dtype=torch.float64) * to[..., 2:] / r**3


def test_a_lamp_lights_a_plane_with_the_cosine_over_the_square_of_its_distance(device) -> None:
    a = LampCfg(position=(0.7, -0.4, 1.3), intensity=0.9, color=(1.0, 0.6, 0.2))
    b = LampCfg(position=(-1.1, 0.8, 0.8), intensity=0.4, color=(0.3, 0.5, 1.0))
    strong = replace(a, intensity=20.0)
    below = LampCfg(position=(0.0, 0.0, -1.0), intensity=5.0)
    albedo, turn = torch.tensor(GROUND.color), [0.2, 1.3, 0.4]
    for lamps, ambient in (((a,), 0.0), ((b,), 0.0), ((a, b), 0.0), ((a, b), 0.25), ((strong,), 0.0), ((below,), 0.1)):
        scene = place_shapes([GROUND], [([0.0] * 3, [0.0] * 3)], device, lamps=lamps)
        cfg = replace(CAMERA, light=replace(DARK, ambient=ambient))
        color, points, ids = look(cfg, scene, HIGH, turn)
        assert (ids == 0).all()
        light = ambient + sum(lamp_brightness(points, lamp).clamp(min=0.0) for lamp in lamps)
        expected = (light * albedo).clamp(max=1.0)
        assert (expected == 1.0).any() == (strong in lamps)
        torch.testing.assert_close(color.double(), expected, rtol=0.0, atol=1e-5)


def test_a_sphere_under_a_lamp_throws_the_shadow_of_its_cone(device) -> None:
    """The lamp at height H stands over the sphere at distance d: the cone that touches it has the tangent R / sqrt(d² - R²),
    so the umbra is a disc of radius H R / sqrt(d² - R²). A sphere above the lamp throws none, and without shadows none does."""
    height, d, radius, x, y = 2.0, 0.8, 0.25, 0.5, -0.2
    lamp = LampCfg(position=(x, y, height), intensity=1.5)
    ball = ShapeCfg(kind="sphere", radius=radius)
    poses = [([0.0] * 3, [0.0] * 3), ([x, y, height - d], [0.0] * 3), ([x + 0.3, y, height + 0.5], [0.0] * 3)]
    scene = place_shapes([GROUND, ball, ball], poses, device, lamps=(lamp,))
    lit, points, ids = look(replace(CAMERA, light=DARK), scene, [-2.2, 0.0, 1.8], [0.0, 0.6, 0.0])
    out = (points[..., :2] - torch.tensor([x, y])).norm(dim=-1) - height * radius / (d * d - radius * radius) ** 0.5
    sure = (ids == 0) & (out.abs() > 0.01)  # the ray to the lamp starts 1e-3 of the distance above the ground
    assert (sure & (out < 0.0)).sum() > 30
    expected = lamp_brightness(points, lamp) * torch.tensor(GROUND.color)
    shaded = torch.where((out < 0.0).unsqueeze(-1), 0.0, expected)
    torch.testing.assert_close(lit[sure].double(), shaded[sure], rtol=0.0, atol=1e-5)
    without = replace(CAMERA, light=replace(DARK, shadows=False))
    plain, _, _ = look(without, scene, [-2.2, 0.0, 1.8], [0.0, 0.6, 0.0])
    torch.testing.assert_close(plain[ids == 0].double(), expected[ids == 0], rtol=0.0, atol=1e-5)


def test_what_stands_beyond_a_lamp_throws_no_shadow(device) -> None:
    """A lamp just before a wall lights the ground as if there were no wall; behind the wall it lights nothing."""
    wall = ShapeCfg(kind="box", size=(0.1, 40.0, 40.0))
    for x, blocked in ((0.9, False), (1.1, True)):
        lamp = LampCfg(position=(x, 0.0, 1.0), intensity=1.0)
        scene = place_shapes(
            [GROUND, wall], [([0.0] * 3, [0.0] * 3), ([1.0, 0.0, 0.0], [0.0] * 3)], device, lamps=(lamp,)
        )
        color, points, ids = look(replace(CAMERA, light=DARK), scene, [-1.0, 0.0, 1.0], [0.0, 0.5, 0.0])
        ground = (ids == 0) & (points[..., 0] < 0.9)
        expected = (0.0 if blocked else 1.0) * lamp_brightness(points, lamp) * torch.tensor(GROUND.color)
        torch.testing.assert_close(color[ground].double(), expected[ground], rtol=0.0, atol=1e-5)


def test_the_sun_of_the_sensor_and_the_lamps_of_the_environment_add(device) -> None:
    lamp = LampCfg(position=(0.2, 0.1, 1.5), intensity=0.5)
    sun = LightCfg(sun=(0.0, 3.0, 4.0), ambient=0.2)
    scene = place_shapes([GROUND], [([0.0] * 3, [0.0] * 3)], device, lamps=(lamp,))
    color, points, _ = look(replace(CAMERA, light=sun), scene, HIGH, DOWN)
    expected = (0.2 + 0.8 * 0.8 + lamp_brightness(points, lamp)) * torch.tensor(GROUND.color)
    torch.testing.assert_close(color.double(), expected.clamp(max=1.0), rtol=0.0, atol=1e-5)


def test_impossible_paints_and_lamps_are_refused() -> None:
    assert_refused(ConfigError, r"CheckerCfg.size = 0.0: must be > 0", CheckerCfg, size=0.0)
    assert_refused(ConfigError, r"CheckerCfg.color = \(0.0, 2.0, 0.0\)", CheckerCfg, size=1.0, color=(0.0, 2.0, 0.0))
    with pytest.raises(ConfigError, match=r"LampCfg.intensity = nan: must be > 0"):
        LampCfg(position=(0.0, 0.0, 0.0), intensity=float("nan"))
    with pytest.raises(ConfigError, match=r"LampCfg.position = .*: must be finite"):
        LampCfg(position=(0.0, float("inf"), 0.0), intensity=1.0)
    with pytest.raises(ConfigError, match=r"LampCfg.color = \(1.0, 1.0, -0.1\)"):
        LampCfg(position=(0.0, 0.0, 0.0), intensity=1.0, color=(1.0, 1.0, -0.1))
    part = PartCfg(shape=ShapeCfg(kind="sphere", radius=1.0))
    with pytest.raises(ConfigError, match=r"ShapeCfg.checker = .*: a compound has none; give it to its parts"):
        ShapeCfg(kind="compound", parts=(part,), checker=CheckerCfg(size=1.0))
