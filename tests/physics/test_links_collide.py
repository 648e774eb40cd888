"""Collision shapes on links: signed distances by hand, and touches between two poses of a step, on both backends."""

from dataclasses import replace
from math import pi, sin

import pytest
import torch

from aerial_gym.assets import ENVIRONMENTS, CollisionTest, Scene
from aerial_gym.assets.collision import LinkGeometry
from aerial_gym.config.collision import BoxCfg, CapsuleCfg, CollisionCfg, SphereCfg
from aerial_gym.config.environment import ShapeCfg
from aerial_gym.config.joint import JointsCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.control import CONTROLLERS
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import ConfigError
from aerial_gym.robots import ROBOTS
from tests.builders import simulation
from tests.physics.test_links_seen import DOWN, END, HINGE, LEFT, arm, bending

RADIUS, LENGTH = 0.02, END - HINGE
ROD_OF_ARM = CapsuleCfg(
    radius=RADIUS, height=LENGTH, center=(0.5 * (HINGE + END), 0.0, 0.0), euler=(0.0, 0.5 * pi, 0.0), link="arm"
)
HULL = SphereCfg(center=(0.0, 0.0, 0.0), radius=0.05)


def fly(
    robot: RobotCfg, device: torch.device, *, ground: float | None = None, substeps: int = 1, backend: str = "auto"
) -> EnvManager:
    env = replace(ENVIRONMENTS.get("empty_env"), ground_height=ground, physics_steps_per_env_step=substeps)
    manager = simulation(robot, env=env, device=device, seed=1, backend=backend)
    manager.reset()
    return manager


def with_rod(axis: tuple[float, float, float], angle: float, rate: float = 0.0) -> RobotCfg:
    shapes = CollisionCfg(spheres=(HULL,), capsules=(ROD_OF_ARM,), source="invented")
    return bending(arm(axis, angle, rate=rate), collision=shapes)


@pytest.mark.parametrize("angle", [0.6, -0.6])
def test_the_clearance_counts_the_arm_where_it_is(angle, device) -> None:
    manager = fly(with_rod(DOWN, angle), device, ground=-0.3)
    expected = min(0.3 - LENGTH * sin(angle) - RADIUS, 0.3 - HULL.radius)
    torch.testing.assert_close(manager.gtd["robot_clearance"].cpu(), torch.full((2,), expected), atol=2e-6, rtol=0.0)
    deep = fly(with_rod(DOWN, 1.2), device, ground=-0.3).gtd["robot_clearance"]
    torch.testing.assert_close(deep.cpu(), torch.full((2,), 0.3 - LENGTH * sin(1.2) - RADIUS), atol=2e-6, rtol=0.0)
    assert (deep < 0.0).all()


@pytest.mark.parametrize("backend", ["warp", "torch"])
@pytest.mark.parametrize(("rate", "crashes"), [(30.0, True), (-30.0, False)])
def test_an_arm_that_touches_between_two_poses_crashes(rate, crashes, backend, device) -> None:
    """From 0.57 rad down through the ground and up behind, in one step of seven substeps; the other way it is clear."""
    if backend == "torch" and device.type == "cuda":
        pytest.skip("the same code as on a CPU")
    manager = fly(with_rod(DOWN, 0.57, rate=rate), device, ground=-0.35, substeps=7, backend=backend)
    assert (manager.gtd["robot_clearance"] > 0.0).all()
    manager.step(torch.zeros(2, 4, device=device))
    assert (manager.gtd["robot_clearance"] > 0.0).all()
    assert manager.gtd["crashes"].tolist() == [crashes] * 2


