"""Environment, shape and camera configurations: shipped values, and what is refused with which words."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from math import inf, nan, pi, radians
from typing import Any

import pytest
import trimesh

from aerial_gym.assets import ENVIRONMENTS, load_mesh
from aerial_gym.config import build, to_mapping
from aerial_gym.config.environment import AssetCfg, EnvironmentCfg, FamilyCfg, ShapeCfg, load_environment
from aerial_gym.errors import ConfigError
from aerial_gym.sensors import IMUS

PLACE = {"position_ratio_low": (0.0, 0.0, 0.0), "position_ratio_high": (1.0, 1.0, 1.0)}
ASSET = AssetCfg(name="ball", shapes=(ShapeCfg(kind="sphere", radius=0.5),), count=1, **PLACE)
WALL_IDS = {"front_wall": 9, "back_wall": 10, "left_wall": 11, "right_wall": 12, "bottom_wall": 13, "top_wall": 14}


def test_shipped_environments_hold_the_values_of_aerial_gym() -> None:
    """Bounds, counts, sizes and ids of parity.md 2.2."""
    empty = ENVIRONMENTS.get("empty_env")
    assert (empty.physics_steps_per_env_step, ENVIRONMENTS.get("empty_env_2ms").physics_steps_per_env_step) == (1, 5)
    assert empty.bounds_lower_low == empty.bounds_lower_high == (-1.0, -1.0, -1.0)
    assert empty.bounds_upper_low == empty.bounds_upper_high == (1.0, 1.0, 1.0)
    assert empty.num_assets == 0
    env = ENVIRONMENTS.get("env_with_obstacles")
    assert env.physics_steps_per_env_step == 10
    assert (env.bounds_lower_low, env.bounds_lower_high) == ((-2.0, -4.0, -3.0), (-1.0, -2.5, -2.0))
    assert (env.bounds_upper_low, env.bounds_upper_high) == ((9.0, 2.5, 2.0), (10.0, 4.0, 3.0))
    assert (env.num_assets, env.num_kept) == (44, 9)
    panels, objects, *walls = env.assets
    assert (panels.count, panels.keep, panels.shapes[0].size) == (3, True, (0.1, 1.2, 3.0))
    assert panels.euler_high == pytest.approx((0.0, 0.0, radians(60.0)))
    assert (objects.count, objects.keep, len(objects.shapes)) == (35, False, 4)
    assert objects.euler_low == pytest.approx((-pi, -pi, -pi))
    assert {wall.name: wall.semantic_id for wall in walls} == WALL_IDS


def test_larger_shipped_environments_hold_the_values_of_aerial_gym() -> None:
    """Bounds, counts, places and ids of parity.md 2.2."""
    lidar = ENVIRONMENTS.get("env_with_lidar_nav_obstacles")
    assert (lidar.physics_steps_per_env_step, lidar.num_assets, lidar.num_kept) == (10, 91, 6)  # ours: walls are kept
    assert (lidar.bounds_lower_low, lidar.bounds_lower_high) == ((-7.5, -7.5, -5.0), (-5.0, -5.0, -3.0))
    assert (lidar.bounds_upper_low, lidar.bounds_upper_high) == ((5.0, 5.0, 3.0), (7.5, 7.5, 5.0))
    panels, objects, *walls = lidar.assets
    assert (panels.count, objects.count) == (15, 70)
    assert (panels.position_ratio_low, panels.position_ratio_high) == ((0.35, 0.0, 0.0), (1.0, 1.0, 1.0))
    assert (objects.position_ratio_low, objects.position_ratio_high) == ((0.3, 0.0, 0.0), (1.0, 1.0, 1.0))
    assert {wall.name: wall.semantic_id for wall in walls} == WALL_IDS
    forest = ENVIRONMENTS.get("forest_env")
    assert (forest.physics_steps_per_env_step, forest.num_assets) == (10, 37)
    assert forest.bounds_lower_low == forest.bounds_lower_high == (-5.0, -5.0, -1.0)
    assert forest.bounds_upper_low == forest.bounds_upper_high == (5.0, 5.0, 3.0)
    trees, objects, floor = forest.assets
    assert trees.family == FamilyCfg(name="trees", variants=100, seed=1)
    assert (trees.count, trees.position_ratio_low, trees.position_ratio_high) == (1, (0.1, 0.1, 0.0), (0.9, 0.9, 0.0))
    assert trees.euler_high == pytest.approx((0.0, radians(30.0), pi))
    assert (objects.count, floor.semantic_id) == (35, 13)
    dynamic = ENVIRONMENTS.get("dynamic_env")
    assert (dynamic.physics_steps_per_env_step, dynamic.num_assets, dynamic.ground_height) == (10, 40, 0.0)
    assert (dynamic.bounds_lower_low, dynamic.bounds_lower_high) == ((-2.0, -4.0, 0.0), (-1.0, -2.5, 0.0))
    assert (dynamic.bounds_upper_low, dynamic.bounds_upper_high) == ((9.0, 2.5, 4.0), (10.0, 4.0, 5.0))
    assert (dynamic.assets[0].motion.kind, dynamic.moves, forest.moves) == ("twist", True, False)


def test_worlds_without_walls_are_possible() -> None:
    env = ENVIRONMENTS.get("env_with_obstacles")
    open_air = replace(env, assets=tuple(asset for asset in env.assets if not asset.name.endswith("_wall")))
    assert (open_air.num_assets, open_air.num_kept, open_air.ground_height) == (38, 3, None)


def test_an_unknown_key_of_a_nested_part_is_named_with_its_place() -> None:
    data = to_mapping(ENVIRONMENTS.get("empty_env"))
    asset = {**to_mapping(ASSET), "shapes": [{"kind": "sphere", "radios": 1.0}]}
    with pytest.raises(ConfigError, match=r"assets\[0\]: shapes\[0\]: unknown field 'radios'. Did you mean 'radius'"):
        build(EnvironmentCfg, {**data, "assets": [asset]}, where="my.yaml")


NO_SHAPES: list[tuple[dict[str, Any], str]] = [
    ({"kind": "cone", "radius": 1.0}, r"kind = 'cone': must be one of box, sphere, cylinder, capsule, plane, mesh"),
    ({"kind": "box"}, r"ShapeCfg.size = None: a box needs it"),
    ({"kind": "box", "size": (1.0, 0.0, 1.0)}, r"ShapeCfg.size = .*: must be > 0 and finite"),
    ({"kind": "sphere", "radius": nan}, r"ShapeCfg.radius = nan: must be > 0 and finite"),
    ({"kind": "capsule", "radius": 1.0}, r"ShapeCfg.height = None: a capsule needs it"),
    ({"kind": "sphere", "radius": 1.0, "height": 2.0}, r"ShapeCfg.height = 2.0: a sphere has none"),
    ({"kind": "mesh", "path": "a.obj", "scale": 0.0}, r"ShapeCfg.scale = 0.0: must be > 0 and finite"),
    ({"kind": "sphere", "radius": 1.0, "scale": 2.0}, r"only a mesh is scaled"),
]
NO_ASSETS: list[tuple[dict[str, Any], str]] = [
    ({"count": 0}, r"AssetCfg.count = 0: must be >= 1"),
    ({"shapes": ()}, r"AssetCfg 'ball': give shapes, at least one"),
    ({"name": ""}, r"AssetCfg.name = '': must not be empty"),
    ({"semantic_id": 100}, r"AssetCfg.semantic_id = 100: must be 0 to 99, or -1"),
    ({"euler_high": (0.0, 0.0, 180.0)}, r"must lie within \+-2 pi. Angles are in radians"),
    ({"euler_low": (0.0, 0.0, 1.0)}, r"euler_low = .* must not exceed euler_high"),
    ({"position_ratio_low": (0.0, nan, 0.0)}, r"AssetCfg.position_ratio_low = .*: must be finite"),
    ({"position_ratio_low": (0.0, 1.5, 0.0)}, r"position_ratio_low = .* must not exceed position_ratio_high"),
    ({"offset": (0.0, inf, 0.0)}, r"AssetCfg.offset = .*: must be finite"),
]
NO_ENVIRONMENTS: list[tuple[dict[str, Any], str]] = [
    ({"physics_steps_per_env_step": 0}, r"physics_steps_per_env_step = 0: must be >= 1"),
    ({"bounds_lower_high": (-1.0, 2.0, -1.0)}, r"bounds_lower_high = .* must lie below bounds_upper_low"),
    ({"bounds_upper_high": (1.0, 0.5, 1.0)}, r"bounds_upper_low = .* must not exceed bounds_upper_high"),
    ({"bounds_lower_low": (-inf, -1.0, -1.0)}, r"bounds_lower_low = .*: must be finite"),
    ({"assets": (ASSET, ASSET)}, r"two are called 'ball'. Give each its own name"),
]


@pytest.mark.parametrize(("make", "fields", "message"), [
    *((ShapeCfg, *case) for case in NO_SHAPES),
    *((partial(replace, ASSET), *case) for case in NO_ASSETS),
    *((partial(replace, ENVIRONMENTS.get("empty_env")), *case) for case in NO_ENVIRONMENTS),
])  # fmt: skip
def test_impossible_environments_assets_and_shapes_are_refused(make: Callable, fields: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        make(**fields)


def test_mesh_files_are_found_beside_the_environment_file(tmp_path) -> None:
    trimesh.creation.box((1.0, 2.0, 3.0)).export(tmp_path / "rock.stl")
    (tmp_path / "env.yaml").write_text(
        "summary: a rock\nphysics_steps_per_env_step: 1\nsource: test\n"
        "bounds_lower_low: [-1, -1, -1]\nbounds_lower_high: [-1, -1, -1]\n"
        "bounds_upper_low: [1, 1, 1]\nbounds_upper_high: [1, 1, 1]\n"
        "assets:\n- {name: rock, count: 1, shapes: [{kind: mesh, path: rock.stl, scale: 0.5}],\n"
        "   position_ratio_low: [0, 0, 0], position_ratio_high: [1, 1, 1]}\n"
    )
    shape = load_environment(tmp_path / "env.yaml").assets[0].shapes[0]
    assert shape.path == str(tmp_path / "rock.stl")
    assert load_mesh(shape.path or "", scale=shape.scale).extents == pytest.approx([0.5, 1.0, 1.5])


FAR_PLY = (
    "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n"
    "property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n"
)


def test_a_scale_that_leaves_no_number_is_refused(tmp_path) -> None:
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(ConfigError, match=r"a.obj: a vertex is not finite"):
        load_mesh(tmp_path / "a.obj", scale=1e39)
    assert load_mesh(tmp_path / "a.obj", scale=2.0).area == pytest.approx(2.0)


def test_mesh_files_that_cannot_be_used_are_named(tmp_path) -> None:
    with pytest.raises(ConfigError, match=r"none.obj: no such file"):
        load_mesh(tmp_path / "none.obj", scale=1.0)
    for name, text, message in (
        ("empty.obj", "", "empty.obj: holds no triangle"),
        ("points.obj", "v 0 0 1\nv 1 0 0\n", "points.obj: holds no triangle"),
        ("nan.obj", "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "nan.obj: a vertex is not finite"),
        ("inf.obj", "v 0 0 inf\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "inf.obj: a vertex is not finite"),
        ("huge.obj", "v 0 0 0\nv 1e39 0 0\nv 0 1 0\nf 1 2 3\n", "huge.obj: a vertex is not finite"),
        ("line.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "line.obj: has no surface"),
        ("far.ply", FAR_PLY, "far.ply: a triangle names a vertex from 0 to 7; there are 3, counted from 0"),
        ("mesh.unknown", "?", "mesh.unknown: cannot be read"),
    ):
        (tmp_path / name).write_text(text)
        with pytest.raises(ConfigError, match=message):
            load_mesh(tmp_path / name, scale=1.0)


G = 9.80665
PI_180 = 3.141592653589793 / 180.0


def test_shipped_imus_hold_the_values_of_aerial_gym() -> None:
    """parity.md 3.6; of VN-100 and BMI088 the data sheets' densities per sqrt(Hz) and full scales: 16 and 24 g, 2000 deg/s."""
    base, vn100, bmi088 = (IMUS.get(name) for name in ("base_imu", "vn100", "bmi088"))
    assert base.accel_noise_density == pytest.approx([0.001688956] * 3, rel=1e-6)
    assert base.gyro_noise_density == pytest.approx([0.001067934] * 3, rel=1e-6)
    assert vn100.accel_noise_density == pytest.approx([0.14e-3 * G] * 3, rel=1e-6)
    assert vn100.gyro_noise_density == pytest.approx([0.0035 * PI_180] * 3, rel=1e-6)
    assert bmi088.accel_noise_density == pytest.approx([160e-6 * G, 160e-6 * G, 190e-6 * G], rel=1e-6)
    assert bmi088.gyro_noise_density == pytest.approx([0.014 * PI_180] * 3, rel=1e-6)
    for cfg in (base, vn100):
        assert cfg.accel_bias_walk == pytest.approx([9.7828e-7] * 3, rel=1e-5)
        assert cfg.gyro_bias_walk == pytest.approx([2.65416e-5] * 3, rel=1e-5)
    assert bmi088.accel_bias_walk == pytest.approx([0.001356466] * 3, rel=1e-6)
    assert bmi088.gyro_bias_walk == pytest.approx([1.435270e-5] * 3, rel=1e-6)
    for cfg, misalignment in ((base, 0.0), (vn100, 2.0), (bmi088, 2.0)):
        assert cfg.misalignment_deg == (misalignment,) * 3
        assert cfg.accel_initial_bias == cfg.gyro_initial_bias == (1e-3,) * 3
        assert cfg.position == cfg.euler == (0.0, 0.0, 0.0)
    assert (base.accel_range, base.gyro_range) == (100.0, 10.0)
    assert (vn100.accel_range, vn100.gyro_range) == pytest.approx((16.0 * G, 2000.0 * PI_180), rel=1e-5)
    assert (bmi088.accel_range, bmi088.gyro_range) == pytest.approx((24.0 * G, 2000.0 * PI_180), rel=1e-5)


