"""The asset manager: who stands where after a reset, who does not, and who is left alone."""

import gc
import subprocess
import sys
from dataclasses import replace
from math import pi

import pytest
import torch
from torch import Tensor

from aerial_gym.assets import ENVIRONMENTS, PARKED_Z, AssetManager, CollisionTest
from aerial_gym.config.environment import AssetCfg, EnvironmentCfg, FamilyCfg, ShapeCfg
from aerial_gym.config.robot import SphereCfg
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import ConfigError, ShapeError
from aerial_gym.math.quaternion import euler_from_quat
from tests.builders import simulation
from tests.unit.assets.managers import ANYWHERE, MIDDLE, begin, box_environment, every, make_manager

OBSTACLES = ENVIRONMENTS.get("env_with_obstacles")
PANELS, WALLS, OBJECTS = slice(0, 3), slice(3, 9), slice(9, 44)


def test_bounds_are_drawn_within_their_limits(device: torch.device) -> None:
    _, _, (lower, upper) = make_manager(OBSTACLES, 500, device)
    for drawn, side in ((lower, "lower"), (upper, "upper")):
        low, high = (torch.tensor(getattr(OBSTACLES, f"bounds_{side}_{end}"), device=device) for end in ("low", "high"))
        assert ((drawn >= low) & (drawn <= high)).all()
        assert (drawn.std(dim=0) > 0.2 * (high - low)).all()  # uniform has 0.29


def test_obstacles_stand_within_their_share_of_the_bounds_at_rest(device: torch.device) -> None:
    manager, gtd, (lower, upper) = make_manager(OBSTACLES, 200, device)
    gtd["env_asset_state_tensor"][..., 7:] = 3.0
    begin(manager, every(200, device))
    ratio = (gtd["obstacle_position"] - lower[:, None]) / (upper - lower)[:, None]
    for rows, asset in ((PANELS, OBSTACLES.assets[0]), (OBJECTS, OBSTACLES.assets[1])):
        low = torch.tensor(asset.position_ratio_low, device=device)
        high = torch.tensor(asset.position_ratio_high, device=device)
        assert ((ratio[:, rows] > low - 1e-5) & (ratio[:, rows] < high + 1e-5)).all()
        assert (ratio[:, rows].flatten(0, 1).std(dim=0) > 0.25 * (high - low)).all()
    quaternion = gtd["obstacle_orientation"]
    torch.testing.assert_close(quaternion.norm(dim=-1), torch.ones(200, 44, device=device))
    euler = euler_from_quat(quaternion)
    assert (euler[:, PANELS, :2].abs() < 1e-6).all()
    assert (euler[:, PANELS, 2].abs() < pi / 3 + 1e-5).all()
    assert (euler[:, OBJECTS, 0].abs() > 2.5).any()
    assert (gtd["obstacle_linvel"] == 0.0).all()
    assert (gtd["obstacle_angvel"] == 0.0).all()


def test_inner_faces_of_walls_lie_on_the_bounds(device: torch.device) -> None:
    """Front, back, left, right, bottom, top: centre beyond the face by half the thickness of 0.2 m, centred on it."""
    manager, gtd, (lower, upper) = make_manager(OBSTACLES, 50, device)
    begin(manager, every(50, device))
    walls = gtd["obstacle_position"][:, WALLS]
    middle = 0.5 * (lower + upper)
    for row, (axis, side) in enumerate(((0, 1), (0, -1), (1, 1), (1, -1), (2, 1), (2, -1))):
        axis_row = row if row < 4 else 9 - row  # bottom comes before top
        face = (upper if side > 0 else lower)[:, axis]
        torch.testing.assert_close(walls[:, axis_row, axis] - 0.1 * side, face, rtol=0.0, atol=2e-6)
        rest = [i for i in range(3) if i != axis]
        torch.testing.assert_close(walls[:, axis_row, rest], middle[:, rest], rtol=0.0, atol=2e-6)
    assert manager.scene.semantic_id[:, WALLS].tolist() == [[9, 10, 11, 12, 13, 14]] * 50
    own = [*range(100, 103), *range(109, 144)]
    assert manager.scene.semantic_id[:, [*range(3), *range(9, 44)]].tolist() == [own] * 50


def test_reset_leaves_other_environments_bit_for_bit(device: torch.device) -> None:
    manager, gtd, _ = make_manager(OBSTACLES, 6, device)
    begin(manager, every(6, device))
    state = gtd["env_asset_state_tensor"]
    state[1, 5], state[2, 5] = float("nan"), float("nan")
    before = state.clone()
    mask = torch.tensor([True, False, True, False, False, True], device=device)
    begin(manager, mask)
    bits, old = state.view(torch.int32), before.view(torch.int32)
    assert torch.equal(bits[~mask], old[~mask])
    assert (bits[mask] != old[mask]).flatten(1).any(dim=1).all()
    assert not state[mask].isnan().any()
    unchanged = state.clone()
    begin(manager, torch.zeros(6, dtype=torch.bool, device=device))
    assert torch.equal(state.view(torch.int32), unchanged.view(torch.int32))


@pytest.mark.parametrize("count", [0, 1, 20, 35])
def test_the_curriculum_parks_all_but_the_first_obstacles(count: int, device: torch.device) -> None:
    manager, gtd, _ = make_manager(OBSTACLES, 10, device)
    manager.set_num_obstacles(count)
    assert gtd["num_obstacles_in_env"].item() == count
    begin(manager, every(10, device))
    height = gtd["obstacle_position"][..., 2]
    assert (height[:, : 9 + count] > -10.0).all()
    assert (height[:, 9 + count :] == PARKED_Z).all()


