"""Tasks as environments of Gymnasium 0.29 and 1: many in ``GymnasiumVectorEnv``, one in ``GymnasiumEnv``.

Gymnasium makes them by their id (``task.gymnasium_ids``). What a vector environment says of ended episodes has the form
of the installed version, as its own ``VectorEnv._add_info`` writes it.
Letters: E environments, O entries of an observation, U entries of an action.
"""

import os
import secrets
from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar, Literal

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from torch import Tensor

from aerial_gym.errors import ConfigError, ShapeError
from aerial_gym.task import Task, task_registry
from aerial_gym.task.chase_view import ChaseView

FINAL = "final_observation" if gymnasium.__version__.startswith("0.") else "final_obs"
"""Key of the last observations of episodes that ended."""

AUTORESET = "same_step" if FINAL == "final_observation" else "next_step"
"""When Gymnasium's own vector environments, in the installed version, reset an ended environment: in the step of the end, or
in the next one, which ignores the action."""

CHOICES = {
    "output": ("numpy", "torch"), "autoreset_mode": ("same_step", "next_step"), "render_mode": (None, "rgb_array"),
}  # fmt: skip
"""Values of arguments."""

_PROCESS = os.getpid()  # The process that imported torch

Array = Tensor | NDArray[Any]  # A torch tensor or a NumPy array
Observation = Array | dict[str, Array]  # By key, of a task with images


