"""The asset manager: who stands where after a reset, who does not, and who is left alone."""

import gc
import subprocess
import sys
from dataclasses import replace
from math import pi

import pytest
import torch

from aerial_gym.assets import ENVIRONMENTS, PARKED_Z
from aerial_gym.config.environment import AssetCfg, ShapeCfg
from aerial_gym.errors import ConfigError, ShapeError
from aerial_gym.math.quaternion import euler_from_quat
from aerial_gym.sensors import MISS_ID, SENSORS, SensorManager
from tests.unit.assets.managers import ANYWHERE, begin, every, make_manager

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


def test_walls_close_the_room_for_a_camera_in_the_middle(device: torch.device) -> None:
    manager, gtd, (lower, upper) = make_manager(OBSTACLES, 8, device)
    manager.set_num_obstacles(0)
    begin(manager, every(8, device))
    attitude = torch.tensor([0.0, 0.0, 0.0, 1.0], device=device).repeat(8, 1)
    camera = {"camera": replace(SENSORS.get("depth_camera_64"), max_range=20.0, min_range=0.0)}
    place = {"position": 0.5 * (lower + upper), "attitude": attitude, "num_envs": 8, "device": device}
    sensors = SensorManager(camera, gtd, manager.scene, **place)
    sensors.capture()
    ids = gtd["segmentation_pixels"]
    assert (ids != MISS_ID).all()
    assert (ids == 9).flatten(1).any(dim=1).all()
    assert (ids != 10).all()


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


def test_environments_of_different_sizes_live_side_by_side(device: torch.device) -> None:
    empty, empty_gtd, _ = make_manager(ENVIRONMENTS.get("empty_env"), 4, device)
    small, small_gtd, _ = make_manager(OBSTACLES, 2, device)
    large, large_gtd, _ = make_manager(OBSTACLES, 7, device)
    for manager, size in ((empty, 4), (small, 2), (large, 7)):
        begin(manager, every(size, device))
    before = small_gtd["env_asset_state_tensor"].clone()
    large.reset(every(7, device))
    empty.set_num_obstacles(0)
    assert torch.equal(small_gtd["env_asset_state_tensor"], before)
    assert empty_gtd["env_asset_state_tensor"].shape == (4, 0, 13)
    assert large_gtd["env_asset_state_tensor"].shape == (7, 44, 13)


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