def test_the_curriculum_has_its_limits(device: torch.device) -> None:
    manager, _, _ = make_manager(OBSTACLES, 2, device)
    for count in (-1, 36):
        with pytest.raises(ConfigError, match=f"num_obstacles = {count}: this environment has 0 to 35"):
            manager.set_num_obstacles(count)


def test_before_the_first_reset_nothing_is_there(device: torch.device) -> None:
    _, gtd, _ = make_manager(OBSTACLES, 3, device)
    state = gtd["env_asset_state_tensor"]
    assert (state[..., 2] == PARKED_Z).all()
    assert (state[..., 6] == 1.0).all()


def test_each_environment_draws_its_own_kinds_in_fair_shares(device: torch.device) -> None:
    """Four kinds of box, 35 draws in each of 200 environments: shares of 1/4 within five standard errors of 0.0052."""
    manager, _, _ = make_manager(OBSTACLES, 200, device)
    kinds = manager.scene.shape_index[:, OBJECTS] - 1
    shares = torch.bincount(kinds.flatten().cpu(), minlength=4) / kinds.numel()
    assert shares.shape == (4,)
    assert ((shares - 0.25).abs() < 0.026).all()
    assert (kinds[0] != kinds[1]).any()
    assert (manager.scene.shape_index[:, PANELS] == 0).all()


def test_removable_assets_of_several_kinds_are_shuffled(device: torch.device) -> None:
    """Of 10 balls and 10 cubes the first row is a ball in about half of 400 environments (standard error 0.025)."""
    ball = AssetCfg(name="ball", shapes=(ShapeCfg(kind="sphere", radius=0.1),), count=10, semantic_id=1, **ANYWHERE)
    cube = replace(ball, name="cube", shapes=(ShapeCfg(kind="box", size=(0.1, 0.1, 0.1)),), semantic_id=2)
    cfg = replace(ENVIRONMENTS.get("empty_env"), assets=(ball, cube))
    manager, _, _ = make_manager(cfg, 400, device)
    ids = manager.scene.semantic_id
    assert ((ids == 1).sum(dim=1) == 10).all()
    assert (ids[:, 0] == 1).float().mean().item() == pytest.approx(0.5, abs=0.13)
    assert torch.equal(manager.scene.shape_index + 1, ids)


def test_states_can_live_in_the_memory_of_another_tensor(device: torch.device) -> None:
    """The obstacles are rows 1 and up of a root tensor whose row 0, the robot, is never written."""
    root = torch.full((3, 45, 13), 7.0, device=device)
    manager, gtd, _ = make_manager(OBSTACLES, 3, device, asset_state=root[:, 1:])
    begin(manager, every(3, device))
    assert (root[:, 0] == 7.0).all()
    assert torch.equal(root[:, 1:, :3], gtd["obstacle_position"])
    assert gtd["obstacle_position"].data_ptr() == root[:, 1:].data_ptr()


def test_wrong_tensors_are_refused(device: torch.device) -> None:
    manager, _, _ = make_manager(OBSTACLES, 2, device)
    with pytest.raises(ShapeError, match=r"mask is \(2,\) torch.int64.*expected \(2,\) torch.bool"):
        begin(manager, torch.zeros(2, dtype=torch.int64, device=device))
    with pytest.raises(ShapeError, match=r"'env_asset_state_tensor'.*declared \(2, 44, 13\)"):
        make_manager(OBSTACLES, 2, device, asset_state=torch.zeros(2, 43, 13, device=device))


def test_importing_assets_and_sensors_starts_no_device_and_compiles_nothing() -> None:
    code = "import aerial_gym.assets, aerial_gym.sensors, warp._src.context as c, torch, sys;"
    code += "sys.exit(int(c.runtime is not None or torch.cuda.is_initialized() or 'trimesh' in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""


@pytest.mark.parametrize("name", [name for name in ENVIRONMENTS.names() if ENVIRONMENTS.get(name).num_assets])
def test_every_shipped_environment_places_all_its_obstacles_over_its_bounds(name: str, device: torch.device) -> None:
    cfg = ENVIRONMENTS.get(name)
    manager, gtd, (lower, upper) = make_manager(cfg, 50, device)
    begin(manager, every(50, device))
    position = gtd["obstacle_position"]
    assert (position >= lower[:, None] - 0.11).all()
    assert (position <= upper[:, None] + 0.11).all()
    assert position.shape[1] == cfg.num_assets


def test_what_the_kernels_read_lives_as_long_as_the_manager(device: torch.device) -> None:
    """Memory freed after construction would be taken by the next tensors, and the draws would change."""
    states = []
    for fill in (False, True):
        manager, gtd, _ = make_manager(OBSTACLES, 16, device)
        gc.collect()
        litter = [torch.full((16, 44), 10**6, dtype=torch.int32, device=device) for _ in range(200)] if fill else []
        begin(manager, every(16, device))
        manager.clear_start(every(16, device), torch.zeros(16, 3, device=device))
        states.append(gtd["env_asset_state_tensor"].clone())
        del litter
    assert torch.equal(*states)


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
    """A track keeps distances of its own, to land on what pushes back one comes near it, and groups start beside walls."""
    return env.num_assets > 0 and env.track is None and env.contact is None and env.vehicle_clearance == 0.0


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