class GymnasiumVectorEnv(gymnasium.vector.VectorEnv):
    """E environments of one task; observations are its (E, O) tensor, or NumPy arrays, with its images if it has any."""

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"]}  # pyright: ignore[reportIncompatibleVariableOverride]

    def __init__(
        self, task: Task, *, output: Literal["numpy", "torch"] = "numpy", autoreset_mode: object = AUTORESET,
        render_mode: str | None = None,
    ) -> None:  # fmt: skip
        """Take a built task that was not yet reset; actions may be tensors or arrays, for either output.

        Args:
            task: Closed with this environment.
            output: ``numpy`` or ``torch``.
            autoreset_mode: ``same_step``, ``next_step``, or ``gymnasium.vector.AutoresetMode`` of that name; if not given,
                that of Gymnasium's own vector environments: ``same_step`` in 0.29, ``next_step`` in 1.
            render_mode: ``rgb_array``: ``render`` returns a picture of each environment.

        Raises:
            ConfigError: If an argument has another value.
            MissingDependencyError: If pictures are asked for, and Pillow is not installed.
        """
        reset = str(getattr(autoreset_mode, "name", autoreset_mode)).lower()
        given = {"output": output, "autoreset_mode": reset, "render_mode": render_mode}
        wrong = [name for name, value in given.items() if value not in CHOICES[name]]
        if wrong:
            rules = (f"{name} = {given[name]!r}: must be {' or '.join(map(str, CHOICES[name]))}" for name in wrong)
            raise ConfigError("; ".join(f"GymnasiumVectorEnv.{rule}" for rule in rules))
        self.task, self._torch_out, self._final_apart = task, output == "torch", reset == "same_step"
        if not self._final_apart:
            task.delay_resets()
        dictionary = task.observation_space
        self._images = tuple(key for key, space in dictionary.items() if len(space.shape or ()) == 3)
        seen = {key: dictionary[key] for key in ("observations", *self._images)}
        # Set here and not by the base class: its constructor differs between Gymnasium 0.29 and 1.
        self.num_envs, self.is_vector_env, self.closed = task.num_envs, True, False
        self.viewer, self.spec, self.render_mode = None, None, render_mode
        self.single_observation_space = spaces.Dict(seen) if self._images else seen["observations"]
        self.single_action_space = task.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.metadata = {**type(self).metadata, "render_fps": round(1.0 / task.env.dt)}  # pyright: ignore[reportAttributeAccessIssue]
        if modes := getattr(gymnasium.vector, "AutoresetMode", None):
            self.metadata["autoreset_mode"] = modes[reset.upper()]
        self._view = None if render_mode is None else ChaseView(task, task.num_envs)

    def reset(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Restart every episode, with a new seed if given; return observations and an empty info."""
        observation, _ = self.task.reset(seed=seed)
        self._follow(torch.ones_like(self.task.env.random.mask))
        return self._output(observation), {}

    def step(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, actions: Array
    ) -> tuple[Observation, Array, Array, Array, dict[str, Any]]:
        """Advance by actions (E, U); return observations, rewards (E,), terminated, truncated (E,) bool, info."""
        observation, reward, terminated, truncated, info = self.task.step(self._action_tensor(actions))
        self._follow(self.task.env.random.mask)
        done = terminated | truncated
        told = self._torch_info(info, done) if self._torch_out else self._numpy_info(info, done)
        first, second, third = (self._output_array(value) for value in (reward, terminated, truncated))
        return self._output(observation), first, second, third, told

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return a picture of each environment, (270, 480, 3); None without a render mode."""
        return None if self._view is None else tuple(np.asarray(each) for each in self._view.pictures())

    def _follow(self, begins: Tensor) -> None:
        if self._view is not None:
            self._view.follow(begins)

    def _action_tensor(self, actions: Array) -> Tensor:
        given = torch.as_tensor(actions, dtype=torch.float32, device=self.task.device)
        expected = self.action_space.shape
        if tuple(given.shape) != expected:
            raise ShapeError(f"actions has shape {tuple(given.shape)}, expected (E, U) = {expected}")
        return given

    def _output_array(self, value: Tensor) -> Array:
        return value if self._torch_out else value.to("cpu", copy=True).numpy()  # the next step may write into it

    def _output(self, tensors: dict[str, Tensor], prefix: str = "") -> Observation:
        """Return the observations of a dictionary, whose keys have a prefix."""
        vector = self._output_array(tensors[f"{prefix}observation{'' if prefix else 's'}"])
        images = {key: self._output_array(tensors[prefix + key]) for key in self._images}
        return {"observations": vector, **images} if images else vector

    def _torch_info(self, info: dict[str, Tensor], done: Tensor) -> dict[str, Any]:
        """Return tensors over all rows, valid only within the masks. Nothing is copied to the host."""
        told: dict[str, Any] = {"time_outs": info["time_outs"], "is_success": info["successes"], "_is_success": done}
        if self._final_apart:
            episode = {"r": info["episode_return"], "l": info["episode_length"]}
            told |= {FINAL: self._output(info, "final_"), f"_{FINAL}": done, "final_info": {"episode": episode}}
            told["_final_info"] = done
        return told

    def _numpy_info(self, info: dict[str, Tensor], done: Tensor) -> dict[str, Any]:
        """Return ``time_outs`` of all rows, and of those that ended their success, last observation and last info."""
        every = np.ones(self.num_envs, dtype=bool)
        told: dict[str, Any] = {"time_outs": info["time_outs"].cpu().numpy(), "_time_outs": every}
        rows = np.flatnonzero(done.cpu().numpy())
        if not len(rows):
            return told
        success, total, length = (
            info[name].cpu().numpy() for name in ("successes", "episode_return", "episode_length")
        )
        last = self._output(info, "final_") if self._final_apart else None
        for row in rows:
            own: dict[str, Any] = {"is_success": bool(success[row])}
            if last is not None:
                own["episode"] = {"r": float(total[row]), "l": int(length[row])}
                shown = {key: value[row] for key, value in last.items()} if isinstance(last, dict) else last[row]
                own = {FINAL: shown, "final_info": own}
            told = self._add_info(told, own, int(row))
        return told

    def close_extras(self, **kwargs: object) -> None:
        """Release the simulation; called by ``close``."""
        self.task.close()


class GymnasiumEnv(gymnasium.Env[Any, NDArray[np.float32]]):
    """One environment of a task; an episode that ended stays at its end until ``reset``."""

    metadata: ClassVar[dict[str, Any]] = GymnasiumVectorEnv.metadata  # pyright: ignore[reportIncompatibleVariableOverride]

    def __init__(self, task: Task, *, render_mode: str | None = None) -> None:
        """Take a built task of one environment that was not yet reset; see ``GymnasiumVectorEnv``."""
        if task.num_envs != 1:
            raise ConfigError(f"GymnasiumEnv: num_envs = {task.num_envs}: must be 1. Use GymnasiumVectorEnv for more")
        self._batch = GymnasiumVectorEnv(task, autoreset_mode="next_step", render_mode=render_mode)
        self.task, self.render_mode = task, render_mode
        self.metadata = {key: value for key, value in self._batch.metadata.items() if key != "autoreset_mode"}  # pyright: ignore[reportAttributeAccessIssue]
        self.observation_space = self._batch.single_observation_space
        self.action_space = self._batch.single_action_space  # pyright: ignore[reportAttributeAccessIssue]

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode, with a new seed if given; return its observation and an empty info."""
        super().reset(seed=seed)
        observation, _ = self._batch.reset(seed=seed)
        return _first_row(observation), {}

    def step(self, action: NDArray[np.float32]) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Advance by an action (U,); return observation, reward, terminated, truncated, info."""
        given = np.asarray(action)[None]
        observation, reward, terminated, truncated, info = self._batch.step(given)
        told = {key: bool(value[0]) for key, value in info.items() if not key.startswith("_")}
        return _first_row(observation), float(reward[0]), bool(terminated[0]), bool(truncated[0]), told

    def render(self) -> NDArray[np.uint8] | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return a picture, (270, 480, 3); None without a render mode."""
        pictures = self._batch.render()
        return None if pictures is None else pictures[0]

    def close(self) -> None:
        """Release the simulation."""
        self._batch.close()


def _first_row(observation: Observation) -> Any:
    return {key: value[0] for key, value in observation.items()} if isinstance(observation, dict) else observation[0]


def _make_single(
    name: str, *, seed: int | None = None, device: str = "cpu", render_mode: str | None = None, **options: Any
) -> GymnasiumEnv:
    """Return one environment of a task; a single one is fastest on the CPU. Without a seed, draw one."""
    if (
        os.getpid() != _PROCESS
    ):  # a fork of AsyncVectorEnv: it has no threads of OpenMP, and would wait for them for ever
        torch.set_num_threads(1)
    chosen = secrets.randbelow(2**31) if seed is None else seed
    task = task_registry.make_task(name, num_envs=1, seed=chosen, device=device, **options)
    return GymnasiumEnv(task, render_mode=render_mode)


def _make_vector(
    name: str, *, num_envs: int = 1, seed: int | None = None, max_episode_steps: int | None = None,
    output: Literal["numpy", "torch"] = "numpy", autoreset_mode: object = AUTORESET, render_mode: str | None = None,
    **options: Any,
) -> GymnasiumVectorEnv:  # fmt: skip
    """Return many environments of a task. Without a seed, draw one."""
    if max_episode_steps is not None:
        rule = "the task says how long its episodes are. Change episode_len_steps in a task file of your own"
        raise ConfigError(f"max_episode_steps = {max_episode_steps}: {rule}")
    chosen = secrets.randbelow(2**31) if seed is None else seed
    task = task_registry.make_task(name, num_envs=num_envs, seed=chosen, **options)
    return GymnasiumVectorEnv(task, output=output, autoreset_mode=autoreset_mode, render_mode=render_mode)


def __getattr__(name: str) -> Callable[..., gymnasium.Env[Any, Any]]:
    """Return the function that makes the environments of a task for Gymnasium: ``single.NAME`` or ``vector.NAME``."""
    kind, _, task = name.partition(".")
    if not task:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    creator = partial({"single": _make_single, "vector": _make_vector}[kind], task)
    creator.metadata = GymnasiumVectorEnv.metadata  # pyright: ignore[reportAttributeAccessIssue]
    return creator  # pyright: ignore[reportReturnType]
