"""A task: a simulation seen as a vectorised Gymnasium environment whose rows are reset where their episodes end.

Letters: E environments, U entries of an action, O entries of an observation.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch
from torch import Tensor

from aerial_gym.config.task import TaskCfg
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import CapabilityError, ConfigError, UnknownNameError
from aerial_gym.math.random import Purpose, counted_uniform
from aerial_gym.registry.state import below, check_state, identity, restore, saved
from aerial_gym.robots.finite import NonFinite
from aerial_gym.robots.watch import Watch
from aerial_gym.sensors.cells import NearestInCells
from aerial_gym.task.actions import ACTIONS, Action, direct
from aerial_gym.task.by_row import ByRow, beside, side_by_side, terms_apart
from aerial_gym.task.curriculum import Curriculum
from aerial_gym.task.draws.goals import Goals
from aerial_gym.task.draws.noise import ObservationNoise
from aerial_gym.task.observations import IMAGE_CELLS, OBSERVATIONS, ObservationTerm, TaskState
from aerial_gym.task.rewards import REWARDS, Reward
from aerial_gym.task.shapes import check_shapes
from aerial_gym.task.step_graph import StepGraph, check_terms

if TYPE_CHECKING:
    from gymnasium import spaces

Observation = dict[str, Tensor]
"""``observations``: (E, O) float32."""


StepResult = tuple[Observation, Tensor, Tensor, Tensor, dict[str, Tensor]]
"""Observation, reward, terminated, truncated, info."""


class Judgement(NamedTuple):
    """What one kernel finds of a step of every environment, (E, ...); the first six go on into the next one."""

    non_finite: Tensor
    """Bits of ``NonFinite``, for ``gtd["non_finite"]``."""

    crashes: Tensor
    """For ``gtd["crashes"]``."""

    truncations: Tensor
    """For ``gtd["truncations"]``."""

    episode_return: Tensor
    """Return with which the next step goes on."""

    ended: Tensor
    """Terminated or truncated; for ``Randomness.mask``, where a reset takes it from."""

    episode: Tensor
    """Number of the episode that the next step belongs to; for ``Randomness.episode``."""

    final: Tensor
    """Observation before the reset."""

    reward: Tensor
    terminated: Tensor
    truncated: Tensor

    distance: Tensor
    """To the target [m]."""

    total: Tensor
    """Return of the episode so far."""

    length: Tensor
    """Steps of the episode so far."""

    success: Tensor
    timeout: Tensor
    bad: Tensor
    """Whether something was not finite."""


class Task:
    """Observation, reward and termination around an ``EnvManager``.

    ``step`` returns the observation *after* the masked reset; the last one of a finished episode stands in
    ``info["final_observation"]``, in the rows where ``terminated | truncated``. ``info["time_outs"]`` marks episodes that
    ended by their length alone, for bootstrapping the value. ``episode_return``, ``episode_length`` [steps] and ``distance``
    to the target [m] are those before the reset. Where the configuration has a success radius, ``info`` also holds
    ``successes``, ``crashes`` and ``timeouts``, bool (E,): one of them is true where an episode ended (``timeouts``: neither
    crashed nor there in time).

    A row in which something is not finite, NaN or infinite, ends as a crash: ``info["non_finite"]``, bool (E,), marks it. Its
    reward is that of a crash (0 where the reward knows none), its last observation has zeros there, its state is reset with
    those of the other rows that ended, and none of these is touched. The first such row is named in a warning, and ``watch``
    keeps what led to it.

    Images are taken once a step, after the reset: those in ``final_observation`` are one step old.

    On a GPU the whole step is one CUDA graph, recorded at the first ``reset``: the tensors that ``step`` returns are then
    overwritten by the next one; clone what must stay. ``captured`` says whether it is so.
    """

    def __init__(self, cfg: TaskCfg, env: EnvManager, *, capture: bool | None = None) -> None:
        """Take the configuration and a built simulation.

        Args:
            cfg: Terms, reward, target, length of an episode.
            env: The simulation.
            capture: Whether to hold the step in a CUDA graph; if not given, on CUDA devices.

        Raises:
            CapabilityError: If a capture is asked for on the CPU.
            UnknownNameError: If there is no such term, reward or action.
            ConfigError: If these do not fit together, or not the robot or the environment.
        """
        self.cfg, self.env = cfg, env
        self.num_envs, self.device = env.num_envs, env.device
        num_commands, command = env.robot_manager.num_actions, env.robot_manager.controller.action_names
        self._terms = _resolve_terms(cfg, has_image=bool(env.sensor_manager.casters))
        self._reward, self._params = _resolve_reward(cfg, command)
        self._action, self._action_params = _resolve_action(cfg, command)
        num_actions = num_commands if self._action.width is None else self._action.width
        widths = [num_commands if term.width is None else term.width for term, _ in self._terms]
        self.num_actions, self.num_observations = num_actions, sum(widths)
        """Entries of an action and of an observation, U and O."""
        self.target_position = torch.tensor(cfg.target, device=self.device).expand(self.num_envs, 3).clone()
        self.episode_return = torch.zeros(self.num_envs, device=self.device)
        stds = [std for (_, std), width in zip(self._terms, widths, strict=True) for _ in range(width)]
        self._gtd = env.gtd
        self._noise = ObservationNoise(torch.tensor(stds, device=self.device), env.gtd["sim_steps"], env.random)
        self._all = torch.ones(self.num_envs, dtype=torch.bool, device=self.device)
        self._prev_distance = torch.zeros(self.num_envs, device=self.device)
        self._image, self._image_scale = _first_image(env)
        self._cells: NearestInCells | None = None
        if any(term.needs_image for term, _ in self._terms):
            largest, empty = self._image_scale.tolist()
            self._cells = NearestInCells(self._image, cells=IMAGE_CELLS, largest=largest, empty=empty)
        self._no_cells = torch.zeros(self.num_envs, 0, device=self.device)
        self._no_terms = torch.zeros(self.num_envs, 0, device=self.device)
        self._goals = self._make_goals()
        self.curriculum = (
            None if cfg.curriculum is None else Curriculum(cfg.curriculum, env.cfg, env.asset_manager, env.gtd)
        )
        """Sets the number of obstacles; None where the task has none."""
        self._difficulty = (
            torch.zeros((), device=self.device) if self.curriculum is None else self.curriculum.difficulty
        )
        self._crash_reward = self._params.get("crash", 0.0)
        self._watch = Watch(env.gtd, env.robot_manager.noticed, num_actions=num_actions, dt=env.dt, keep=False)
        self._widths, self._apart = widths, ()
        check_shapes(cfg, self.state(), widths, lambda at: self._reward.value(at, self._params, at.crashed))
        self._apart = terms_apart([(e.term, OBSERVATIONS[e.term]) for e in cfg.observations], self.state())
        self._observe = ByRow(self._finite_observation, "the observation")
        keys = ("non_finite", "crashes", "truncations")
        self._written = (*(env.gtd[key] for key in keys), self.episode_return, env.random.mask, env.random.episode)
        self._judge = ByRow(self._judgement, f"the judgement of a step, with reward {cfg.reward!r},")
        self._command = ByRow(
            lambda actions: self._action.value(actions, self._action_params), f"action {cfg.action!r}"
        )
        self._measure = ByRow(lambda target, position: (target - position).norm(dim=-1), "the distance to the target")
        self._graph: StepGraph[StepResult] | None = None
        if capture and self.device.type != "cuda":
            raise CapabilityError(f"capture needs a CUDA device; this task runs on {self.device}")
        self._capture_at_reset = self.device.type == "cuda" if capture is None else capture

    @cached_property
    def observation_space(self) -> "spaces.Dict":
        """Space of an observation of one environment, unbounded; Gymnasium is imported when it is asked for."""
        from gymnasium import spaces

        bound = np.full(self.num_observations, np.inf, dtype=np.float32)
        return spaces.Dict({"observations": spaces.Box(-bound, bound, dtype=np.float32)})

    @cached_property
    def action_space(self) -> "spaces.Box":
        """Space of an action of one environment, each entry -1 to 1."""
        from gymnasium import spaces

        one = np.ones(self.num_actions, dtype=np.float32)
        return spaces.Box(-one, one, dtype=np.float32)

    @property
    def captured(self) -> bool:
        """Whether a step is the replay of a CUDA graph."""
        return self._graph is not None

    def capture(self) -> None:
        """Record the whole step as one CUDA graph; call ``reset`` before the next step.

        Raises:
            CapabilityError: If a term waits for the GPU (its name is in the message), or there is no GPU.
        """
        if self.device.type != "cuda":
            raise CapabilityError(f"capture needs a CUDA device; this task runs on {self.device}")
        self._capture_at_reset = False
        level = None if self.curriculum is None else self.curriculum.state()
        self._begin(self._all)
        self._check_untraced()
        self._graph = StepGraph(self._step, (self.num_envs, self.num_actions), self.device)
        self.env.restart(self.env.seed)
        if self.curriculum is not None and level is not None:
            self.curriculum.load(level)

    def watch(self) -> None:
        """Keep the last steps of rows that are not finite, for ``dump``; call it before the first ``reset``.

        It costs one small launch a step and the memory of 64 steps of state, command and action of every environment.

        Raises:
            CapabilityError: If the step is held in a CUDA graph already.
        """
        if self.captured:
            raise CapabilityError("watch: the step is recorded already. Call it before the first reset")
        self._watch = Watch(
            self._gtd, self.env.robot_manager.noticed, num_actions=self.num_actions, dt=self.env.dt, keep=True
        )

    @property
    def num_non_finite(self) -> int:
        """Number of rows that were not finite since the task was made. Waits for the device."""
        return self._watch.look(wait=True)

    def dump(self, path: str | Path) -> int:
        """Write the last steps of the first rows that were not finite as CSV; return how many rows. Waits for the device.

        Raises:
            ConfigError: If ``watch`` was not called.
            StorageError: If the file cannot be written.
        """
        return self._watch.dump(path)

    def _check_untraced(self) -> None:
        """Refuse what waits for the GPU; a kernel cannot, so only what runs as torch operations is asked."""
        state = self.state()
        self._judge(*self._judged())
        names = {self.cfg.observations[i].term for i in self._apart}
        terms = {f"observation term {name!r}": partial(OBSERVATIONS[name].value, state) for name in names}
        if self._judge.reason is not None:
            terms[f"reward {self.cfg.reward!r}"] = partial(self._reward.value, state, self._params, state.crashed)
        check_terms(terms)

    def reset(self, *, seed: int | None = None) -> tuple[Observation, dict[str, Tensor]]:
        """Start every environment anew; return observation and info.

        With a ``seed`` everything is as in a new task with that seed, the choice of obstacles and the curriculum included;
        without one the curriculum goes on.
        """
        if self._capture_at_reset:
            self.capture()
        if seed is not None:
            self.env.restart(seed)
            if self.curriculum is not None:
                self.curriculum.restart()
        self._begin(self._all)
        self._watch.look()
        self._watch.forget()
        self.episode_return.zero_()
        self._look()
        self._noise.draw()
        return {"observations": self._noise.add(self._observe(*vars(self.state()).values()))}, {}

    def stagger(self) -> None:
        """Give every environment a random age, so that episodes end one by one: a batch then holds all their phases."""
        steps, age = self.cfg.episode_len_steps, self._gtd["sim_steps"]
        age.copy_(counted_uniform(self.env.random.stream(Purpose.AGE), dtype=torch.float64).mul_(steps))

    def step(self, actions: Tensor) -> StepResult:
        """Advance by one action, (E, U); return observation, reward (E,), terminated, truncated (E,) bool, info."""
        result = self._step(actions) if self._graph is None else self._graph.replay(actions)
        self._watch.look()
        return result

    def _step(self, actions: Tensor) -> StepResult:
        self.env.step(actions if self._action.value is direct else self._command(actions))
        self._noise.draw(final=True)  # of the episode that may end now
        judged = Judgement(*self._judge(*self._judged(), out=self._written))
        ended, info = judged.ended, {
            "final_observation": self._noise.add(judged.final),
            "time_outs": judged.truncated,
            "episode_return": judged.total,
            "episode_length": judged.length,
            "distance": judged.distance,
            "non_finite": judged.bad,
        }  # fmt: skip
        if self.cfg.success_radius is not None:
            info |= {"successes": judged.success, "crashes": judged.terminated, "timeouts": judged.timeout}
            if self.curriculum is not None:
                self.curriculum.count(ended, judged.success)
        self._watch.keep(actions, ended)
        self._begin(ended, counted=True)
        self._look()
        self._noise.draw()
        after = self._noise.add(self._observe(*vars(self.state()).values()))
        return {"observations": after}, judged.reward, judged.terminated, judged.truncated, info

    def _judged(self) -> tuple[Tensor, ...]:
        """Return what ``_judgement`` looks at."""
        gtd, episode = self._gtd, self.env.random.episode
        return (gtd["sim_steps"], self.episode_return, gtd["non_finite"], episode, *vars(self.state()).values())

    def _begin(self, mask: Tensor, *, counted: bool = False) -> None:
        """Start episodes in the environments of ``mask``: robot, obstacles, goal and the room around it."""
        self.env.reset(mask, counted=counted)
        mask = self.env.random.mask
        if self._goals is not None:
            self._goals.draw(mask)
            self.env.clear_goal(mask, self.target_position)
        if self._reward.needs_progress:
            self._measure(self.target_position, self._gtd["robot_position"], out=(self._prev_distance,))

    def _look(self) -> None:
        """Read the sensors, and the image's cells where a term asks for them."""
        self.env.render()
        if self._cells is not None:
            self._cells.measure()

    def parts(self) -> dict[str, Callable[[], None]]:
        """Return what a step is made of, to be timed part by part: each changes the simulation as it does in a step.

        ``reset`` is that of a hundredth of the environments; ``rendering`` is missing where the robot has no sensor. The rest
        of a step is what the task itself computes.
        """
        few = torch.arange(self.num_envs, device=self.device) % 100 == 0
        found = {"physics": self.env.fly, "collision": self.env.collide, "reset": partial(self._begin, few)}
        return found | ({"rendering": self._look} if self.env.sensor_manager.casters else {})

    def _make_goals(self) -> Goals | None:
        low, high = self.cfg.target_ratio_low, self.cfg.target_ratio_high
        if low is None or high is None:
            return None
        bounds = (self._gtd["env_bounds_min"], self._gtd["env_bounds_max"])
        return Goals(self.target_position, bounds=bounds, ratios=(low, high), random=self.env.random)

    def state(self) -> TaskState:
        """Return the states of this instant."""
        gtd = self._gtd
        state = TaskState(
            target=self.target_position,
            position=gtd["robot_position"],
            attitude=gtd["robot_orientation"],
            lin_vel=gtd["robot_linvel"],
            lin_vel_body=gtd["robot_body_linvel"],
            ang_vel_body=gtd["robot_body_angvel"],
            actions=gtd["robot_actions"],
            prev_actions=gtd["robot_prev_actions"],
            crashed=gtd["crashes"],
            prev_distance=self._prev_distance,
            difficulty=self._difficulty,
            image=self._image,
            image_scale=self._image_scale,
            nearest=self._no_cells if self._cells is None else self._cells.nearest,
            apart=self._no_terms,
        )
        if not self._apart:
            return state
        terms = [self._terms[i][0] for i in self._apart]
        return replace(state, apart=beside(terms, state))

    def _observation(self, *state: Tensor) -> Tensor:
        """Return the terms side by side, (E, O), without their noise."""
        return side_by_side([term for term, _ in self._terms], self._apart, TaskState.of(state), self._widths)

    def _finite_observation(self, *state: Tensor) -> Tensor:
        """Return the terms with zeros where they are not finite; the step after ends such a row."""
        return self._observation(*state).nan_to_num(0.0, 0.0, 0.0)

    def _judgement(
        self, steps: Tensor, episode_return: Tensor, non_finite: Tensor, episode: Tensor, *state: Tensor
    ) -> tuple[Tensor, ...]:
        """Return a ``Judgement``."""
        at = TaskState.of(state)
        distance = (at.target - at.position).norm(dim=-1)
        terminated = at.crashed | (distance > self.cfg.max_distance)
        reward, observation = self._reward.value(at, self._params, terminated), self._observation(*state)
        bits = (
            non_finite
            + NonFinite.REWARD.value * (~reward.isfinite()).int()
            + NonFinite.OBSERVATION.value * (~observation.isfinite()).any(dim=-1).int()
        )
        bad = bits != 0
        terminated = terminated | bad
        truncated = (steps >= self.cfg.episode_len_steps) & ~terminated
        ended = terminated | truncated
        reward = torch.where(bad, self._crash_reward, reward)
        distance = torch.where(distance.isfinite(), distance, self.cfg.max_distance)
        total = episode_return + reward
        success = truncated & (distance < (self.cfg.success_radius or 0.0))
        return Judgement(
            non_finite=bits,
            crashes=terminated,
            truncations=truncated,
            episode_return=total.masked_fill(ended, 0.0),
            final=observation.nan_to_num(0.0, 0.0, 0.0),
            reward=reward,
            terminated=terminated.clone(),
            truncated=truncated.clone(),
            ended=ended,
            episode=episode + ended,
            distance=distance,
            total=total,
            length=steps.clone(),
            success=success,
            timeout=truncated & ~success,
            bad=bad,
        )

    def state_tensors(self) -> dict[str, Tensor]:
        """Return everything on which the future depends, by name: tensors that keep their places, and digests."""
        own = {
            "target_position": self.target_position,
            "episode_return": self.episode_return,
            "prev_distance": self._prev_distance,
        }
        if self._cells is not None:
            own["cells"] = self._cells.nearest
        curriculum = {} if self.curriculum is None else self.curriculum.state_tensors()
        found = identity(task=self.cfg) | self.env.state_tensors()
        return found | below("task", own) | below("curriculum", curriculum)

    def save_state(self) -> dict[str, Tensor]:
        """Return a copy of everything on which the future depends, the simulation included (``EnvManager.save_state``).

        What a policy remembers is its own.
        """
        return saved(self.state_tensors())

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Go on from a state that this or an equal task has saved; call ``reset`` once before. Waits for the device.

        Raises:
            ConfigError: If it is the state of another task or simulation; the message says what differs.
        """
        check_state(state, self.state_tensors())
        self.env.restore(state)
        restore(state, self.state_tensors())

    def close(self) -> None:
        """Name what was not finite and not yet named, and release the simulation; a later call raises ``ClosedError``."""
        self._watch.look(wait=True)
        self._graph, self._capture_at_reset = None, False
        self.env.close()

    def __enter__(self) -> "Task":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _resolve_terms(cfg: TaskCfg, *, has_image: bool) -> list[tuple[ObservationTerm, float]]:
    for entry in cfg.observations:
        if entry.term not in OBSERVATIONS:
            raise UnknownNameError(f"no observation term {entry.term!r}. Known: {', '.join(sorted(OBSERVATIONS))}")
        if OBSERVATIONS[entry.term].needs_image and not has_image:
            raise ConfigError(
                f"observation term {entry.term!r}: robot {cfg.robot} has no camera or lidar. Choose one with a sensor"
            )
    return [(OBSERVATIONS[entry.term], entry.noise_std) for entry in cfg.observations]


def _resolve_reward(cfg: TaskCfg, command: tuple[str, ...]) -> tuple[Reward, dict[str, float]]:
    if cfg.reward not in REWARDS:
        raise UnknownNameError(f"no reward {cfg.reward!r}. Known: {', '.join(sorted(REWARDS))}")
    reward = REWARDS[cfg.reward]
    _check_names(f"reward {cfg.reward}: coefficients", cfg.reward_params, reward.params)
    _check_command(f"reward {cfg.reward}: is about", reward.command, cfg, command)
    return reward, dict(cfg.reward_params)


def _resolve_action(cfg: TaskCfg, command: tuple[str, ...]) -> tuple[Action, dict[str, float]]:
    if cfg.action not in ACTIONS:
        raise UnknownNameError(f"no action {cfg.action!r}. Known: {', '.join(sorted(ACTIONS))}")
    action = ACTIONS[cfg.action]
    _check_names(f"action {cfg.action}: numbers", cfg.action_params, action.params)
    _check_command(f"action {cfg.action}: gives", action.command, cfg, command)
    return action, dict(cfg.action_params)


def _check_names(what: str, given: Mapping[str, float], needed: tuple[str, ...]) -> None:
    if set(given) != set(needed):
        raise ConfigError(f"{what} {sorted(given)} given, needs {sorted(needed)}")


def _check_command(what: str, needed: tuple[str, ...] | None, cfg: TaskCfg, command: tuple[str, ...]) -> None:
    if needed is not None and needed != command:
        raise ConfigError(f"{what} {', '.join(needed)}; controller {cfg.controller} takes {', '.join(command)}")


def _first_image(env: EnvManager) -> tuple[Tensor, Tensor]:
    """Return the distances of the first range sensor and ``TaskState.image_scale``; nothing and ones without a sensor.

    Where a sensor marks "too far" by a distance of its own, a cell without a distance is near (0); where it marks far and
    near alike, nothing is known, and far (1) is by much the more frequent.
    """
    if not env.sensor_manager.casters:
        return torch.zeros(env.num_envs, 0, 0, 0, device=env.device), torch.ones(2, device=env.device)
    sensor = next(iter(env.sensor_manager.casters.values())).cfg
    largest = 1.0 if sensor.normalize else sensor.max_range
    empty = 0.0 if sensor.far_pixel >= 0.0 else 1.0
    return env.gtd["depth_range_pixels"], torch.tensor([largest, empty], device=env.device)
