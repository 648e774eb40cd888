"""The asset manager: obstacles of every environment, their placement at reset, and the scene made of them.

Frames: world of each environment, z up. Letters: E environments, A instances.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from aerial_gym.assets.families import assets_with_family_shapes
from aerial_gym.assets.obstacles import asset_table, view_obstacles
from aerial_gym.assets.placement import Placement, draw_kinds
from aerial_gym.assets.scene import PARKED_Z, Scene, VisibleVehicle
from aerial_gym.assets.scene_arrays import check_tensor
from aerial_gym.config.environment import FIRST_INSTANCE_ID, EnvironmentCfg, PartCfg
from aerial_gym.errors import ConfigError, ShapeError
from aerial_gym.interop import ReusableLaunch, plain_device, with_usual_settings
from aerial_gym.math.random import Randomness, copy_mask
from aerial_gym.registry import GlobalTensorDictionary, TensorSpec

if TYPE_CHECKING:
    from aerial_gym.assets.clearance import Clearance
    from aerial_gym.assets.height_probe import HeightProbe
    from aerial_gym.assets.track import TrackPlacement

_OWNER = "AssetManager"


@with_usual_settings
class AssetManager:
    """Obstacle states of all environments. Kept assets have the first rows; the others follow, shuffled in each environment."""

    _twists: "ReusableLaunch | None" = None
    clearance: "Clearance | None" = None
    """Clear space around starts and goals; None without ``cfg.clearance``."""

    def __init__(
        self, cfg: EnvironmentCfg, gtd: GlobalTensorDictionary, *, num_envs: int, device: torch.device,
        random: Randomness, bounds_min: Tensor, bounds_max: Tensor, asset_state: Tensor | None = None,
        robot_radius: float = 0.0, vehicles: Sequence[VisibleVehicle] = (), link_state: Tensor | None = None,
    ) -> None:  # fmt: skip
        """Draw the obstacles of each environment, build the scene and park everything until the first reset.

        Args:
            bounds_min: Lower corner of the bounds [m], world, (E, 3); read at every reset.
            bounds_max: Upper corner [m], world, (E, 3).
            asset_state: Memory for the obstacle states, float32, (E, A, 13); allocated if not given.
            robot_radius: Radius of the robot about its origin [m]; ``cfg.clearance`` is added to it.
            vehicles: The vehicles of every environment as sensors see them, one if not given.
            link_state: States of their links, vehicle by vehicle, float32, (E, L, 13), or (E, 13) of one link; needed for
                visible parts.

        Raises:
            ConfigError: If a mesh or URDF file cannot be used.
            UnknownNameError: If there is no such family of shapes.
            ShapeError: If a tensor does not fit.
        """
        self.cfg, self.num_assets = cfg, cfg.num_assets
        self._num_envs, self._device = num_envs, plain_device(device)
        for name, corner in (("bounds_min", bounds_min), ("bounds_max", bounds_max)):
            check_tensor(name, corner, (num_envs, 3), device=self._device)
        self._assets = assets_with_family_shapes(cfg.assets)
        self._declare(gtd, asset_state)
        self.random = random
        self._asset = torch.zeros(num_envs, self.num_assets, dtype=torch.int32, device=self._device)
        shape_index, semantic_id = self._draw_kinds()
        self.scene = Scene(
            [shape for a in self._assets for shape in a.shapes],
            shape_index=shape_index,
            semantic_id=semantic_id,
            groups=[(a.count, len(a.shapes)) for a in self._assets],
            asset_state=self._state,
            fixed=() if cfg.ground_part is None else (cfg.ground_part,),
            vehicles=vehicles,
            link_state=link_state,
            lamps=cfg.lamps,
        )
        obstacles = view_obstacles(
            self._state, self._waypoints, table=asset_table(self._assets, device=self._device), asset=self._asset,
            bounds=(bounds_min, bounds_max), random=random,
        )  # fmt: skip
        self._placement: Placement | None = None
        if self.num_assets:
            self._placement = Placement(
                obstacles, mask=random.mask, num_kept=cfg.num_kept, num_others=self._num_obstacles
            )
        self.obstacles = obstacles
        """The obstacles as kernels see them."""
        self._track: TrackPlacement | None = None
        self.moving = obstacles if cfg.moves else None
        """The obstacles as kernels see them, where an asset moves."""
        if cfg.moves:  # local imports, as Warp functions take long to import
            from aerial_gym.assets.obstacle_motion import make_twist_launch

            self._twists = make_twist_launch(obstacles, self._env_actions)
        if cfg.clearance > 0.0 and self.num_assets > 0:
            from aerial_gym.assets.clearance import Clearance

            room = cfg.clearance + robot_radius
            count = max(1, len(vehicles))
            self.clearance = Clearance(self.scene, obstacles, mask=random.mask, room=room, num_robots=count)
        self.set_num_obstacles(self.num_assets - cfg.num_kept)
        self._park_all()

    def make_scene_for_pictures(
        self, count: int, *, fixed: Sequence[PartCfg], vehicle: VisibleVehicle, link_state: Tensor
    ) -> Scene:
        """Return a scene of the first ``count`` environments with other fixed parts and a visible robot.

        It shares the poses. Neither physics nor sensors see it.
        """
        return Scene(
            [shape for a in self._assets for shape in a.shapes], shape_index=self.scene.shape_index[:count],
            semantic_id=self.scene.semantic_id[:count], asset_state=self._state[:count], fixed=fixed,
            vehicles=(vehicle,), link_state=link_state[:count], lamps=self.cfg.lamps,
        )  # fmt: skip

    def restart(self) -> None:
        """Draw the obstacles of each environment for a new seed, and park all of them until the next reset."""
        self.draw_kinds()
        self._park_all()

    def draw_kinds(self) -> None:
        """Draw the asset and shape of every instance from the seed."""
        self.scene.relabel(*self._draw_kinds())
        if self.clearance is not None:
            self.clearance.update_part_ranges()

    def set_num_obstacles(self, count: int) -> None:
        """Set the number of removable assets from the next reset on, the rest is parked; raise ``ConfigError`` for too many."""
        removable = self.num_assets - self.cfg.num_kept
        if not 0 <= count <= removable:
            raise ConfigError(f"num_obstacles = {count}: this environment has 0 to {removable} removable obstacles")
        self._num_obstacles.fill_(count)

    def take_num_obstacles(self, count: Tensor) -> None:
        """Set the number of removable assets from an integer tensor (1,) on the device, without a check of its range."""
        self._num_obstacles.copy_(count)

    def reset(self, mask: Tensor) -> None:
        """Draw places and twists of obstacles in the environments of ``mask``, bool (E,); all other rows keep their bits."""
        if self._placement is None:
            return
        check_tensor("mask", mask, (self._num_envs,), device=self._device, dtype=torch.bool)
        copy_mask(self.random.mask, mask)
        self._placement.draw()
        if self._twists is not None:
            self._env_actions.masked_fill_(mask[:, None, None], 0.0)
            self._prev_env_actions.masked_fill_(mask[:, None, None], 0.0)

    def take_actions(self, env_actions: Tensor) -> None:
        """Set the twists of moving obstacles, and keep the previous ones in ``prev_env_actions``.

        Args:
            env_actions: Velocity [m/s] and angular velocity [rad/s], world, (E, A, 6); rows of all other obstacles are ignored.
        """
        if self._twists is None:
            raise ConfigError("env_actions: no obstacle of this environment moves. Give an asset motion: {kind: twist}")
        shape = tuple(self._env_actions.shape)
        if tuple(env_actions.shape) != shape:
            raise ShapeError(f"env_actions has shape {tuple(env_actions.shape)}, expected (E, A, 6) = {shape}")
        self._prev_env_actions.copy_(self._env_actions)
        self._env_actions.copy_(env_actions)
        self._twists.launch(self._env_actions)

    def set_track_start(self, start: Tensor) -> None:
        """Set the start positions of robots [m], world, (E, 3), for the race tracks of ``place_track``."""
        if self.cfg.track is not None:
            from aerial_gym.assets.track import TrackPlacement

            self._track = TrackPlacement(
                self.cfg.track, self.obstacles, nominal=self._places[:3], places=self._places[3:], start=start,
                random=self.random,
            )  # fmt: skip

    def place_track(self, mask: Tensor) -> None:
        """Draw gates and poles in the environments of ``mask``, bool (E,), after ``reset`` and the robot's start."""
        if self._track is not None:
            copy_mask(self.random.mask, mask)
            self._track.draw()

    def make_height_probe(self, position: Tensor, *, height_out: Tensor) -> "HeightProbe":
        """Return the probe that writes the height of the surface below positions (B, 3) to ``height_out`` (B, 1) [m], world."""
        from aerial_gym.assets.height_probe import HeightProbe

        return HeightProbe(self.scene, position=position, height_out=height_out)

    def clear_start(self, mask: Tensor, position: Tensor) -> None:
        """Redraw, or park, obstacles too close to origins of robots [m], (E, V, 3), in the environments of ``mask``, bool (E,).

        Afterwards every obstacle with a drawn place is at least ``cfg.clearance`` from all robots. Call it after ``reset``.
        """
        if self.clearance is not None:
            from aerial_gym.assets.clearance import START

            self.clearance.clear(mask, position, point_index=START)

    def clear_goal(self, mask: Tensor, position: Tensor) -> None:
        """Clear the surroundings of goals [m], world, (E, V, 3), likewise; those of the starts stay clear."""
        if self.clearance is not None:
            from aerial_gym.assets.clearance import GOAL

            self.clearance.clear(mask, position, point_index=GOAL)

    def _declare(self, gtd: GlobalTensorDictionary, asset_state: Tensor | None) -> None:
        gtd.define_size("A", self.num_assets)

        def declare(
            key: str, shape: tuple[str | int, ...], unit: str, meaning: str, view: Tensor | None = None
        ) -> Tensor:
            spec = TensorSpec(key=key, shape=shape, unit=unit, frame="world", owner=_OWNER, meaning=meaning)
            return gtd.declare(spec, view=view)

        unit, meaning = "m, -, m/s, rad/s", "obstacle p, q xyzw, v, w"
        state = self._state = declare("env_asset_state_tensor", ("E", "A", 13), unit, meaning, asset_state)
        declare("obstacle_position", ("E", "A", 3), "m", "origin of each shape; z < -500: absent", state[..., 0:3])
        declare("obstacle_orientation", ("E", "A", 4), "-", "shape to world, xyzw", state[..., 3:7])
        declare("obstacle_linvel", ("E", "A", 3), "m/s", "velocity of the origin", state[..., 7:10])
        declare("obstacle_angvel", ("E", "A", 3), "rad/s", "angular velocity", state[..., 10:13])
        self._places: list[Tensor] = []
        if self.cfg.track is not None:
            gtd.define_size("G", len(self.cfg.track.gates))
            gtd.define_size("P", len(self.cfg.track.poles))
            for key, shape, unit, meaning in (
                ("gate_nominal_position", ("E", "G", 3), "m", "where the middle of each gate's opening is nominally"),
                ("gate_nominal_orientation", ("E", "G", 4), "-", "how each gate stands nominally, to world, xyzw"),
                ("pole_nominal_position", ("E", "P", 3), "m", "where the top of each pole is nominally"),
                ("gate_position", ("E", "G", 3), "m", "middle of each gate's opening"),
                ("gate_orientation", ("E", "G", 4), "-", "gate to world, xyzw"),
                ("pole_position", ("E", "P", 3), "m", "top of each pole"),
            ):
                self._places.append(declare(key, shape, unit, meaning))
        self._num_obstacles = gtd.declare(TensorSpec(
            key="num_obstacles_in_env", shape=(1,), unit="-", frame="-", owner=_OWNER, dtype=torch.int32,
            meaning="assets not always kept that the next reset places",
        ))  # fmt: skip
        if self.cfg.moves:
            unit, meaning = "m/s, rad/s", "twist v, w asked for, of obstacles that move by twist"
            self._env_actions = declare("env_actions", ("E", "A", 6), unit, meaning)
            self._prev_env_actions = declare("prev_env_actions", ("E", "A", 6), unit, f"{meaning}, before")
        self._waypoints = torch.zeros(0, 0, 2, 3, device=self._device)
        if any(asset.motion.kind == "waypoints" for asset in self.cfg.assets):
            meaning = "ends of the path of obstacles with waypoints"
            self._waypoints = declare("obstacle_waypoints", ("E", "A", 2, 3), "m", meaning)

    def _draw_kinds(self) -> tuple[Tensor, Tensor]:
        """Draw the asset of each instance; return its row of the shape table and its semantic id, int64, each (E, A)."""
        assets, device = self._assets, self._device
        if not assets:
            return self._asset.long(), self._asset.long()
        asset, choice = draw_kinds(assets, self.random)
        self._asset.copy_(asset)
        counts = torch.tensor([len(a.shapes) for a in assets], device=device, dtype=torch.int64)
        first = counts.cumsum(0) - counts
        semantic = torch.tensor([a.semantic_id for a in assets], device=device, dtype=torch.int64)[asset]
        own = FIRST_INSTANCE_ID + torch.arange(self.num_assets, device=device)
        return first[asset] + choice, torch.where(semantic >= 0, semantic, own)

    def _park_all(self) -> None:
        self._state.zero_()
        self._state[..., 2] = PARKED_Z
        self._state[..., 6] = 1.0
