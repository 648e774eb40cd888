"""Families of shapes and URDF files: what they make, from what, and what is refused with which words."""

import sys
import time
from dataclasses import replace
from math import pi, sqrt
from pathlib import Path

import pytest
import torch
import trimesh

from aerial_gym.assets import FAMILIES, CollisionTest, Scene, family_shapes, load_urdf
from aerial_gym.assets.mesh_files import load_mesh
from aerial_gym.config.environment import AssetCfg, FamilyCfg, PartCfg, ShapeCfg, load_environment
from aerial_gym.config.robot import SphereCfg
from aerial_gym.errors import ConfigError, MissingDependencyError, UnknownNameError
from aerial_gym.math.quaternion import quat_from_euler, quat_rotate
from tests.refusals import assert_refused
from tests.unit.assets.managers import box_environment, make_manager

POINT = (SphereCfg(center=(0.0, 0.0, 0.0), radius=1e-6),)


def distances(shape: ShapeCfg, points: torch.Tensor, pose: torch.Tensor | None = None) -> torch.Tensor:
    """Return the signed distance [m] of points (N, 3) to one instance of a shape: each has a scene of its own."""
    num = len(points)
    state = torch.zeros(num, 1, 13)
    state[..., 6] = 1.0
    if pose is not None:
        state[:, 0, :7] = pose
    index = torch.zeros(1, dtype=torch.int32)
    scene = Scene([shape], shape_index=index, semantic_id=index + 7, asset_state=state)
    attitude = torch.tensor([0.0, 0.0, 0.0, 1.0]).expand(num, 4).contiguous()
    out = torch.full((num,), float("nan"))
    test = CollisionTest(scene, POINT, position=points, attitude=attitude, distance_out=out)
    test.measure()
    return out


@pytest.mark.parametrize("name", FAMILIES.names())
def test_the_same_seed_gives_the_same_shapes_and_another_seed_others(name: str) -> None:
    cfg = FamilyCfg(name=name, variants=4, seed=3)
    shapes = family_shapes(cfg)
    assert shapes == family_shapes(cfg)
    assert family_shapes(replace(cfg, variants=2)) == shapes[:2]
    assert len({str(shape) for shape in shapes}) == 4
    assert not set(map(str, family_shapes(replace(cfg, seed=4)))) & set(map(str, shapes))


def test_rods_have_the_thickness_and_length_requested() -> None:
    cfg = FamilyCfg(name="thin_rods", variants=200, ranges={"thickness": (0.014, 0.02), "length": (4.89, 4.89)})
    rods = family_shapes(cfg)
    radii = torch.tensor([rod.radius for rod in rods])
    assert {rod.kind for rod in rods} == {"cylinder"}
    assert {rod.height for rod in rods} == {4.89}
    assert ((radii >= 0.007) & (radii <= 0.01)).all()
    assert radii.std().item() == pytest.approx(0.003 / sqrt(12), rel=0.2)  # uniform


def test_trees_are_13_cylinders_whose_branches_begin_on_the_trunk() -> None:
    for tree in family_shapes(FamilyCfg(name="trees", variants=20, seed=1)):
        trunk, *branches = tree.parts or ()
        assert len(branches) == 12
        assert {part.shape.kind for part in tree.parts or ()} == {"cylinder"}
        height = trunk.shape.height or 0.0
        assert trunk.position == (0.0, 0.0, 0.5 * height)
        for branch in branches:
            up = quat_rotate(quat_from_euler(torch.tensor(branch.euler)), torch.tensor([0.0, 0.0, 1.0]))
            foot = torch.tensor(branch.position) - 0.5 * (branch.shape.height or 0.0) * up
            assert foot[:2].abs().max() < 1e-6
            assert 0.3 * height < foot[2] < height + 1e-6
            assert up[2] > 0.0  # it rises


def test_the_inside_of_a_room_is_as_large_as_asked_and_closed() -> None:
    size = {"length": (6.0, 6.0), "width": (4.0, 4.0), "height": (3.0, 3.0)}
    size |= dict.fromkeys(("tables", "shelves"), (0.0, 0.0))
    room = family_shapes(FamilyCfg(name="rooms", variants=1, ranges=size))[0]
    half = torch.tensor([3.0, 2.0, 1.5])
    points = (2.0 * torch.rand(200, 3, generator=torch.Generator().manual_seed(0)) - 1.0) * half
    torch.testing.assert_close(distances(room, points), (half - points.abs()).amin(dim=1), atol=3e-6, rtol=0.0)
    assert [part.semantic_id for part in room.parts or ()] == [9, 10, 11, 12, 13, 14]


