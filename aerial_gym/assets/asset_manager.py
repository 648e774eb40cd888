"""The asset manager: obstacles of every environment, their placement at reset, and the scene made of them.

Frames: world of each environment, z up. Letters: E environments, A instances.
"""

import torch
from torch import Tensor

from aerial_gym.assets.placement import draw_kinds, draw_states, placement_ranges
from aerial_gym.assets.scene import PARKED_Z, Scene
from aerial_gym.assets.views import check_tensor
from aerial_gym.config.environment import FIRST_INSTANCE_ID, EnvironmentCfg
from aerial_gym.errors import ConfigError
from aerial_gym.registry import GlobalTensorDictionary, TensorSpec

_OWNER = "AssetManager"


class AssetManager:
    """Owns the obstacle states. Rows are kept assets first, then the others, shuffled in each environment."""

    def __init__(
        self,
        cfg: EnvironmentCfg,
        gtd: GlobalTensorDictionary,
        *,
        num_envs: int,
        device: torch.device,
        generator: torch.Generator,
        bounds_min: Tensor,
        bounds_max: Tensor,
        asset_state: Tensor | None = None,
    ) -> None:
        """Draw which obstacles each environment has, build the scene and park everything until the first reset.

        Args:
            cfg: What stands in an environment.
            gtd: Receives this manager's keys.
            num_envs: Number of environments E.
            device: Where the tensors are.
            generator: Source of all draws, on that device; kept.
            bounds_min: Lower corner of the bounds [m], world, (E, 3); read at every reset.
            bounds_max: Upper corner [m], world, (E, 3).
            asset_state: Memory for the obstacle states, float32, (E, A, 13); allocated if not given.

        Raises:
            ConfigError: If a mesh file cannot be used.
            ShapeError: If a tensor does not fit.
        """
        self.cfg, self.num_assets = cfg, cfg.num_assets
        self._num_envs, self._device, self._generator = num_envs, torch.device(device), generator
        for name, corner in (("bounds_min", bounds_min), ("bounds_max", bounds_max)):
            check_tensor(name, corner, (num_envs, 3), device=self._device)
        self._bounds_min, self._bounds_max = bounds_min, bounds_max
        self._declare(gtd, asset_state)
        asset, choice = draw_kinds(cfg.assets, num_envs=num_envs, generator=generator)
        self._ranges = placement_ranges(cfg.assets, asset, device=self._device)
        self._rank = torch.arange(self.num_assets, device=self._device)
        self.scene = self._build_scene(asset, choice)
        self.set_num_obstacles(self.num_assets - cfg.num_kept)
        self._park_all()

    def set_num_obstacles(self, count: int) -> None:
        """Make ``count`` of the assets that are not kept present from the next reset on; the rest will be parked.

        Raises:
            ConfigError: If there are not that many.
        """
        removable = self.num_assets - self.cfg.num_kept
        if not 0 <= count <= removable:
            raise ConfigError(
                f"num_obstacles = {count}: this environment has 0 to {removable} that are not always kept"
            )
        self._num_obstacles.fill_(count)

    def reset(self, mask: Tensor) -> None:
        """Place the obstacles of masked environments anew and at rest; other rows are bit-for-bit untouched.

        Args:
            mask: Environments to reset, bool, (E,).
        """
        check_tensor("mask", mask, (self._num_envs,), device=self._device, dtype=torch.bool)
        placed = draw_states(self._ranges, self._bounds_min, self._bounds_max, generator=self._generator)
        present = self._rank < self.cfg.num_kept + self._num_obstacles
        placed[..., 2] = torch.where(present, placed[..., 2], PARKED_Z)
        self._state.copy_(torch.where(mask[:, None, None], placed, self._state))

    def _declare(self, gtd: GlobalTensorDictionary, asset_state: Tensor | None) -> None:
        gtd.define_size("A", self.num_assets)

        def declare(
            key: str, shape: tuple[str | int, ...], unit: str, meaning: str, view: Tensor | None, dtype: torch.dtype
        ) -> Tensor:
            frame = "-" if dtype == torch.int32 else "world"
            spec = TensorSpec(key=key, shape=shape, unit=unit, frame=frame, owner=_OWNER, meaning=meaning, dtype=dtype)
            return gtd.declare(spec, view=view)

        real = torch.float32
        state = declare(
            "env_asset_state_tensor", ("E", "A", 13), "m, -, m/s, rad/s", "obstacle p, q xyzw, v, w", asset_state, real
        )
        self._state = state
        declare(
            "obstacle_position", ("E", "A", 3), "m", "origin of each shape; z < -500: absent", state[..., 0:3], real
        )
        declare("obstacle_orientation", ("E", "A", 4), "-", "shape to world, xyzw", state[..., 3:7], real)
        declare("obstacle_linvel", ("E", "A", 3), "m/s", "velocity of the origin", state[..., 7:10], real)
        declare("obstacle_angvel", ("E", "A", 3), "rad/s", "angular velocity", state[..., 10:13], real)
        self._num_obstacles = declare(
            "num_obstacles_in_env", (1,), "-", "assets not always kept that the next reset places", None, torch.int32
        )

    def _build_scene(self, asset: Tensor, choice: Tensor) -> Scene:
        assets, device = self.cfg.assets, self._device
        counts = torch.tensor([len(a.shapes) for a in assets], device=device, dtype=torch.int64)
        first = counts.cumsum(0) - counts
        semantic = torch.tensor([a.semantic_id for a in assets], device=device, dtype=torch.int64)[asset]
        return Scene(
            [shape for a in assets for shape in a.shapes],
            shape_index=first[asset] + choice,
            semantic_id=torch.where(semantic >= 0, semantic, FIRST_INSTANCE_ID + self._rank),
            asset_state=self._state,
        )

    def _park_all(self) -> None:
        self._state.zero_()
        self._state[..., 2] = PARKED_Z
        self._state[..., 6] = 1.0
