"""What sensors see beside the obstacles: the robot itself and the ground, and that nothing else notices either."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from torch import Tensor

from aerial_gym.assets import ENVIRONMENTS, Scene
from aerial_gym.assets.scene import VisibleVehicle
from aerial_gym.config.environment import CheckerCfg, EnvironmentCfg, PartCfg, ShapeCfg
from aerial_gym.config.loader import dump_yaml
from aerial_gym.config.robot import CollisionCfg, RobotCfg, load_robot
from aerial_gym.config.shape import ROBOT_ID
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import ConfigError, ShapeError
from aerial_gym.math.quaternion import quat_from_euler
from aerial_gym.robots import ROBOTS
from tests.builders import simulation
from tests.physics.test_ray_caster import CAMERA, exact_distance, pixel_rays, rotation, take_image

ARM = PartCfg(shape=ShapeCfg(kind="box", size=(0.5, 0.06, 0.04)), position=(0.1, 0.0, -0.02), euler=(0.0, 0.0, 0.7))
POD = PartCfg(shape=ShapeCfg(kind="sphere", radius=0.09), position=(0.2, 0.2, 0.1), semantic_id=5)
BASE = ROBOTS.get("base_quadrotor")
SEEN = replace(BASE, visible=True, visual=(ARM, POD))
OPEN_AIR = ENVIRONMENTS.get("empty_env")


def build(robot: RobotCfg, env: EnvironmentCfg, device: torch.device, *, num_envs: int = 2) -> EnvManager:
    manager = simulation(robot, "lee_velocity_control", env=env, num_envs=num_envs, device=device, seed=3)
    manager.reset()
    return manager


def exact_view(
    parts: tuple[PartCfg, ...], body: tuple[Tensor, Tensor], eye: tuple[Tensor, Tensor]
) -> tuple[np.ndarray, ...]:
    """Return range (N,) and index of the part (N,), -1 for a miss, of parts on a body seen from an eye, in float64."""
    rays = pixel_rays(CAMERA) @ rotation(eye[1]).T
    result = []
    for part in parts:
        turn = rotation(body[1]) @ rotation(quat_from_euler(torch.tensor(part.euler, dtype=torch.float64)))
        place = body[0].double().numpy() + rotation(body[1]) @ np.array(part.position)
        origin = (eye[0].double().numpy() - place) @ turn
        result.append(exact_distance(part.shape, np.tile(origin, (len(rays), 1)), rays @ turn))
    stack = np.stack(result)
    return stack.min(axis=0), np.where(np.isfinite(stack.min(axis=0)), stack.argmin(axis=0), -1)


def test_an_observer_sees_the_robot_where_it_is_before_and_after_it_moves(device) -> None:
    scene = Scene(
        [], shape_index=torch.zeros(0), semantic_id=torch.zeros(0), asset_state=torch.zeros(2, 0, 13, device=device),
        vehicles=[VisibleVehicle(parts=SEEN.visible_parts)], link_state=(state := torch.zeros(2, 13, device=device)),
    )  # fmt: skip
    eye = torch.zeros(2, 3, device=device), quat_from_euler(torch.tensor([[0.1, 0.05, -0.1]] * 2)).to(device)
    generator = torch.Generator().manual_seed(4)
    result = []
    for _ in range(2):
        place = torch.tensor([0.9, 0.0, 0.0]) + 0.3 * torch.rand(2, 3, generator=generator)
        angles = 2.0 * torch.rand(2, 3, generator=generator) - 1.0
        state[:, :3], state[:, 3:7] = place.to(device), quat_from_euler(angles).to(device)
        distance, ids = take_image(CAMERA, scene, *eye)
        result.append(distance)
        for env in range(2):
            body = state[env, :3].cpu(), state[env, 3:7].cpu()
            exact, part = exact_view((ARM, POD), body, (eye[0][env].cpu(), eye[1][env].cpu()))
            measured, seen = distance[env].flatten().numpy(), ids[env].flatten().numpy()
            expected = np.array([-2, ROBOT_ID, 5])[part + 1]
            assert (seen != expected).mean() < 0.003  # rays that pass an edge by less than the rounding
            same = (seen == expected) & (part >= 0)
            assert {ROBOT_ID, 5} <= set(seen[same].tolist())
            np.testing.assert_allclose(measured[same], exact[same], atol=1e-5)
    assert not torch.equal(result[0], result[1])


def test_a_camera_on_board_sees_its_arm_at_the_same_pixels_wherever_it_flies(device) -> None:
    manager = build(SEEN, OPEN_AIR, device)
    cfg = replace(CAMERA, position=(0.1, 0.05, 0.4), euler=(0.0, np.pi / 2, 0.0))
    level = torch.zeros(3), torch.tensor([0.0, 0.0, 0.0, 1.0])
    eye = torch.tensor(cfg.position), quat_from_euler(torch.tensor(cfg.euler, dtype=torch.float64))
    exact, part = exact_view((ARM, POD), level, eye)
    actions = torch.tensor([[1.0, -0.5, 0.3, 0.8]] * 2, device=device)
    before = manager.gtd["robot_position"].clone()
    for _ in range(100):
        manager.step(actions)
    assert ((manager.gtd["robot_position"] - before).norm(dim=-1) > 0.05).all()
    pose = manager.gtd["robot_position"], manager.gtd["robot_orientation"]
    distance, ids = take_image(cfg, manager.asset_manager.scene, *pose)
    expected = torch.from_numpy(np.array([-2, ROBOT_ID, 5])[part + 1]).view(37, 48)
    for env in range(2):
        assert (ids[env] != expected).float().mean() < 0.003
        same = (ids[env] == expected) & (expected >= 0)
        assert same.sum() > 50
        np.testing.assert_allclose(distance[env][same].numpy(), exact.reshape(37, 48)[same.numpy()], atol=1e-5)


def test_a_robot_without_shapes_of_its_own_is_seen_as_its_collision_spheres(device) -> None:
    """From 1 m above the middle of the sphere; from inside it, the surface is seen from within."""
    scene = build(replace(BASE, visible=True), OPEN_AIR, device).asset_manager.scene
    body = scene.arrays.link_position.numpy()[:, 0]
    radius = BASE.collision.spheres[0].radius
    cfg = replace(CAMERA, width=1, height=1, hfov_deg=1.0, euler=(0.0, np.pi / 2, 0.0))
    turn = torch.tensor([[0.0, 0.0, 0.0, 1.0]] * 2, device=device)
    for above, expected in ((1.0, 1.0 - radius), (0.0, radius)):
        eye = torch.from_numpy(body + np.array([0.0, 0.0, above], dtype=np.float32)).to(device)
        distance, ids = take_image(cfg, scene, eye, turn)
        assert (ids == ROBOT_ID).all()
        torch.testing.assert_close(distance, torch.full_like(distance, expected), rtol=0.0, atol=1e-5)


def test_only_sensors_notice_whether_a_robot_is_visible(device) -> None:
    env, camera = ENVIRONMENTS.get("env_with_obstacles"), ("base_depth_camera",)
    around = PartCfg(shape=ShapeCfg(kind="sphere", radius=0.6))
    plain = build(replace(BASE, sensors=camera), env, device, num_envs=4)
    hidden = build(replace(BASE, sensors=camera, visual=(around,)), env, device, num_envs=4)
    seen = build(replace(BASE, sensors=camera, visual=(around,), visible=True), env, device, num_envs=4)
    actions = torch.tensor([[1.0, 0.2, 0.1, 0.3]] * 4, device=device)
    for manager in (plain, hidden, seen):
        for _ in range(5):
            manager.step(actions)
        manager.render()
    for key in ("vec_root_tensor", "robot_clearance", "crashes"):
        assert torch.equal(plain.gtd[key], hidden.gtd[key])
        assert torch.equal(plain.gtd[key], seen.gtd[key])
    for key in ("depth_range_pixels", "segmentation_pixels"):
        assert torch.equal(plain.gtd[key], hidden.gtd[key])
        assert not torch.equal(plain.gtd[key], seen.gtd[key])
    assert (seen.gtd["segmentation_pixels"] == ROBOT_ID).any()
    assert not (plain.gtd["segmentation_pixels"] == ROBOT_ID).any()


def test_meshes_of_a_robot_file_are_found_beside_it(tmp_path: Path) -> None:
    import trimesh

    trimesh.creation.box((0.2, 0.2, 0.1)).export(tmp_path / "body.stl")
    data = yaml.safe_load(dump_yaml(BASE))
    data |= {"visible": True, "visual": [{"shape": {"kind": "mesh", "path": "body.stl"}, "position": [0.0, 0.0, 0.1]}]}
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump(data))
    (part,) = load_robot(tmp_path / "robot.yaml").visible_parts
    assert part.shape.path == str(tmp_path / "body.stl")
    assert part.semantic_id == ROBOT_ID


def test_what_cannot_be_seen_is_refused(device) -> None:
    with pytest.raises(ConfigError, match=r"RobotCfg.visible: there is nothing to see"):
        replace(BASE, visible=True, collision=CollisionCfg(source="none"))
    empty = {"shape_index": torch.zeros(0), "semantic_id": torch.zeros(0)}
    state = torch.zeros(1, 0, 13, device=device)
    with pytest.raises(ConfigError, match=r"box outside the instances: needs a semantic_id"):
        Scene([], **empty, asset_state=state, fixed=(ARM,))
    with pytest.raises(ShapeError, match=r"link_state: \(E, L, 13\) is needed"):
        Scene([], **empty, asset_state=state, vehicles=[VisibleVehicle(parts=(POD,))])
    with pytest.raises(ConfigError, match=r"EnvironmentCfg.ground_color = \(2.0, 0.0, 0.0\)"):
        replace(OPEN_AIR, ground_color=(2.0, 0.0, 0.0))
    with pytest.raises(ConfigError, match=r"EnvironmentCfg.ground_semantic_id = 100: must be 0 to 99"):
        replace(OPEN_AIR, ground_height=0.0, ground_semantic_id=100)


def test_the_clearance_counts_the_ground_and_obstacles_are_placed_as_without_it(device) -> None:
    env = ENVIRONMENTS.get("dynamic_env")
    above = build(BASE, env, device, num_envs=4)
    beside = build(BASE, replace(env, ground_height=None), device, num_envs=4)
    assert torch.equal(above.gtd["vec_root_tensor"], beside.gtd["vec_root_tensor"])
    height = above.gtd["robot_position"][:, 2] - BASE.collision.spheres[0].radius
    expected = torch.minimum(beside.gtd["robot_clearance"], height)
    torch.testing.assert_close(above.gtd["robot_clearance"], expected, rtol=0.0, atol=1e-6)
    assert (height < beside.gtd["robot_clearance"]).any()


def test_ground_without_obstacles_is_seen_and_counted(device) -> None:
    """Clearance is height less radius, before and after a step; a fall through the ground is a crash and negative."""
    manager = build(BASE, replace(OPEN_AIR, ground_height=-2.0, ground_semantic_id=7), device)
    radius = BASE.collision.spheres[0].radius
    for _ in range(3):
        height = manager.gtd["robot_position"][:, 2] + 2.0 - radius
        torch.testing.assert_close(manager.gtd["robot_clearance"], height, rtol=0.0, atol=1e-6)
        manager.step(torch.zeros(2, 4, device=device))
    pose = manager.gtd["robot_position"], manager.gtd["robot_orientation"]
    _, ids = take_image(replace(CAMERA, euler=(0.0, np.pi / 2, 0.0)), manager.asset_manager.scene, *pose)
    assert (ids == 7).all()
    manager.gtd["robot_position"][0, 2] = -1.9
    manager.step(torch.zeros(2, 4, device=device))
    assert manager.gtd["crashes"].tolist() == [True, False]
    assert manager.gtd["robot_clearance"][0] < 0.0 < manager.gtd["robot_clearance"][1]


def test_the_ground_has_the_color_and_the_fields_of_its_configuration() -> None:
    board = CheckerCfg(size=0.5)
    ground = replace(OPEN_AIR, ground_height=1.5, ground_color=(0.1, 0.2, 0.3), ground_checker=board).ground_part
    assert (ground.shape.color, ground.shape.checker, ground.position[2]) == ((0.1, 0.2, 0.3), board, 1.5)
    assert OPEN_AIR.ground_part is None


def test_the_lamps_of_a_hall_are_those_of_its_scene(device) -> None:
    env = ENVIRONMENTS.get("env_with_obstacles")
    assert len(env.lamps) == 2
    assert build(BASE, env, device).asset_manager.scene.lamps == env.lamps