def test_a_corridor_is_open_along_x() -> None:
    size = {"length": (10.0, 10.0), "width": (2.0, 2.0), "height": (2.4, 2.4)}
    corridor = family_shapes(FamilyCfg(name="corridors", variants=1, ranges=size))[0]
    along = torch.linspace(-8.0, 8.0, 17)
    points = torch.stack((along, torch.full_like(along, 0.6), torch.zeros_like(along)), dim=1)
    inside = along.abs() < 5.0
    torch.testing.assert_close(distances(corridor, points)[inside], torch.full((9,), 0.4), atol=3e-6, rtol=0.0)
    assert (distances(corridor, points) > 0.39).all()


def test_a_doorway_is_as_wide_and_high_as_asked() -> None:
    ranges = {"door_width": (1.0, 1.0), "door_height": (2.0, 2.0), "width": (4.0, 4.0), "height": (3.0, 3.0)}
    doorway = family_shapes(FamilyCfg(name="doorways", variants=1, ranges=ranges))[0]
    points = torch.tensor([[0.0, 0.0, -1.4], [0.0, 0.4, -1.0], [0.0, 0.0, 0.3], [0.0, 0.6, 0.0], [0.0, 0.0, 1.0]])
    expected = torch.tensor([0.5, 0.1, 0.2, -0.1, -0.1])  # the lintel begins 2 m above the foot at -1.5
    torch.testing.assert_close(distances(doorway, points)[:4], expected[:4], atol=3e-6, rtol=0.0)
    assert distances(doorway, points)[4] < 0.0


def test_furniture_in_rooms_stands_on_the_floor_within_the_walls() -> None:
    for room in family_shapes(FamilyCfg(name="rooms", variants=10)):
        walls, furniture = (room.parts or ())[:6], (room.parts or ())[6:]
        assert furniture
        floor = walls[4].position[2] + 0.5 * (walls[4].shape.size or (0, 0, 0))[2]
        assert walls[4].semantic_id == 13
        for part in furniture:
            assert part.position[2] - 0.5 * (part.shape.size or (0, 0, 0))[2] > floor - 1e-9


