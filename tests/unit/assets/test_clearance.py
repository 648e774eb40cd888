"""Room around start and goal: the guarantee, what it may move, and what it must not touch."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from aerial_gym.assets import ENVIRONMENTS, PARKED_Z, AssetManager, CollisionTest
from aerial_gym.config.environment import AssetCfg, EnvironmentCfg, FamilyCfg, ShapeCfg
from aerial_gym.config.robot import SphereCfg
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import ConfigError
from tests.builders import simulation
from tests.unit.assets.managers import ANYWHERE, MIDDLE, begin, box_environment, every, make_manager

ROUNDING = 2e-6
"""Of distances below 20 m in float32 [m]."""


def simulate(env_name: str, num_envs: int, seed: int = 0) -> EnvManager:
    return simulation("base_quadrotor", "lee_velocity_control", env=env_name, num_envs=num_envs, seed=seed)


def manager(assets: tuple[AssetCfg, ...], num_envs: int) -> AssetManager:
    """Obstacles in a cube of 4 m."""
    made, *_ = make_manager(box_environment((2.0, 2.0, 2.0), *assets, clearance=0.5), num_envs, seed=3)
    begin(made, every(num_envs))
    return made


def distance(made: AssetManager, points: Tensor) -> Tensor:
    num, out = len(points), torch.full((len(points),), float("nan"))
    attitude = torch.tensor([0.0, 0.0, 0.0, 1.0]).expand(num, 4).contiguous()
    point = (SphereCfg(center=(0.0, 0.0, 0.0), radius=1e-9),)
    CollisionTest(made.scene, point, position=points, attitude=attitude, distance_out=out).measure()
    return out


ANY_WAY = {"euler_low": (-3.0, -3.0, -3.0), "euler_high": (3.0, 3.0, 3.0)}
SOLIDS = (ShapeCfg(kind="box", size=(0.3, 0.5, 0.8)), ShapeCfg(kind="sphere", radius=0.4))
BOXES = AssetCfg(name="boxes", shapes=SOLIDS, count=10, **ANYWHERE, **ANY_WAY)
TREES = replace(BOXES, name="trees", shapes=(), family=FamilyCfg(name="trees", variants=4), count=3, keep=True)
WALL = AssetCfg(name="wall", shapes=(ShapeCfg(kind="box", size=(0.2, 4.0, 4.0)),), count=1, **MIDDLE)


def _clears(env: EnvironmentCfg) -> bool:
    """A track keeps distances of its own, and to land on what pushes back one comes near it."""
    return env.num_assets > 0 and env.track is None and env.contact is None


@pytest.mark.parametrize("name", [name for name in ENVIRONMENTS.names() if _clears(ENVIRONMENTS.get(name))])
def test_no_robot_starts_inside_or_near_an_obstacle(name: str) -> None:
    env = simulate(name, 250)
    assert env.cfg.clearance == 0.4
    for _ in range(4):
        env.reset()
        assert env.gtd["robot_clearance"].min() >= 0.4 - ROUNDING
        assert (env.gtd["obstacle_position"][..., 2] == PARKED_Z).float().mean() < 1e-3


def test_starts_and_goals_keep_their_room_together() -> None:
    made = manager((BOXES, TREES, WALL), 500)
    draw = torch.Generator().manual_seed(0)
    start, goal = (2.0 * torch.rand(500, 3, generator=draw) - 1.0 for _ in range(2))
    start[:, 0], goal[:, 0] = 0.7, -1.3  # far enough from the wall at 0, which stays
    for _ in range(2):
        begin(made, every(500))
        made.clear_start(every(500), start)
        assert distance(made, start).min() >= 0.5 - ROUNDING
        assert (distance(made, goal) < 0.5).any()
        made.clear_goal(every(500), goal)
        assert distance(made, start).min() >= 0.5 - ROUNDING
        assert distance(made, goal).min() >= 0.5 - ROUNDING


def test_obstacles_that_are_far_enough_stay_where_they_are() -> None:
    made = manager((BOXES,), 300)
    before = made.scene.asset_state.clone()
    points = torch.zeros(300, 3)
    made.clear_start(every(300), points)
    after = made.scene.asset_state
    moved = (after != before).any(dim=-1)
    far = before[..., :3].norm(dim=-1) > 0.5 + 0.5 * (0.3**2 + 0.5**2 + 0.8**2) ** 0.5
    assert not moved[far].any()
    near = before[..., :3].norm(dim=-1) < 0.5
    assert moved[near].all()
    assert near.any()
    present = after[..., 2] > -500.0
    assert (after[..., :3][present].abs() <= 2.0 + 1e-6).all()


def test_what_cannot_be_placed_is_parked_and_walls_stay() -> None:
    stuck = replace(BOXES, shapes=(ShapeCfg(kind="sphere", radius=3.0),), count=2, keep=True)
    made = manager((stuck, WALL), 5)
    made.clear_start(every(5), torch.zeros(5, 3))
    assert (made.scene.asset_state[:, :2, 2] == PARKED_Z).all()
    assert (made.scene.asset_state[:, 2, :3] == 0.0).all()
    assert (distance(made, torch.zeros(5, 3)) < 0.0).all()


def test_making_room_leaves_other_environments_bit_for_bit() -> None:
    made = manager((BOXES, TREES), 6)
    made.clear_start(every(6), torch.zeros(6, 3))
    # Since then an obstacle has come close: not the business of a reset elsewhere.
    made.scene.asset_state[1, 5, :3] = 0.0
    before = made.scene.asset_state.clone()
    mask = torch.tensor([True, False, False, True, False, False])
    begin(made, mask)
    made.clear_start(mask, torch.full((6, 3), 1.0))
    made.clear_goal(mask, torch.full((6, 3), -1.0))
    assert torch.equal(made.scene.asset_state[~mask], before[~mask])


def test_a_new_start_forgets_the_goal_of_the_last_episode() -> None:
    states = []
    for has_goal in (False, True):
        made = manager((BOXES,), 3)
        if has_goal:
            made.clear_start(every(3), torch.zeros(3, 3))
            made.clear_goal(every(3), torch.ones(3, 3))
        begin(made, every(3))
        made.clear_start(every(3), torch.full((3, 3), 0.2))
        states.append(made.scene.asset_state.clone())
    assert torch.equal(*states)


def test_impossible_clearances_are_refused() -> None:
    for value in (-0.1, float("nan"), float("inf")):
        with pytest.raises(ConfigError, match=r"EnvironmentCfg.clearance = .*: must be >= 0 and finite"):
            replace(ENVIRONMENTS.get("empty_env"), clearance=value)
