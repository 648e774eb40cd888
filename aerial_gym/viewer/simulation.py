"""A running simulation as the page flies it: a task with a policy, or a controller alone, in steps.

Letters: E environments, V entries of an action.
"""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import CapabilityError
from aerial_gym.physics.rotors import rotor_thrust
from aerial_gym.task.commands.command import TARGET
from aerial_gym.viewer.effects import effect_forces, effect_switches
from aerial_gym.viewer.snapshot import Array, Snapshot, SnapshotReader

if TYPE_CHECKING:
    from aerial_gym.task import Task

Pilot = Callable[[Mapping[str, Tensor]], Tensor]  # Actions (E, V) for observations
FULL_STICK = {"m/s": 2.0, "m/s²": 3.0, "rad/s": 1.5, "rad": 0.4, "weights": 0.5, "-": 1.0}
"""Command at full stick, by the unit of an entry of the action."""
GOAL_M_S = 1.0  # Speed at which a full stick moves the goal of a position controller [m/s], or turns it [rad/s]
PULL = 8.0  # Acceleration per distance of the pointer that pulls a vehicle [1/s²]


class FlightInView:
    """Steps of a simulation, with the changes that the page makes."""

    def __init__(self, env: EnvManager, task: "Task | None" = None, pilot: Pilot | None = None) -> None:
        """Take a simulation, its task and the pilot of the task; without a task a controller holds where episodes begin."""
        if env.vehicles is not None:
            raise CapabilityError("view: shows environments with one vehicle each. Leave robots out")
        self.env, self._task, self._pilot = env, task, pilot
        names = env.robot_manager.action_names
        self._goals: Tensor | None = None
        if task is None and names[:3] == ("x [m]", "y [m]", "z [m]"):
            self._goals = torch.zeros(env.num_envs, 3, device=env.device)
        width = len(names) if task is None else task.num_actions
        self.action_names = names if width == len(names) else tuple(f"action {i + 1}" for i in range(width))
        """Meaning of each entry of an action."""
        units = [name.rpartition("[")[2].rstrip("]") for name in self.action_names]
        scales = [1.0 if task is not None else FULL_STICK.get(unit, 1.0) for unit in units]
        self._scale = torch.tensor(scales, device=env.device)
        self._actions = torch.zeros(env.num_envs, width, device=env.device)
        self._rest = torch.zeros_like(self._actions)  # Commands without sticks
        self.sticks = torch.zeros(width)
        """Sticks of the page, -1 to 1, (V,)."""
        self.by_hand = False
        """Whether the sticks fly the chosen environment's vehicle."""
        self.chosen = 0
        """Number of the chosen environment."""
        self.pull: Array | None = None
        """Point towards which the pointer pulls the chosen vehicle [m], world, (3,)."""
        self._observation: Mapping[str, Tensor] = {}
        self.reset()
        if task is None:
            self._set_hover()
        self.effects = effect_switches(env)
        """Effects that can be changed in flight."""
        values = {} if self._goals is None else {TARGET: self._goals}
        self._reader = SnapshotReader(env, values if task is None else task.values.own)
        self.content = self._reader.content

    @property
    def has_task(self) -> bool:
        """Whether a task gives observations and ends episodes."""
        return self._task is not None

    def _set_hover(self) -> None:
        """Let commands of single rotors rest at hover, and half of it be a full stick."""
        manager = self.env.robot_manager
        speed = manager.tensors.state.rotor_speed
        for rows, start, unit in (
            (speed, "speed", "[rad/s]"),
            (rotor_thrust(manager.declared, speed), "thrust", "[N]"),
        ):
            for number, name in enumerate(self.action_names[: speed.shape[1]]):
                if name.startswith(start) and name.endswith(unit):
                    self._rest[:, number] = rows[:, number]
                    self._scale[number] = 0.5 * rows[0, number]

    def reset(self) -> None:
        """Begin new episodes everywhere."""
        if self._task is not None:
            self._observation, _ = self._task.reset()
            self._reset_pilot(None)
            return
        self.env.reset()
        self._hold_start(torch.ones(self.env.num_envs, dtype=torch.bool, device=self.env.device))
        self.env.render()

    def _reset_pilot(self, ended: Tensor | None) -> None:
        reset = getattr(self._pilot, "reset", None)
        if reset is not None:
            reset(ended)

    def _hold_start(self, begun: Tensor) -> None:
        if self._goals is not None:
            self._goals[begun] = self.env.gtd["robot_position"][begun]
            self._actions[begun] = 0.0

    @torch.no_grad()
    def step(self) -> None:
        """Advance by an environment step; episodes begin anew where they end, without a task after a crash or far outside."""
        pull = self.pull  # which another thread sets
        if pull is not None:
            state = self.env.robot_manager.tensors.state
            offset = state.position.new_tensor(pull) - state.position[self.chosen]
            state.lin_vel[self.chosen] += PULL * self.env.dt * offset
        actions = self._next_actions()
        if self._task is not None:
            self._observation, _, terminated, truncated, _ = self._task.step(actions)
            self._reset_pilot(terminated | truncated)
            return
        self.env.step(actions)
        ended = self.env.gtd.plain("crashes") | self._has_left()
        if bool(ended.any()):
            self.env.reset(ended)
            self._hold_start(ended)
        self.env.render()

    def _has_left(self) -> Tensor:
        """Return whether a vehicle is further from its room than the room is long, bool (E,)."""
        place, low, high = (self.env.gtd.plain(key) for key in ("robot_position", "env_bounds_min", "env_bounds_max"))
        reach = (high - low).amax(dim=-1, keepdim=True)
        return ((place < low - reach) | (place > high + reach)).any(dim=-1)

    def _next_actions(self) -> Tensor:
        actions, sticks = self._actions, self.sticks.to(self.env.device) if self.by_hand else None
        if self._goals is not None:
            if sticks is not None:
                shift = GOAL_M_S * self.env.dt * sticks
                self._goals[self.chosen] += shift[:3]
                actions[self.chosen, 3:] += shift[3:]
            actions[:, :3] = self._goals
            return actions
        actions.copy_(self._rest if self._pilot is None else self._pilot(self._observation))
        if sticks is not None:
            actions[self.chosen] = self._rest[self.chosen] + self._scale * sticks
        return actions

    def choose(self, number: int) -> None:
        """Choose an environment; a number beyond the last takes that one."""
        self.chosen = min(max(number, 0), self.env.num_envs - 1)

    def push(self, change: tuple[float, float, float]) -> None:
        """Change the velocity of the chosen vehicle at once [m/s], world."""
        velocity = self.env.robot_manager.tensors.state.lin_vel
        velocity[self.chosen] += velocity.new_tensor(change)

    def move_goal(self, place: tuple[float, float, float]) -> None:
        """Move the goal of the chosen environment [m], world; a goal that its command computes anew stays."""
        goals = self._goals if self._task is None else self._task.values.own[TARGET]
        if goals is not None:
            goals[self.chosen] = goals.new_tensor(place)

    def snapshot(self, *, forces: bool = True) -> Snapshot:
        """Return the present state; without ``forces`` that of effects is left out."""
        told = effect_forces(self.env, self.chosen) if forces else {}
        return self._reader.read(self.chosen, forces=told)


def constant_pilot(task: "Task") -> Pilot:
    """Return a pilot whose actions are zero."""
    actions = torch.zeros(task.num_envs, task.num_actions, device=task.device)
    return lambda _: actions


def random_pilot(task: "Task", seed: int) -> Pilot:
    """Return a pilot of uniform random actions."""
    generator = torch.Generator().manual_seed(seed)
    size = (task.num_envs, task.num_actions)
    return lambda _: (2.0 * torch.rand(size, generator=generator) - 1.0).to(task.device)
