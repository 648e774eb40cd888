"""A task: a simulation seen as a vectorised Gymnasium environment whose rows are reset where their episodes end.

Letters: E environments, V entries of an action, O entries of an observation, T terms of the reward.
"""

from collections.abc import Callable, Mapping
from functools import cached_property, partial
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from aerial_gym.config.task import OBSERVATIONS, POLICY, TaskCfg
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import CapabilityError, ConfigError, ShapeError
from aerial_gym.interop import action_tensor, on_device, with_usual_settings
from aerial_gym.math.random import Purpose, uniform_draw
from aerial_gym.registry.state import add_prefix, check_state, config_digests, copy_tensors, restore_tensors
from aerial_gym.robots.finite_watch import FiniteWatch
from aerial_gym.task import resolve
from aerial_gym.task.commands.catalog import make_command
from aerial_gym.task.commands.command import TARGET
from aerial_gym.task.curriculum import Curriculum
from aerial_gym.task.images import ImageBuffers, TaskImages
from aerial_gym.task.rotor_range import with_rotor_range
from aerial_gym.task.step.actor import ActionConverter, declare_delay
from aerial_gym.task.step.judge import ARRIVED, COLLISIONS, FINAL, SUMS, TALLIES, Judge
from aerial_gym.task.step.observer import ObservationEntry, Observer
from aerial_gym.task.step.reset_delay import WAITING, ResetDelay
from aerial_gym.task.step.row_kernels import GradientGraph, StepKernel
from aerial_gym.task.step.step_graph import StepGraph, check_untraced_terms
from aerial_gym.task.values import STEP_TIME, Values
from aerial_gym.task.vehicles.row_inputs import NEAREST, VehicleInputs

if TYPE_CHECKING:
    from gymnasium import spaces

Observation = dict[str, Tensor]  # `observations`, (E, O), is the group `policy`; others and images have own names

StepResult = tuple[Observation, Tensor, Tensor, Tensor, dict[str, Tensor]]
"""Observation, reward, terminated, truncated, info."""


def group_key(group: str) -> str:
    """Return the observation key of a group."""
    return OBSERVATIONS if group == POLICY else group