def test_each_link_is_measured_with_its_own_pose(device) -> None:
    ball = torch.tensor([[[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, *[0.0] * 6]]], device=device)
    scene = Scene(
        [ShapeCfg(kind="sphere", radius=0.5)], shape_index=torch.zeros(1), semantic_id=torch.zeros(1), asset_state=ball
    )
    level = torch.tensor([[0.0, 0.0, 0.0, 1.0]], device=device)
    turned = torch.tensor([[0.0, 0.0, 0.5**0.5, 0.5**0.5]], device=device)  # x of the link along y of the world

    def position_row(x: float, y: float) -> torch.Tensor:
        return torch.tensor([[x, y, 0.0]], device=device)

    box = BoxCfg(size=(0.2, 0.4, 0.2), center=(0.3, 0.0, 0.0))
    links = [
        LinkGeometry(shapes=(box,), number=1, position=position_row(0.0, 0.9), attitude=turned),  # near face at y = 1.1
        LinkGeometry(
            shapes=(SphereCfg(center=(0.1, 0.0, 0.0), radius=0.1),),
            number=2, position=position_row(-2.0, 0.0), attitude=level,
        ),
    ]  # fmt: skip
    result = []
    for own in (links[:1], links[1:], links):
        out = torch.full((1,), float("nan"), device=device)
        body = {"position": position_row(3.0, 0.0), "attitude": level}
        CollisionTest(
            scene, (SphereCfg(center=(0.0, 0.0, 0.0), radius=0.2),), distance_out=out, links=own, **body
        ).measure()
        result.append(out.item())
    assert result == pytest.approx([0.6, 1.3, 0.6], abs=1e-6)


def two_arms(angle: float, rate: float = 0.0) -> RobotCfg:
    """Return arms along x at y = -0.1 and 0.1 that both turn to the left; the right one comes nearer."""
    right = replace(arm(LEFT, angle, rate=rate), name="right", position=(HINGE, -0.1, 0.0))
    left = replace(arm(LEFT, 0.0), name="left", position=(HINGE, 0.1, 0.0))
    rods = tuple(
        replace(ROD_OF_ARM, center=(0.5 * (HINGE + END), y, 0.0), link=name)
        for name, y in (("right", -0.1), ("left", 0.1))
    )
    shapes = CollisionCfg(spheres=(HULL,), capsules=rods, between_links=True, source="invented")
    joints = JointsCfg(layout=(right, left), floating=False, source="invented")
    return replace(bending(arm(LEFT, 0.0)), joints=joints, visual=(), collision=shapes)


def test_links_are_told_how_far_they_are_from_each_other(device) -> None:
    for angle in (0.0, 0.3, -0.3, 0.6):
        manager = fly(two_arms(angle), device)
        apart = 0.2 - LENGTH * sin(angle) if angle > 0.0 else 0.2
        result = manager.gtd["robot_link_clearance"].cpu()
        if angle == 0.6:
            assert (result < 0.0).all()
        else:
            torch.testing.assert_close(result, torch.full((2,), apart - 2 * RADIUS), atol=2e-5, rtol=0.0)
        manager.step(torch.zeros(2, 4, device=device))
        assert manager.gtd["crashes"].tolist() == [angle == 0.6] * 2


def test_links_that_pass_through_each_other_within_a_step_crash(device) -> None:
    """From -0.2 to 1.9 rad in one step of seven substeps: apart at both ends."""
    manager = fly(two_arms(-0.2, rate=30.0), device, substeps=7)
    manager.step(torch.zeros(2, 4, device=device))
    assert float(manager.gtd["dof_position"][0, 0]) == pytest.approx(1.9, abs=0.1)
    assert manager.gtd["crashes"].all()


def test_rods_of_a_snake_are_a_side_of_their_square_apart(device) -> None:
    snake = ROBOTS.get("snakey")
    robot = replace(snake, collision=replace(snake.collision, between_links=True))
    controller = CONTROLLERS.get("no_control")
    manager = simulation(robot, controller, num_envs=1, device=device, seed=1)
    manager.reset()
    assert manager.gtd["robot_link_clearance"].item() == pytest.approx(1.0 - 2.0 * 0.02, abs=1e-5)


def test_links_without_a_pair_and_shapes_without_a_link_are_refused() -> None:
    shapes = CollisionCfg(spheres=(HULL,), capsules=(ROD_OF_ARM,), between_links=True, source="invented")
    with pytest.raises(ConfigError, match="no pair of shapes to test"):
        fly(bending(arm(DOWN, 0.0), collision=shapes), torch.device("cpu"))
    rigid = replace(bending(arm(DOWN, 0.0)), joints=None, visual=(), visible=False)
    with pytest.raises(ConfigError, match="shape 1 sits on link 'arm': must be a link of the robot .base"):
        replace(rigid, collision=CollisionCfg(capsules=(ROD_OF_ARM,), source="invented"))
    with pytest.raises(ConfigError, match="between_links: the robot has no joints"):
        replace(rigid, collision=CollisionCfg(spheres=(HULL,), between_links=True, source="invented"))
