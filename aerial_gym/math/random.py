"""Counter-based random numbers: functions of (seed, environment, episode, purpose[, index or step]), equal to those in kernels.

No draw changes a state. So environments do not affect each other, equal counters repeat a draw, and a captured step draws new
numbers because the device counts the episodes.
Letters: E environments, or vehicles of all environments (``of_bodies``).
"""

from copy import copy
from enum import IntEnum
from math import pi
from typing import TypeVar

import torch
from torch import Tensor

Word = TypeVar("Word", int, Tensor)  # 32 bits in an int, or in each element of an int64 tensor


class Purpose(IntEnum):
    """Purpose of a draw. Each purpose has its own streams; a new one gets a new line and a new number."""

    BOUNDS = 1  # Corners of an environment; index: corner
    ASSETS = 2  # Order of the removable obstacles; index: obstacle. Drawn once per seed, in episode 0.
    SHAPES = 3  # Shape of an obstacle; index: obstacle. Drawn once per seed, in episode 0.
    OBSTACLES = 4  # Poses, twists and paths; indices: obstacle, attempt, quantity
    START = 5  # The robot's state; index: quantity
    GOAL = 6  # The task's goal; index: quantity
    PARAMETERS = 7  # Randomised quantities of vehicle and controller; index: quantity
    MOUNTS = 9  # Mounts of the range sensors; indices: sensor, mount, quantity
    IMAGE_NOISE = 10  # Noise of the range sensors; indices: sensor, image, pixel
    IMU = 11  # Errors and mounts of inertial sensors; indices: unit, sample, quantity
    EFFECTS = 12  # Random effects; indices: substep, quantity
    OBSERVATION = 13  # Noise of observations; indices: step, column
    FINAL_OBSERVATION = 14  # Noise of the last observation of an episode; indices: step, column
    AGE = 15  # Initial age of an environment in a staggered batch
    OBSERVATION_DELAY = 16  # Delays of observations in steps; index: delay
    ACTION_DELAY = 17  # Delay of actions in steps
    COMMAND = 18  # Draws of a command generator besides goals, such as a phase; index: quantity
    TRACK = 19  # Gates and poles; indices: quantity of an object, attempt
    PRACTICE = 20  # Start on a track in training; index: quantity
    JOINTS = 21  # Positions and rates of joints; index: quantity, all positions first
    FAULT_STEPS = 22  # Start and duration of sensor faults; index: fault
    FAULT = 23  # Occurrence of faults in an episode, and size of jumps; index: fault
    ACTION_NOISE = 24  # Noise of commands; indices: step, entry
    PACKETS = 25  # Loss of observation packets; index: step
    NETWORK = 26  # Loss of messages between vehicles; indices: message, other vehicle


def _next_state(state: Word) -> Word:
    """Return the next state of the 32-bit generator PCG, as in Warp, an int or int64.

    Source: Jarzynski, Olano (2020), Hash functions for GPU rendering, JCGT 9(3).
    """
    word = (state * 747796405 + 2891336453) & 0xFFFFFFFF
    word = (((word >> ((word >> 28) + 4)) ^ word) * 277803737) & 0xFFFFFFFF
    return (word >> 22) ^ word


def state_of_count(state: Tensor, count: Tensor | int) -> Tensor:
    """Return the random state of a count within a state, int64: ``wp.rand_init(int(state), count)``."""
    if isinstance(count, Tensor):
        return _next_state((state.long() + _next_state(count.long() & 0xFFFFFFFF)) & 0xFFFFFFFF)
    return _next_state((state.long() + _next_state(count & 0xFFFFFFFF)) & 0xFFFFFFFF)


def uniform_draw(state: Tensor, *, dtype: torch.dtype) -> Tensor:
    """Return the first uniform draw of each state, in [0, 1): ``wp.randf(state)``."""
    return (_next_state(state) >> 8).to(dtype) / 2**24


def uniform_draws(state: Tensor, index: int, width: int, *, dtype: torch.dtype) -> Tensor:
    """Return uniform draws in [0, 1), (..., width), of each state; ``index`` separates the quantities of one state.

    They equal consecutive ``wp.randf(stream)`` with ``stream = wp.rand_init(int(state), index)``.
    """
    stream, draws = state_of_count(state, index), []
    for _ in range(width):
        stream = _next_state(stream)
        draws.append((stream >> 8).to(dtype) / 2**24)
    return torch.stack(draws, dim=-1)