@with_usual_settings
class Task:
    """Commands, actions, observations, rewards and terminations around an ``EnvManager``, as the configuration says.

    ``step`` returns the observation *after* the masked reset; the last one of a finished episode stands in
    ``info["final_observation"]``, that of another group in ``info["final_<group>"]``, in the rows where
    ``terminated | truncated``. ``info["time_outs"]`` marks truncated episodes, for bootstrapping the value; the termination
    of a success decides whether it counts as one. ``info`` also holds ``successes``, ``crashes``
    and ``timeouts``, bool (E,): one of them is true where an episode ended. ``episode_return``, ``episode_length`` [steps],
    ``reward_terms``, (E, T), the return term by term (``reward_names``), and ``distance`` to the target [m] are those before
    the reset; where there are gates, so is ``gate_passed``, bool (E,).

    With several vehicles in an environment each has a row: row b is vehicle ``b % V`` of environment ``b // V``, and
    ``value.unflatten(0, (-1, task.num_vehicles))`` views rows as (environments, vehicles). E is then the number of rows,
    and ``info["collisions"]``, bool (E,), marks vehicles that touched another one. Where the environment has
    ``reset_together``, its vehicles end their episodes together (``common_ends``).

    A row with NaN or infinite values ends as a crash: ``info["non_finite"]``, bool (E,), marks it. Its reward is that of a
    crash (0 if the task has none), and its last observation has zeros in place of these values. It is reset like other
    ended rows and does not affect them. A warning names the first such row, and ``watch`` records the steps before it.

    Images are taken once a step, after the reset, so that image terms of ``final_observation`` are one step old. Tasks with
    raw ``images`` take them before the reset, and again where an episode begins: then all are of their instant, and
    ``info["final_<image>"]`` holds the last images of ended rows.

    On a GPU the whole step is one CUDA graph, recorded at the first ``reset``: the tensors that ``step`` returns are then
    overwritten by the next one; clone what must stay. ``captured`` is true in that case.

    With a ``differentiable`` simulation reward, observation and last observation have gradients with respect to the actions
    of this and earlier steps. Gradients reach back to the reset of a row or to ``detach``. Such a step is no graph of
    its own.
    """

    def __init__(self, cfg: TaskCfg, env: EnvManager, *, capture: bool | None = None) -> None:
        """Take the configuration and a built simulation.

        Args:
            cfg: Terms, commands, length of an episode.
            capture: Whether to hold the step in a CUDA graph; if not given, on CUDA devices.

        Raises:
            CapabilityError: If a capture is asked for on the CPU or of gradients, or a term has no gradient and is to have one.
            UnknownNameError: If a term, generator, action, or one of their inputs does not exist.
            ConfigError: If these do not fit together, or not the robot or the environment.
        """
        group = env.rows
        if cfg.share_reward and not env.cfg.reset_together:
            raise ConfigError(
                "task: share_reward needs an environment with reset_together: true. Give it that, or leave it out"
            )
        if cfg.curriculum is not None and group.kind.count > 1 and not env.cfg.reset_together:
            raise ConfigError(
                "task: its curriculum changes obstacles, which stay where vehicles restart alone. Give the environment "
                "reset_together: true, or leave curriculum out"
            )
        alone = [name for name, each in cfg.terminations.items() if each.vehicles]
        if alone and not (group.kind.count > 1 and env.cfg.reset_together):
            raise ConfigError(
                f"task.terminations.{alone[0]}.vehicles: needs several vehicles that end together. Give num_vehicles and an "
                "environment with reset_together: true, or leave it out"
            )
        num_commands, command = env.robot_manager.num_actions, env.robot_manager.action_names
        cfg = with_rotor_range(cfg, env.robot_manager.cfg, command)
        self.cfg, self.env = cfg, env
        self.num_vehicles, self.device = group.kind.count, env.device
        self.num_envs = self.num_vehicles * env.num_envs  # Rows E: the vehicles of all environments
        self._gtd, self._random = group.bodies, group.random
        self._together = self.num_vehicles > 1 and env.cfg.reset_together
        self._around = VehicleInputs(env) if self.num_vehicles > 1 else None
        resolve.check_terms(cfg)
        action, params = resolve.resolve_action(cfg, command)
        self.num_actions = num_commands if action.width is None else action.width  # Entries of an action, V
        self._buffers = ImageBuffers(env.sensor_manager, self._gtd, robot=cfg.robot, encoder=cfg.encoder)
        self.values = self._make_values(num_commands)
        """Inputs of terms by name: GTD keys and the task's own buffers; ``print(task.values.own)`` shows the latter."""
        declare_delay(cfg.action, self.values)
        self._command = make_command(cfg.command, self.values, env)
        self.curriculum = (
            None if cfg.curriculum is None else Curriculum(cfg.curriculum, env.cfg, env.asset_manager, env.gtd)
        )
        """Sets the number of obstacles; None where the task has none."""
        difficulty = None if self.curriculum is None else self.curriculum.difficulty
        meaning = "how far the curriculum has come from its lowest (0) to its highest (1) level; 0 without one"
        self.values.declare("difficulty", meaning=meaning, view=difficulty, rows=False)
        groups = resolve.resolve_groups(cfg, self.values, num_commands=num_commands)
        rewards = resolve.resolve_rewards(cfg, self.values, command)
        if self.values.graph is not None:
            observed = [term for entries in groups.values() for term, _, _ in entries]
            resolve.check_gradients([term for term, _ in rewards.values()], observed, self.values, images=cfg.images)
        terminations = resolve.resolve_terminations(cfg, self.values, command)
        self._observer = Observer(groups, self.values, self._random, cfg.faults)
        self.num_observations = self._observer.width(POLICY)  # Entries of an observation of the group `policy`, O
        self._judge = Judge(
            cfg, rewards, terminations, self.values, command=self._command, observer=self._observer,
            random=self._random, num_vehicles=self.num_vehicles if self._together else 1,
        )  # fmt: skip
        self._images = TaskImages(cfg.images, self.values, env.sensor_manager)
        counts = {"num_actions": self.num_actions, "num_commands": num_commands}
        self._actor = ActionConverter(cfg.action, action, params, self.values, **counts, dt=env.dt, random=self._random)
        self._memory = self._make_buffer_kernel()
        self._all = torch.ones(self.num_envs, dtype=torch.bool, device=self.device)
        self._watch = self._make_watch(keep=False)
        self._delay: ResetDelay | None = None
        self._graph: StepGraph[StepResult] | None = None
        if capture:
            self._check_capture()
        plain = self.values.graph is None
        self._capture_at_reset = self.device.type == "cuda" and plain if capture is None else capture

    @property
    def observation_shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of an observation of one environment, by key."""
        images = {name: tuple(frames.shape[1:]) for name, frames in self._images.frames.items()}
        return {group_key(name): (self._observer.width(name),) for name in self._observer.groups} | images

    @cached_property
    def observation_space(self) -> "spaces.Dict":
        """Observation space of one environment; Gymnasium is imported on demand."""
        from gymnasium import spaces

        images, entries = self._images.frames, {}
        for name, shape in self.observation_shapes.items():
            low, high, dtype = -np.inf, np.inf, torch.float32
            if name in images:
                dtype = images[name].dtype
                low, high = 0, 255 if dtype == torch.uint8 else 1
            entries[name] = spaces.Box(low, high, shape=shape, dtype=torch.empty(0, dtype=dtype).numpy().dtype.type)
        return spaces.Dict(entries)

    @cached_property
    def action_space(self) -> "spaces.Box":
        """Space of an action of one environment, each entry -1 to 1."""
        from gymnasium import spaces

        return spaces.Box(-1.0, 1.0, shape=(self.num_actions,), dtype=np.float32)

    @property
    def is_captured(self) -> bool:
        """Whether a step is the replay of a CUDA graph."""
        return self._graph is not None

    def capture(self) -> None:
        """Record the whole step as one CUDA graph; call ``reset`` before the next step.

        Raises:
            CapabilityError: If a term waits for the GPU (its name is in the message), or there is no GPU, or gradients.
        """
        self._check_capture()
        self._capture_at_reset = False
        level = None if self.curriculum is None else self.curriculum.state()
        self._reset_environments(self._all)
        parts = [*self._judge.parts, self._observer.rows, *([self._memory] if self._memory else [])]
        with on_device(self.device):
            check_untraced_terms(parts, self.values)
            self._graph = StepGraph(self._step, (self.num_envs, self.num_actions), self.device)
        self.values.own[TALLIES].zero_()  # of the steps before the recording
        self.env.restart(self.env.seed)
        if self.curriculum is not None and level is not None:
            self.curriculum.load(level)

    def _check_capture(self) -> None:
        if self.device.type != "cuda":
            raise CapabilityError(f"capture needs a CUDA device; this task runs on {self.device}")
        if self.values.graph is not None:
            raise CapabilityError("capture: a step with gradients is no CUDA graph. Make the task with capture=False")

    def detach(self) -> None:
        """Cut the gradients at this instant: later losses are differentiated back to here, and no further."""
        self.env.detach()
        if self.values.graph is not None:
            self.values.graph.detach()

    def detach_in_place(self) -> None:
        """Do as ``detach``, in tensors that stay, from which a CUDA graph can be replayed (``EnvManager.detach_in_place``)."""
        self.env.detach_in_place()
        if self.values.graph is not None:
            self.values.graph.detach_in_place()

    def watch(self) -> None:
        """Record the last steps of non-finite rows, for ``dump``; call it before the first ``reset``.

        It costs one small launch a step and the memory of 64 steps of state, command and action of every environment.

        Raises:
            CapabilityError: If the step is held in a CUDA graph already.
        """
        if self.is_captured:
            raise CapabilityError("watch: the step is recorded already. Call it before the first reset")
        self._watch = self._make_watch(keep=True)

    def _make_watch(self, *, keep: bool) -> FiniteWatch:
        noticed, dt = self.env.robot_manager.noticed, self.env.dt
        return FiniteWatch(
            self._gtd, noticed, num_actions=self.num_actions, dt=dt, keep=keep, num_vehicles=self.num_vehicles
        )

    @property
    def num_non_finite(self) -> int:
        """Number of rows that were not finite since the task was made. Waits for the device."""
        return self._watch.count_rows(wait=True)

    def dump(self, path: str | Path) -> int:
        """Write the last steps of the first non-finite rows as CSV; return the number of rows. Waits for the device.

        Raises:
            ConfigError: If ``watch`` was not called.
            StorageError: If the file cannot be written.
        """
        return self._watch.dump(path)

    def reset(self, *, seed: int | None = None) -> tuple[Observation, dict[str, Tensor]]:
        """Restart every environment; return observation and info. With a ``seed`` everything is as in a new task with that
        seed, the choice of obstacles and the curriculum included; without one the curriculum continues."""
        if self._capture_at_reset:
            self.capture()
        if seed is not None:
            self.env.restart(seed)
            if self.curriculum is not None:
                self.curriculum.restart()
        self._reset_environments(self._all)
        if self.values.graph is not None:
            self.detach()
        self._watch.count_rows()
        self._watch.clear_steps()
        for name in (SUMS, ARRIVED, WAITING):
            if name in self.values.own:
                self.values.own[name].zero_()
        return self._read_observation(), {}

    def delay_resets(self) -> None:
        """Reset environments one step after their episodes end, from now on; call it before the first ``reset``.

        The step of an end then returns the last observation of the episode. The next one ignores the action, and returns the
        first observation of a new episode with reward 0 and no end.

        Raises:
            CapabilityError: If the step is held in a CUDA graph already, or has gradients.
        """
        if self.is_captured or self.values.graph is not None:
            raise CapabilityError("delay_resets: call it before the first reset, on a task without gradients")
        if self._delay is None:
            meaning = "its episode ended in the last step; it is reset in the next one"
            waiting = self.values.declare(WAITING, dtype=torch.bool, meaning=meaning)
            self._delay = ResetDelay(self._judge, self._random, waiting)

    def practise(self) -> None:
        """Start episodes at the command's places of practice, from the next resets on."""
        self._command.practise()

    def stagger(self) -> None:
        """Give every environment a random age, so that episodes end one by one: a batch then holds all their phases."""
        random = self._random.shared if self._together else self._random  # vehicles that end together have one age
        ages = uniform_draw(random.on_host().stream(Purpose.AGE), dtype=torch.float64)
        self.set_ages(ages.mul_(self.cfg.episode_len_steps))

    def set_ages(self, ages: Tensor) -> None:
        """Set the ages of all episodes [steps], (E,). Vehicles that end together get that of the first one."""
        if self._together:
            ages = ages.view(-1, self.num_vehicles)[:, :1].expand(-1, self.num_vehicles).flatten()
        self._gtd["sim_steps"].copy_(ages)

    def step(self, actions: Tensor | ArrayLike) -> StepResult:
        """Advance by one action, (E, V), a tensor or an array.

        Returns:
            Observation, reward (E,), terminated, truncated (E,) bool, and info.

        Raises:
            ShapeError: If the action is not (E, V).
        """
        actions = action_tensor(actions, self.device)
        if tuple(actions.shape) != (self.num_envs, self.num_actions):  # a kernel would read beside it
            raise ShapeError(
                f"actions has shape {tuple(actions.shape)}, expected (E, V) = {(self.num_envs, self.num_actions)}"
            )
        if self.env.robot_manager.take_writes() and self.is_captured:
            self._graph, self._capture_at_reset = None, True
        if self.values.graph is None:
            actions = actions.to(torch.float32)  # the caller's default type may be another one
        result = self._step(actions) if self._graph is None else self._graph.replay(actions)
        self._watch.count_rows()
        return result

    def _step(self, actions: Tensor) -> StepResult:
        self.env.step(self._by_vehicle(self._actor(actions)))
        if self._images.frames:
            self._read_sensors()
        if self._around is not None:
            self._around.refresh()
        self._observer.draw_noise(final=True)  # of the episode that may end now
        judged = self._judge() if self._delay is None else self._delay()
        info = self._judge.info(judged)
        if self._around is not None:
            info[COLLISIONS] = self._gtd["vehicle_collisions"].clone()
        info |= {f"{FINAL}{name}": frames.clone() for name, frames in self._images.frames.items()}
        if self.curriculum is not None:
            self.curriculum.count(judged["ended"], judged["success"])
        self._watch.record_step(actions, judged["ended"])
        self._reset_environments(judged.get("due", judged["ended"]), counted=self._delay is None)
        return self._read_observation(), judged["reward"], judged["terminated"], judged["truncated"], info

    def _reset_environments(self, mask: Tensor, *, counted: bool = False) -> None:
        """Reset the environments of ``mask`` for new episodes: robot, obstacles, target and the room around it."""
        self.env.reset(self._vehicle_mask(mask), counted=counted, place=self._place)
        mask = self._random.mask
        self._command.draw(mask)
        if self._command.goal and (self._together or self._around is None):
            self.env.clear_goal(self.env.random.mask, self._by_vehicle(self.target_position))
        self._observer.draw_episodes(mask)
        self._actor.draw_delay(mask)
        if self._memory is not None:
            self._memory()

    def _vehicle_mask(self, mask: Tensor) -> Tensor | None:
        """Return the mask of rows for ``EnvManager.reset``: of environments, or of vehicles of environments that stay."""
        if self._around is None:
            return mask
        if mask is self._all:
            return None
        return self._by_vehicle(mask).any(dim=1) if self._together else self._by_vehicle(mask)

    def _by_vehicle(self, values: Tensor) -> Tensor:
        """Return rows by environment and vehicle; of single vehicles the values as they are."""
        return values if self._around is None else values.unflatten(0, (-1, self.num_vehicles))

    def _place(self, mask: Tensor) -> None:
        if self._around is not None:
            self._around.refresh()
            mask = self._random.mask
        self._command.place(mask)

    def _read_observation(self) -> Observation:
        """Read the sensors and return the observation of this instant."""
        if self._around is not None:
            self._around.refresh()
        self._read_sensors(begun=bool(self._images.frames))
        self._observer.draw_noise()
        entries = {group_key(group): value for group, value in self._observer().items()}
        return entries | {name: frames.clone() for name, frames in self._images.frames.items()}

    def _read_sensors(self, *, begun: bool = False) -> None:
        """Read the sensors and update image terms; ``begun``: only where an episode has just begun."""
        self.env.render(self._by_vehicle(self._random.mask) if begun else None)
        self._buffers.measure()
        self._images.write_frames(begun=begun)

    def require_one_vehicle(self, user: str) -> None:
        """Raise ``CapabilityError`` if environments have several vehicles, which ``user`` does not take."""
        if self.num_vehicles > 1:
            raise CapabilityError(
                f"{user}: takes tasks of one vehicle; this one has {self.num_vehicles} in each environment. Train and evaluate "
                "take it"
            )

    def parts(self) -> dict[str, Callable[[], None]]:
        """Return the parts of a step, to be timed one by one; each changes the simulation as within a step.

        ``reset`` resets a hundredth of the environments; ``rendering`` is missing without sensors. The rest of a step is
        the task's own computation.
        """
        few = torch.arange(self.num_envs, device=self.device) % 100 == 0
        entries: dict[str, Callable[[], None]] = {"physics": self.env.fly, "collision": self.env.collide}
        entries["reset"] = partial(self._reset_environments, few)
        if self.env.sensor_manager.casters:
            entries["rendering"] = self._read_sensors
        return entries

    @property
    def observation_terms(self) -> dict[str, list[ObservationEntry]]:
        """Terms in the order of their columns, by observation key."""
        return {group_key(group): entries for group, entries in self._observer.groups.items()}

    @property
    def target_position(self) -> Tensor:
        """Target position [m], world, (E, 3)."""
        return self.values.find(TARGET, "the caller")

    @property
    def episode_return(self) -> Tensor:
        """Sum of the rewards of the present episode, (E,)."""
        return self.values.own[SUMS][:, 0]

    @property
    def reward_names(self) -> tuple[str, ...]:
        """Names of the columns of ``info["reward_terms"]``."""
        return self._judge.reward_names

    def episode_means(self) -> dict[str, float]:
        """Return means over the episodes that ended since the last call, and clear them. Waits for the device.

        ``reward/<name>`` is the sum of a reward term over an episode, ``ended/<name>`` the share of episodes that a
        termination ended, ``episodes`` their number; of none there is only that.
        """
        return self._judge.episode_means()

    @property
    def tallies(self) -> Tensor:
        """Returns by term, number and ends of the episodes ended since the last ``episode_means``, (E, N)."""
        return self.values.own[TALLIES]

    def means_of_tallies(self, tallies: Tensor) -> dict[str, float]:
        """Return the means of ``episode_means`` from rows of ``tallies``. Waits for the device."""
        return self._judge.means_of_tallies(tallies)

    def _make_values(self, num_commands: int) -> Values:
        env = self.env
        sizes = {"E": self.num_envs, "U": num_commands, "V": self.num_actions, "R": env.robot_manager.cfg.num_rotors}
        simulation = env.robot_manager.differentiable
        graph = None if simulation is None else GradientGraph(simulation)
        makers = {**self._buffers.buffer_makers, STEP_TIME: self._declare_step_time}
        if self._around is not None:
            makers[NEAREST] = self._around.make_nearest
        values = Values(self._gtd, sizes=sizes, makers=makers, graph=graph, around=self._around)
        values.declare("begun", dtype=torch.bool, meaning="its episode has just begun", view=self._random.mask)
        return values

    def _make_buffer_kernel(self) -> StepKernel | None:
        """Return the kernel of values for the next step; None without any. Make it after all inputs are declared."""
        values, command, updates = self.values, self._command, dict(self.values.updates)

        def next_buffers(given: Mapping[str, Tensor]) -> dict[str, Tensor]:
            buffers = command.next_values(given)
            for name, term in updates.items():
                buffers[name] = term.evaluate({**given, **buffers})
            return buffers

        names = (*command.next_values(values), *updates)
        if not names:
            return None
        reads = {name: values.find(name, "the command") for name in ("sim_steps", "begun", *command.reads)}
        reads |= values.term_inputs(*updates.values())
        writes = {name: values[name] for name in names}
        return StepKernel(next_buffers, "the buffers for the next step", reads=reads, writes=writes, graph=values.graph)

    def _declare_step_time(self, values: Values, reader: str) -> Tensor:
        return values.declare(STEP_TIME, unit="s", meaning="time of a step", rows=False).fill_(self.env.dt)

    def state_tensors(self) -> dict[str, Tensor]:
        """Return everything on which the future depends, by name: tensors that keep their places, and digests."""
        curriculum = {} if self.curriculum is None else self.curriculum.state_tensors()
        entries = config_digests(task=self.cfg) | self.env.state_tensors()
        return entries | add_prefix("task", self.values.own.state_tensors()) | add_prefix("curriculum", curriculum)

    def random_tensors(self) -> dict[str, Tensor]:
        """Return seed, numbers and episodes of the environments, and episodes of several vehicles, by name."""
        vehicles = {"vehicle_episode": self._random.episode} if self.num_vehicles > 1 else {}
        return self.env.random.state_tensors() | vehicles

    def save_state(self) -> dict[str, Tensor]:
        """Return a copy of everything on which the future depends, the simulation included (``EnvManager.save_state``). The
        memory of a policy is not included."""
        return copy_tensors(self.state_tensors())

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Restore a state saved by this or an equal task; call ``reset`` once before. Waits for the device.

        Raises:
            ConfigError: If it is the state of another task or simulation; the message names the difference.
        """
        check_state(state, self.state_tensors())
        self.env.restore(state)
        restore_tensors(state, self.state_tensors())
        if self.values.graph is not None:
            self.values.graph.drop_values()

    def close(self) -> None:
        """Report non-finite rows not yet reported, and release the simulation; a later call raises ``ClosedError``."""
        self._watch.count_rows(wait=True)
        self._graph, self._capture_at_reset = None, False
        self.env.close()

    def __repr__(self) -> str:
        cfg, shapes = self.cfg, ", ".join(f"{key} {shape}" for key, shape in self.observation_shapes.items())
        vehicles = f" of {self.num_vehicles} vehicles" if self.num_vehicles > 1 else ""
        size = f"{self.env.num_envs} environments{vehicles} on {self.device}, episodes of {cfg.episode_len_steps} steps"
        spaces = f"each: {shapes}; action ({self.num_actions},); robot {cfg.robot}"
        return "\n  ".join((f"Task: {cfg.summary}", f"{size} of {self.env.dt:g} s", spaces))

    def __enter__(self) -> "Task":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
