"""Starts of several vehicles, kept apart by ``robots.start_separation``.

Letters: E environments, T vehicles of an environment over all kinds, N = E T rows over all kinds.
"""

from collections.abc import Sequence
from typing import Any

import torch
import warp as wp
from torch import Tensor

from aerial_gym.assets import AssetManager
from aerial_gym.assets.vehicle_collision import SlotTable
from aerial_gym.config.environment import EnvironmentCfg
from aerial_gym.env_manager.vehicle_group import VehicleGroup, VehicleKind
from aerial_gym.errors import ConfigError
from aerial_gym.interop import ReusableLaunch, make_struct
from aerial_gym.math.draws import random_arrays
from aerial_gym.robots.start_separation import ObstacleDraws, StartRanges, separate_starts


class VehicleStarts:
    """Separates the starts of all vehicles, one launch for each kind; all views are made at construction."""

    def __init__(
        self, slots: SlotTable, groups: Sequence[VehicleGroup], env: EnvironmentCfg, assets: AssetManager, *,
        states: Tensor, starts: Tensor, keeps_obstacles: Tensor,
    ) -> None:  # fmt: skip
        """Take views of the tensors, which must stay where they are; raise ``ConfigError`` if starts have no room.

        Args:
            states: Position of all vehicles first [m], world, (N, 13).
            starts: Vehicles that start, bool, (E, T); read at every call.
            keeps_obstacles: Environments whose obstacles stay, bool, (E,); likewise.
        """
        none = torch.zeros(slots.num_envs, 0, dtype=torch.int32, device=states.device)
        parts = (none, none) if assets.clearance is None else (assets.clearance.first_part, assets.clearance.end_part)
        around = make_struct(
            ObstacleDraws, scene=assets.scene.arrays, obstacles=assets.obstacles, first_part=parts[0],
            end_part=parts[1],
        )  # fmt: skip
        kernel: Any = separate_starts
        self._like, table, self._launches = states, slots.array(states.device), list[ReusableLaunch]()
        for kind, (group, hull) in enumerate(zip(groups, slots.hulls, strict=True)):
            _check_room(group.kind, env, distance=2.0 * hull + env.vehicle_clearance)
            cfg, (low, high) = group.kind.robot.initial_state, group.bounds
            ranges = make_struct(
                StartRanges, random=random_arrays(group.random), ratio_low=wp.vec3(*cfg.position_ratio_low),
                ratio_high=wp.vec3(*cfg.position_ratio_high), bounds_min=low, bounds_max=high,
                room=env.vehicle_clearance, obstacle_room=env.clearance + hull,
            )  # fmt: skip
            inputs = [starts, table, slots.first_slot(kind), group.kind.count, ranges, around, keeps_obstacles]
            outputs = [states, group.robot_manager.tensors.state.position]
            launch: dict[str, Any] = {
                "dim": slots.num_envs,
                "inputs": inputs,
                "outputs": outputs,
                "device": states.device,
            }
            self._launches.append(ReusableLaunch(kernel, **launch))

    def separate(self) -> None:
        """Move the starts that are too close; launched on torch's current stream, not waited for."""
        for launch in self._launches:
            launch.launch(self._like)


def _check_room(kind: VehicleKind, env: EnvironmentCfg, *, distance: float) -> None:
    """Raise ``ConfigError`` if a grid with this distance [m] has too few points for the starts in the smallest bounds."""
    low, high = (torch.tensor(corner) for corner in (env.bounds_lower_high, env.bounds_upper_low))
    start = kind.robot.initial_state
    edges = (high - low) * (torch.tensor(start.position_ratio_high) - torch.tensor(start.position_ratio_low))
    places = int((edges / distance + 1e-6).floor().add(1.0).prod()) if distance > 0.0 else kind.count
    if places < kind.count:
        raise ConfigError(
            f"robots: {kind.count} vehicles of {kind.name} need {distance:.3g} m from origin to origin, and their starts lie "
            f"in {' x '.join(f'{edge:.3g}' for edge in edges.tolist())} m: there is room for about {places}. Give the robot a "
            "wider initial_state, wider bounds, less vehicle_clearance or fewer vehicles"
        )