@pytest.mark.parametrize("seed", [0, 1])
def test_a_compound_moves_and_turns_rigidly(seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    sizes, places = ((0.4, 0.6, 0.2), (1.0, 0.1, 0.3)), ((0.5, 0.0, 0.1), (-0.7, 0.4, -0.2))
    eulers = ((0.3, -0.5, 1.0), (0.0, 0.0, 0.0))
    placed = zip(sizes, places, eulers, strict=True)
    parts = tuple(PartCfg(shape=ShapeCfg(kind="box", size=a), position=b, euler=c) for a, b, c in placed)
    points = 3.0 * torch.randn(300, 3, generator=generator)
    position = torch.randn(3, generator=generator)
    attitude = quat_from_euler(torch.randn(3, generator=generator))
    expected = torch.full((300,), float("inf"), dtype=torch.float64)
    local = quat_rotate(torch.cat((-attitude[:3], attitude[3:])).double().expand(300, 4), (points - position).double())
    for size, place, euler in zip(sizes, places, eulers, strict=True):
        turn = quat_from_euler(torch.tensor(euler, dtype=torch.float64))
        inverse = torch.cat((-turn[:3], turn[3:])).expand(300, 4)
        excess = quat_rotate(inverse, local - torch.tensor(place, dtype=torch.float64)).abs()
        excess = excess - 0.5 * torch.tensor(size, dtype=torch.float64)
        distance = excess.clamp(min=0.0).norm(dim=1) + excess.amax(dim=1).clamp(max=0.0)
        expected = torch.minimum(expected, distance)
    compound = ShapeCfg(kind="compound", parts=parts)
    result = distances(compound, points, torch.cat((position, attitude)))
    torch.testing.assert_close(result.double(), expected, atol=1e-5, rtol=0.0)  # float32 at 10 m


ASSET = AssetCfg(
    name="forest", family=FamilyCfg(name="trees", variants=5), count=3,
    position_ratio_low=(0.0, 0.0, 0.0), position_ratio_high=(1.0, 1.0, 0.0),
)  # fmt: skip


def make_scene(*assets: AssetCfg) -> Scene:
    return make_manager(box_environment((5.0, 5.0, 5.0), *assets), 4)[0].scene


def test_an_asset_takes_its_shapes_from_a_family() -> None:
    scene = make_scene(ASSET)
    assert len(scene.shape_table) == 5
    assert scene.num_parts == 39
    assert len(scene.shape_index.unique()) > 1


@pytest.mark.parametrize(("name", "ranges", "message"), [
    ("tree", {}, r"no family 'tree'. Did you mean 'trees'\? Known: boxes, corr"),
    ("trees", {"heigth": (1.0, 2.0)}, r"family 'trees': there is no number 'heigth'. Known: height, trunk_radius"),
    ("trees", {"height": (0.0, 0.0)}, r"family 'trees' with .*ShapeCfg.height = 0.0: must be > 0 and finite"),
])  # fmt: skip
def test_families_that_cannot_be_made_are_refused(name: str, ranges: dict, message: str) -> None:
    with pytest.raises((ConfigError, UnknownNameError), match=message):
        make_scene(replace(ASSET, family=FamilyCfg(name=name, variants=1, ranges=ranges)))


def test_impossible_family_configurations_are_refused() -> None:
    forest = FamilyCfg(name="trees", variants=1)
    for cfg, changes, message in (
        (forest, {"variants": 0}, r"FamilyCfg.variants = 0: must be >= 1"),
        (forest, {"seed": -1}, r"seed = -1: must be >= 0"),
        (forest, {"ranges": {"height": (2.0, 1.0)}}, r"height = \(2.0, 1.0\) needs 0 <= low <= high < inf"),
        (
            ASSET,
            {"shapes": (ShapeCfg(kind="sphere", radius=1.0),)},
            r"'forest': give shapes, at least one, or a family, and not both",
        ),
        (ASSET, {"family": None}, r"AssetCfg 'forest': give shapes, at least one, or a family"),
    ):
        assert_refused(ConfigError, message, replace, cfg, **changes)


URDF = """<robot name="lamp">
  <link name="base"><collision><geometry><box size="0.4 0.4 0.1"/></geometry></collision>
    <visual><geometry><sphere radius="9"/></geometry></visual></link>
  <link name="pole"><collision><origin xyz="0 0 0.5" rpy="0 0 0"/>
    <geometry><cylinder radius="0.02" length="1.0"/></geometry></collision></link>
  <link name="bulb"><visual><geometry><sphere radius="0.1"/></geometry></visual></link>
  <link name="shade"><collision><origin xyz="0.1 0 0" rpy="0.2 0.3 0.4"/>
    <geometry><mesh filename="shade.stl" scale="0.5 0.5 0.5"/></geometry></collision></link>
  <joint name="a" type="fixed"><parent link="base"/><child link="pole"/><origin xyz="0 0 0.05"/></joint>
  <joint name="b" type="revolute"><parent link="pole"/><child link="bulb"/><origin xyz="0 0 1" rpy="1.5707963267948966 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="c" type="fixed"><parent link="bulb"/><child link="shade"/><origin xyz="0 0.3 0"/></joint>
</robot>"""


@pytest.fixture
def lamp(tmp_path: Path) -> Path:
    trimesh.creation.box((1.0, 1.0, 1.0)).export(tmp_path / "shade.stl")
    (tmp_path / "lamp.urdf").write_text(URDF)
    return tmp_path / "lamp.urdf"


def test_every_link_of_a_urdf_becomes_a_part_at_zero_joint_angles(lamp: Path) -> None:
    """Collision shapes, and visual ones where a link has no others; joint b turns what follows by 90 deg about x."""
    pytest.importorskip("yourdfpy")
    base, pole, bulb, shade = load_urdf(lamp).parts or ()
    assert (base.shape.kind, base.shape.size, base.position) == ("box", (0.4, 0.4, 0.1), (0.0, 0.0, 0.0))
    assert (pole.shape.kind, pole.shape.radius, pole.shape.height) == ("cylinder", 0.02, 1.0)
    assert pole.position == pytest.approx((0.0, 0.0, 0.55))
    assert (bulb.shape.kind, bulb.shape.radius) == ("sphere", 0.1)
    assert bulb.position == pytest.approx((0.0, 0.0, 1.05))
    assert bulb.euler == pytest.approx((0.5 * pi, 0.0, 0.0))
    assert (shade.shape.kind, shade.shape.path, shade.shape.scale) == ("mesh", str(lamp.parent / "shade.stl"), 0.5)
    assert shade.position == pytest.approx((0.1, 0.0, 1.35))  # y of the bulb is z of the world
    about_x = quat_from_euler(torch.tensor([0.5 * pi, 0.0, 0.0], dtype=torch.float64))
    inner = quat_from_euler(torch.tensor([0.2, 0.3, 0.4], dtype=torch.float64))
    for axis in torch.eye(3, dtype=torch.float64):
        result = quat_rotate(quat_from_euler(torch.tensor(shade.euler, dtype=torch.float64)), axis)
        torch.testing.assert_close(result, quat_rotate(about_x, quat_rotate(inner, axis)))


def test_links_of_a_urdf_show_the_ids_requested(lamp: Path) -> None:
    pytest.importorskip("yourdfpy")
    assert [part.semantic_id for part in load_urdf(lamp).parts or ()] == [None] * 4
    parts = load_urdf(lamp, link_ids={"pole": 50}, first_link_id=20).parts or ()
    assert [part.semantic_id for part in parts] == [20, 50, 21, 22]


def test_an_environment_file_can_hold_a_urdf(lamp: Path) -> None:
    pytest.importorskip("yourdfpy")
    (lamp.parent / "env.yaml").write_text(
        "summary: a lamp\nphysics_steps_per_env_step: 1\nsource: test\n"
        "bounds_lower_low: [-5, -5, -5]\nbounds_lower_high: [-5, -5, -5]\n"
        "bounds_upper_low: [5, 5, 5]\nbounds_upper_high: [5, 5, 5]\n"
        "assets:\n- {name: lamp, count: 2, shapes: [{kind: urdf, path: lamp.urdf, link_ids: {base: 8}}],\n"
        "   semantic_id: 30, position_ratio_low: [0, 0, 0], position_ratio_high: [1, 1, 1]}\n"
    )
    scene = make_manager(load_environment(lamp.parent / "env.yaml"), 1)[0].scene
    assert scene.num_parts == 8
    assert scene.arrays.semantic_id.numpy().tolist() == [[8, 30, 30, 30] * 2]


@pytest.mark.parametrize(("old", "new", "message"), [
    ("</robot>", "", r"lamp.urdf: not valid XML"),
    ('robot name="lamp"', 'model name="lamp"', r"lamp.urdf: (not valid XML|must hold a <robot>)"),
    ("shade.stl", "none.stl", r"lamp.urdf: link 'shade': mesh none.stl: no such file"),
    ('scale="0.5 0.5 0.5"', 'scale="0.5 0.5 1"', r"link 'shade': mesh shade.stl: scale .* differs by axis"),
    ('scale="0.5 0.5 0.5"', 'scale="1 1 1 1"', r"'shade': mesh shade.stl: scale .* must be one number, or three"),
    ('filename="shade.stl"', "", r"lamp.urdf: (link 'shade': a mesh has no filename|cannot be read)"),
    ("shade.stl", "package://lamp/../../../etc/passwd", r"(leads out of the folder|no such file)"),
    ("shade.stl", "package://etc/passwd", r"mesh package://etc/passwd: no such file"),
    ('radius="0.02"', 'radius="-1"', r"lamp.urdf: link 'pole': ShapeCfg.radius = -1.0: must be > 0"),
    ('xyz="0.1 0 0"', 'xyz="nan 0 0"', r"lamp.urdf: link 'shade': an origin is not finite"),
    ('xyz="0.1 0 0"', 'xyz="a 0 0"', r"lamp.urdf: cannot be read"),
    ('link name="shade"', 'link name="bulb"', r"lamp.urdf: link 'bulb': every link needs a name of its own"),
    ('child link="shade"', 'child link="shad"', r"lamp.urdf: joint 'c': there is no link 'shad'. Known: base"),
    ('child link="shade"', 'child link="bulb"', r"lamp.urdf: link 'bulb' has two parents: 'pole' and 'bulb'"),
    ('parent link="base"', 'parent link="bulb"', r"lamp.urdf: link 'pole' is its own ancestor"),
    ('type="revolute"', 'type="loose"', r"lamp.urdf: joint 'b': type 'loose' must be one of fixed, revolute"),
    (URDF[URDF.index('  <joint name="c"') : URDF.index("</robot>")], "", r"2 links have no parent \(base, shade\)"),
])  # fmt: skip
def test_bad_urdf_files_are_refused_by_name(lamp: Path, old: str, new: str, message: str) -> None:
    pytest.importorskip("yourdfpy")
    lamp.write_text(URDF.replace(old, new), encoding="utf-8")
    assert_refused(ConfigError, message, load_urdf, lamp)


def test_missing_files_and_links_are_refused_by_name(lamp: Path) -> None:
    pytest.importorskip("yourdfpy")
    with pytest.raises(ConfigError, match=r"URDF .*none.urdf: no such file"):
        load_urdf(lamp.parent / "none.urdf")
    with pytest.raises(ConfigError, match=r"there is no link 'head'. Known: base, pole, bulb, shade"):
        load_urdf(lamp, link_ids={"head": 1})
    lamp.write_text('<robot name="empty"><link name="base"/></robot>', encoding="utf-8")
    assert_refused(ConfigError, r"URDF .*lamp.urdf: holds no geometry", load_urdf, lamp)
    assert_refused(ConfigError, r"only a urdf has", ShapeCfg, kind="sphere", radius=1.0, link_ids={"a": 1})


def test_a_urdf_without_yourdfpy_names_the_extra(lamp: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "yourdfpy", None)
    assert_refused(MissingDependencyError, r"lamp.urdf needs yourdfpy: .*'aerial-gym\[urdf\]'", load_urdf, lamp)


def test_a_mesh_of_a_package_stays_in_the_asset_folder(lamp: Path) -> None:
    """Beside the URDF and in its package it is found; through ``..`` or a link that leads out it is refused."""
    pytest.importorskip("yourdfpy")
    text, mesh = lamp.read_text(encoding="utf-8"), lamp.parent / "shade.stl"
    package = lamp.parent / "lamps" / "urdf"
    (package.parent / "meshes").mkdir(parents=True)
    package.mkdir()
    (package.parent / "meshes" / "shade.stl").write_bytes(mesh.read_bytes())
    for name in ("package://lamps/meshes/shade.stl", "package://other/meshes/shade.stl"):
        (package / "lamp.urdf").write_text(text.replace("shade.stl", name))
        assert load_urdf(package / "lamp.urdf").parts
    (package.parent / "link.stl").symlink_to(mesh)
    for name in ("package://lamps/../../shade.stl", "package://lamps/link.stl"):
        (package / "lamp.urdf").write_text(text.replace("shade.stl", name))
        if name.endswith("link.stl"):
            mesh.rename(lamp.parent.parent / "away.stl")
            (package.parent / "link.stl").unlink()
            (package.parent / "link.stl").symlink_to(lamp.parent.parent / "away.stl")
        with pytest.raises(ConfigError, match="leads out of the folder|no such file"):
            load_urdf(package / "lamp.urdf")


def test_a_long_chain_of_links_takes_a_time_in_proportion(tmp_path: Path) -> None:
    """3,000 links took 40 s: the time grew with the square of their number. Each stands 0.001 m beyond the one before."""
    pytest.importorskip("yourdfpy")
    count, shape = 3000, "<visual><geometry><sphere radius='1'/></geometry></visual>"
    links = "".join(f"<link name='l{i}'>{shape}</link>" for i in range(count))
    ends = ((i, f"<parent link='l{i}'/><child link='l{i + 1}'/>") for i in range(count - 1))
    joints = "".join(f"<joint name='j{i}' type='fixed'><origin xyz='0.001 0 0'/>{own}</joint>" for i, own in ends)
    (tmp_path / "chain.urdf").write_text(f"<robot name='chain'>{links}{joints}</robot>")
    started = time.perf_counter()
    parts = load_urdf(tmp_path / "chain.urdf").parts
    assert time.perf_counter() - started < 15.0
    assert len(parts) == count
    assert parts[-1].position == pytest.approx((0.001 * (count - 1), 0.0, 0.0))


@pytest.mark.parametrize("text", ["v 1\nv 2\nv 3\nf 1 2 3\n", "v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", "v a b c\nf 1 2 3\n"])
def test_meshes_of_too_few_numbers_are_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "bad.obj").write_text(text)
    with pytest.raises(ConfigError, match="bad.obj: "):
        load_mesh(tmp_path / "bad.obj", scale=1.0)
