"""Environments with obstacles and their managers, for tests."""

import torch
from torch import Tensor

from aerial_gym.assets import AssetManager, Bounds
from aerial_gym.assets.obstacle_motion import make_motion_launch
from aerial_gym.config.environment import EnvironmentCfg
from aerial_gym.math.random import Randomness
from aerial_gym.registry import GlobalTensorDictionary

CPU = torch.device("cpu")
MIDDLE = {"position_ratio_low": (0.5, 0.5, 0.5), "position_ratio_high": (0.5, 0.5, 0.5)}
ANYWHERE = {"position_ratio_low": (0.0, 0.0, 0.0), "position_ratio_high": (1.0, 1.0, 1.0)}


def box_environment(half: tuple[float, float, float], *assets: object, **fields: object) -> EnvironmentCfg:
    """Return an environment whose bounds lie half an edge [m] from the origin on each side."""
    low = tuple(-edge for edge in half)
    corners = {f"bounds_{side}_{end}": x for side, x in (("lower", low), ("upper", half)) for end in ("low", "high")}
    told = {"summary": "a test", "source": "test", "physics_steps_per_env_step": 1}
    return EnvironmentCfg(assets=assets, **told, **corners, **fields)


def make_manager(
    cfg: EnvironmentCfg, num_envs: int, device: torch.device = CPU, *, seed: int = 0, asset_state: Tensor | None = None
) -> tuple[AssetManager, GlobalTensorDictionary, tuple[Tensor, Tensor]]:
    """Return a manager before its first reset, the GTD that it fills, and the drawn bounds."""
    random = Randomness(num_envs, device=device, seed=seed)
    gtd = GlobalTensorDictionary(device=device, sizes={"E": num_envs})
    lower, upper = (torch.zeros(num_envs, 3, device=device) for _ in range(2))
    Bounds(cfg, lower=lower, upper=upper, random=random).draw(every(num_envs, device))
    place = {"num_envs": num_envs, "device": device, "random": random, "asset_state": asset_state}
    return AssetManager(cfg, gtd, bounds_min=lower, bounds_max=upper, **place), gtd, (lower, upper)


def move_obstacles(manager: AssetManager, dt: float) -> None:
    """Move the obstacles by ``dt`` [s], if any moves."""
    if manager.moving is not None:
        make_motion_launch(manager.moving, dt).launch(manager.scene.asset_state)


def every(num_envs: int, device: torch.device = CPU) -> Tensor:
    """Return the mask of all environments."""
    return torch.ones(num_envs, dtype=torch.bool, device=device)


def begin(made: AssetManager, mask: Tensor) -> None:
    made.random.begin(mask)
    made.reset(mask)
