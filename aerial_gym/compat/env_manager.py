"""The environment manager of the Aerial Gym Simulator in front of ours: ids in place of masks, flags that outlive a reset.

The simulation itself is ``EnvManager.env``, which has all rules. Letters: E environments.
"""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, NoReturn

import torch
from torch import Tensor

from aerial_gym.compat.tensors import TensorDict
from aerial_gym.env_manager import EnvManager as Simulation
from aerial_gym.errors import ConfigError, ShapeError
from aerial_gym.math.quaternion import quat_rotate_inverse

COMPONENTS = ("sensors", "viewer")  # Modes of `render`; the viewer shows nothing

_FLAGS = ("crashes", "truncations")

STAGES = ("reset_tensors", "simulate", "pre_physics_step", "physics_step", "post_physics_step", "compute_observations")
"""Stages of a step that scripts call one by one there, on the manager and on its parts."""


def _raise_missing(part: str, name: str) -> NoReturn:
    remedy = "the simulation itself is env_manager.env, its tensors are env_manager.env.gtd"
    if part == "IGE_env":
        remedy = "there is no Isaac Gym here. Tensors are in global_tensor_dict; write_to_sim() takes states"
    if name in STAGES:
        remedy = (
            "env_manager.step(actions, env_actions) does a whole step. A force on the robot is an effect of its file"
        )
    raise AttributeError(f"{part}.{name}: {remedy}. docs/guides/coming_from_aerial_gym.md has a table of names")


class Part(SimpleNamespace):
    """A part of the environment manager, with the attributes that scripts read; ``part`` is its name in messages."""

    def __getattr__(self, name: str) -> NoReturn:
        _raise_missing(self.__dict__.get("part", ""), name)


class EnvManager:
    """A simulation by the names that scripts use; made by ``SimBuilder.build_env``."""

    def __init__(
        self, env: Simulation, *, cfg: Any, sim_config: Any, robot_config: Any, reset_on_collision: bool
    ) -> None:
        self.env, self.cfg, self.sim_config = env, cfg, sim_config
        self.num_envs, self.device = env.num_envs, env.device
        self.global_tensor_dict = TensorDict(env)
        self.robot_manager = RobotManager(self, robot_config)
        self.asset_manager = Part(part="asset_manager", num_keep_in_env=env.cfg.num_kept)
        states = ("obstacle_position", "obstacle_orientation", "obstacle_linvel", "obstacle_angvel")
        tensors = {key: env.gtd[key] for key in states if key in env.gtd}
        self.obstacle_manager = Part(part="obstacle_manager", num_assets=env.cfg.num_assets, **tensors)
        self.num_robot_actions = env.robot_manager.num_actions
        self.IGE_env = Physics(env, self.global_tensor_dict)
        self.reset_on_collision = reset_on_collision

    @property
    def sim_steps(self) -> Tensor:
        """Environment steps since the last reset, int32, (E,); written in place by scripts."""
        return self.env.gtd["sim_steps"]

    def get_obs(self) -> TensorDict:
        """Return the tensor dictionary itself."""
        return self.global_tensor_dict

    def step(self, actions: Tensor, env_actions: Tensor | None = None) -> None:
        """Apply an action (E, U) for one environment step, without resets or sensor readings."""
        self.env.step(actions, env_actions)

    def reset(self) -> None:
        """Reset every environment."""
        self.env.reset()

    def reset_idx(self, env_ids: Tensor | Sequence[int]) -> None:
        """Reset the environments of some ids; ``crashes`` and ``truncations`` stay until the next step."""
        self._reset_except_flags(self.as_mask(env_ids))

    def reset_terminated_and_truncated_envs(self) -> Tensor:
        """Reset crashed (unless ``reset_on_collision`` is False) and truncated environments; return their ids, int64."""
        gtd = self.env.gtd
        mask = gtd["truncations"] | gtd["crashes"] if self.reset_on_collision else gtd["truncations"].clone()
        self._reset_except_flags(mask)
        return mask.nonzero().squeeze(-1)

    def post_reward_calculation_step(self) -> Tensor:
        """Reset finished environments, then read the sensors; return the ids, int64."""
        env_ids = self.reset_terminated_and_truncated_envs()
        self.render("sensors")
        return env_ids

    def render(self, render_components: str = "sensors") -> None:
        """Read the sensors; ``viewer`` shows nothing.

        Raises:
            ConfigError: If the component has another name, which there did nothing in silence.
        """
        if render_components not in COMPONENTS:
            raise ConfigError(f"render_components = {render_components!r}: must be one of {', '.join(COMPONENTS)}")
        if render_components == "sensors":
            self.env.render()

    def delete_env(self) -> None:
        """Release device memory; tasks of that simulator call this method, which it lacks."""
        self.env.close()

    def as_mask(self, env_ids: Tensor | Sequence[int]) -> Tensor:
        """Return the bool mask (E,) of environment ids; masks are returned unchanged."""
        ids = torch.as_tensor(env_ids, device=self.device)
        if ids.dtype == torch.bool:
            if ids.shape != (self.num_envs,):
                raise ShapeError(f"env_ids is a mask of shape {tuple(ids.shape)}, expected (E,) = ({self.num_envs},)")
            return ids
        mask = torch.zeros(self.num_envs, dtype=torch.bool, device=self.device)
        mask[ids.long()] = True
        return mask

    def _reset_except_flags(self, mask: Tensor) -> None:
        flags = [self.env.gtd[key].clone() for key in _FLAGS]
        self.env.reset(mask)
        for key, flag in zip(_FLAGS, flags, strict=True):
            self.env.gtd[key].copy_(flag)

    def __getattr__(self, name: str) -> NoReturn:
        _raise_missing("env_manager", name)