@pytest.mark.parametrize(("fields", "message"), [
    ({"accel_range": 0.0}, r"ImuCfg.accel_range = 0.0: must be > 0 and finite"),
    ({"gyro_range": inf}, r"ImuCfg.gyro_range = inf: must be > 0 and finite"),
    ({"position": (0.0, nan, 0.0)}, r"ImuCfg.position = .*: must be finite"),
    ({"euler": (0.0, 90.0, 0.0)}, r"ImuCfg.euler = .*: must lie within \+-2 pi. Angles are in radians"),
    ({"euler": (nan, 0.0, 0.0)}, r"ImuCfg.euler = "),
    ({"misalignment_deg": (0.0, 46.0, 0.0)}, r"ImuCfg.misalignment_deg = .*: must lie within 0 and 45 degrees"),
    ({"misalignment_deg": (0.0, -1.0, 0.0)}, r"ImuCfg.misalignment_deg"),
    *(
        ({f"{kind}_{name}": (0.0, bad, 0.0)}, rf"ImuCfg.{kind}_{name} = .*: must be >= 0 and finite")
        for kind in ("accel", "gyro")
        for name in ("noise_density", "bias_walk", "initial_bias")
        for bad in (-1e-9, nan, inf)
    ),
])  # fmt: skip
def test_impossible_imus_are_refused(fields: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        replace(IMUS.get("vn100"), **fields)