def normal_draws(state: Tensor, index: int, width: int, *, dtype: torch.dtype) -> Tensor:
    """Return normal draws (..., width); ``index`` separates the quantities of one state.

    They equal consecutive ``wp.randn(stream)`` with ``stream = wp.rand_init(int(state), index)`` to round-off.
    """
    stream, draws = state_of_count(state, index), []
    for _ in range(width):
        stream = _next_state(stream)
        radius = torch.sqrt(-2.0 * torch.log((stream >> 8).to(dtype) / 2**24 + 5.96e-8))
        stream = _next_state(stream)
        draws.append(radius * torch.cos(2.0 * pi * ((stream >> 8).to(dtype) / 2**24)))
    return torch.stack(draws, dim=-1)


def copy_mask(kept: Tensor, mask: Tensor) -> None:
    """Copy ``mask`` into the mask of recorded launches, both bool (E,), unless they are the same tensor."""
    if mask is not kept:
        kept.copy_(mask)


class Randomness:
    """Seed, environment numbers and episode numbers of a batch, in fixed memory on the device.

    The owner of the batch calls ``begin`` at the start of episodes, before any draw; all others only read.
    """

    def __init__(
        self, num_envs: int, *, device: str | torch.device = "cpu", seed: int = 0, first_env: int = 0,
        first_episode: int = 0,
    ) -> None:  # fmt: skip
        """Store the seed and the numbers of the environments.

        Args:
            first_env: Number of the first environment; the others follow. A single environment 17 equals that
                of a large batch.
        """
        self.first_env, self._first_episode = first_env, first_episode
        self.seed = torch.zeros(1, dtype=torch.int32, device=device)
        """(1,)."""
        self.environment = torch.arange(first_env, first_env + num_envs, dtype=torch.int32, device=device)
        """Number of each environment, (E,)."""
        self.episode = torch.zeros(num_envs, dtype=torch.int32, device=device)
        """Number of each environment's present episode, (E,); one before the first until that begins."""
        self.mask = torch.zeros(num_envs, dtype=torch.bool, device=device)
        """The environments of the last ``begin``, (E,): what draws by a mask reads it here (``copy_mask``)."""
        self.shared = self
        """Random numbers of the environments that hold these rows: those that all vehicles of an environment share."""
        self.restart(seed)

    def of_bodies(self, count: int, *, first: int, total: int) -> "Randomness":
        """Return the random numbers of ``count`` vehicles in each environment, in rows ``environment x count + vehicle``.

        The number of a vehicle is ``environment x total + first + vehicle``: it draws what that environment draws where each
        environment has one vehicle. ``shared`` draws what the vehicle's environment draws.
        """
        rows, device = self.num_envs * count, self.seed.device
        bodies, shared = (Randomness(rows, device=device, first_episode=self._first_episode) for _ in range(2))
        vehicle = torch.arange(first, first + count, dtype=torch.int32, device=device)
        shared.environment.copy_(self.environment.repeat_interleave(count))
        bodies.environment.copy_((self.environment.unsqueeze(1) * total + vehicle).flatten())
        bodies.seed = shared.seed = self.seed
        bodies.shared = shared
        return bodies

    @property
    def num_envs(self) -> int:
        """Number of environments E."""
        return self.episode.shape[0]

    def restart(self, seed: int) -> None:
        """Restart the draws with a seed."""
        self.seed.fill_(seed % 2**31)
        self.restart_episodes()

    def restart_episodes(self) -> None:
        """Set all rows before their first episode."""
        self.episode.fill_(self._first_episode - 1)

    def state_tensors(self) -> dict[str, Tensor]:
        """Return the state for a checkpoint, by name."""
        return {"seed": self.seed, "environment": self.environment, "episode": self.episode}

    def on_host(self) -> "Randomness":
        """Return a copy on the CPU, for draws outside steps: a GPU would load a kernel for each operation."""
        host = copy(self)
        host.seed, host.environment, host.episode = (each.cpu() for each in self.state_tensors().values())
        return host

    def begin(self, mask: Tensor) -> None:
        """Advance the episode in the environments of ``mask``, bool (E,)."""
        copy_mask(self.mask, mask)
        self.episode.add_(self.mask)

    def stream(self, purpose: Purpose) -> Tensor:
        """Return the random state of a purpose in every environment, int64, (E,): ``draws.episode_stream`` in a kernel."""
        return state_of_count(self._environment_stream(purpose), self.episode)

    def stream_of_all_episodes(self, purpose: Purpose) -> Tensor:
        """Return the random state of draws that hold in all episodes of a seed, int64, (E,)."""
        return state_of_count(self._environment_stream(purpose), 0)

    def _environment_stream(self, purpose: Purpose) -> Tensor:
        """Return the random state of seed, purpose and environment; a chance collision concerns one purpose only."""
        return state_of_count(state_of_count(self.seed, int(purpose)), self.environment)