class RobotManager:
    """``robot_manager`` of that simulator."""

    def __init__(self, manager: EnvManager, config: Any) -> None:
        env = manager.env
        self._manager, self.cfg = manager, config
        imu = "imu_measurement" in env.gtd
        self.imu_sensor = SimpleNamespace(cfg=config.sensor_config.imu_config) if imu and config is not None else None
        num_actions = env.robot_manager.num_actions
        self.robot = Part(
            part="robot", cfg=config, num_actions=num_actions, controller=env.robot_manager.controller,
            controller_config=SimpleNamespace(num_actions=num_actions), robot_mass=env.gtd["robot_mass"],
            robot_inertia=env.gtd["robot_inertia"],
        )  # fmt: skip

    def reset_idx(self, env_ids: Tensor | Sequence[int]) -> None:
        """Reset the robots of some environments; the obstacles stay."""
        self._manager.env.robot_manager.reset(self._manager.as_mask(env_ids))

    def __getattr__(self, name: str) -> NoReturn:
        _raise_missing("robot_manager", name)


class Physics:
    """Replacement of ``IGE_env``, Isaac Gym's environment in that simulator."""

    def __init__(self, env: Simulation, tensors: TensorDict) -> None:
        self._env = env
        self.global_tensor_dict = tensors
        self.num_assets_per_env = env.cfg.num_assets

    def write_to_sim(self) -> None:
        """Copy the rows of ``robot_state_tensor``, (E, 13), that a script has written, into the physics."""
        gtd = self._env.gtd
        state = gtd["robot_state_tensor"]
        keys = ("robot_position", "robot_orientation", "robot_linvel", "robot_angvel")
        written = (state != torch.cat([gtd[key] for key in keys], dim=-1)).any(dim=-1, keepdim=True)
        ang_vel = quat_rotate_inverse(state[:, 3:7], state[:, 10:13])
        for key, value in (
            ("robot_position", state[:, 0:3]),
            ("robot_orientation", state[:, 3:7]),
            ("robot_linvel", state[:, 7:10]),
            ("robot_body_angvel", ang_vel),
        ):
            gtd[key].copy_(torch.where(written, value, gtd[key]))
        self._env.robot_manager.tensors.derived.refresh()

    def __getattr__(self, name: str) -> NoReturn:
        _raise_missing("IGE_env", name)
