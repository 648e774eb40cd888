"""Task files: simulation, commands, actions, observations, rewards, ends of episodes, curriculum."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf
from typing import ClassVar

from aerial_gym.config.checks import NO_SOURCE, refuse, require, require_count
from aerial_gym.config.environment import EnvironmentCfg
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.robot import InitialStateCfg
from aerial_gym.config.task_terms import (
    ActionCfg,
    CommandCfg,
    EndRewardCfg,
    FaultCfg,
    ImageCfg,
    ObservationCfg,
    RewardCfg,
    TerminationCfg,
)

POLICY = "policy"  # Group of observations that the policy sees
OBSERVATIONS = "observations"  # Name under which a task gives the group `policy`; no other group or image has it
ENDS = ("crash", "success")  # Names under which rewards of ends are logged, reserved for them


@dataclass(frozen=True, kw_only=True)
class CurriculumCfg:
    """Difficulty, and number of obstacles per environment, as a function of the share of successful episodes.

    The level is the number of obstacle rows in use, those that are always present included. After every ``check_after``
    finished episodes of all environments together it is raised, lowered or left, and holds from the next resets on. Without
    obstacles it is a number whose share of the range, ``difficulty``, weighs rewards and is an input of terms.
    """

    min_level: int  # Fewest rows, >= 0; at least the rows that the environment always keeps
    max_level: int  # Most rows, > min_level; at most the rows of the environment
    check_after: int  # Finished episodes between two decisions, >= 1
    raise_above: float  # Share of successes above which the level is raised, lower_below <= raise_above <= 1
    lower_below: float  # Share of successes below which it is lowered, 0 <= lower_below <= raise_above
    raise_by: int  # Rows by which it is raised, >= 0
    lower_by: int  # Rows by which it is lowered, >= 0; 0, and `raise_by` 0 as well, keeps the first level for ever
    start_level: int | None = None  # First level, from min_level to max_level; min_level if not given

    def __post_init__(self) -> None:
        low, high = self.min_level, self.max_level
        require(self, "min_level", 0 <= low < high, f"must be >= 0 and below max_level = {high!r}")
        require(self, "check_after", self.check_after >= 1, "must be >= 1")
        holds = 0.0 <= self.lower_below <= self.raise_above <= 1.0
        require(self, "lower_below", holds, f"must be 0 to raise_above = {self.raise_above!r}, which is 1 at most")
        for name in ("raise_by", "lower_by"):
            require(self, name, getattr(self, name) >= 0, "must be >= 0")
        require(self, "start_level", low <= self.first_level <= high, f"must lie in {low} to {high}")

    @property
    def first_level(self) -> int:
        """Level at which a task begins."""
        return self.min_level if self.start_level is None else self.start_level


@dataclass(frozen=True, kw_only=True)
class TaskCfg:
    """A task: configuration of terms (``docs/guides/own_task.md``)."""

    MOVED: ClassVar[Mapping[str, str]] = {
        "target": "give command: {generator: point, params: {position: [x, y, z]}}",
        "target_ratio_low": "give command: {generator: drawn_point, params: {low: [...], high: [...]}}",
        "target_ratio_high": "give command: {generator: drawn_point, params: {low: [...], high: [...]}}",
        "action_params": "give action: {transform: NAME, params: {...}}",
        "reward": "give rewards: {NAME: {term: ..., weight: ..., params: {...}}, ...}, a sum of terms",
        "reward_params": "each of the rewards has params of its own; that of a crash is crash_reward: {value: ...}",
        "max_distance": "give terminations: {NAME: {term: far_from_target, kind: crash, params: {distance: ...}}}",
        "success_radius": (
            "give terminations: {NAME: {term: at_target, kind: success, when: at_end, params: {radius: ...}}}"
        ),
    }
    """Fields that it no longer has."""

    ABSENT: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("robots", "vehicles"), "a task has vehicles of one kind. Give robot, and their number as num_vehicles"
    )
    """Fields that tasks of other simulators have."""

    summary: str  # One line for people who choose a task
    sim: str  # Registered sim
    env: str | EnvironmentCfg  # Registered environment, path of an environment file, or an environment itself
    robot: str  # Registered robot
    controller: str  # Registered controller
    num_envs: int  # Default number of environments, >= 1
    episode_len_steps: int  # Steps after which an episode times out, >= 1
    num_vehicles: int = field(default=1, repr=False)  # a saved state has the digest of the repr
    """Vehicles in every environment, >= 1, all with this robot and controller; the rows of a task are its vehicles."""

    share_reward: bool = field(default=False, repr=False)  # likewise
    """Whether each vehicle gets the mean reward of its environment; needs an environment with ``reset_together``."""

    start: InitialStateCfg | None = None  # Initial state of episodes in place of the robot's own, used by `make_task`
    time_out_bootstraps: bool = True  # Whether the value goes on after that end (`truncated`), or is 0 (`terminated`)

    randomize: Mapping[str, RandomizeCfg] = field(default_factory=dict)
    """Quantities drawn at every reset, in addition to those of robot and environment; equal names replace them."""

    command: CommandCfg | None = field(default_factory=lambda: CommandCfg(generator="point"))
    """Command generator; None for a task without a target."""

    action: ActionCfg = field(default_factory=ActionCfg)  # Conversion of actions to controller commands

    observations: Mapping[str, tuple[ObservationCfg, ...]]
    """Groups of terms in the order in which they stand side by side: ``policy``, and as many others as wanted, such as
    ``critic`` with what only a simulation knows."""

    faults: Mapping[str, FaultCfg] = field(default_factory=dict)  # Sensor faults by the names in observations

    encoder: str | None = None
    """Encoder file (``aerial-gym train-encoder``), or one that comes with the package, whose latents of the first range
    sensor's image the term ``image_latents`` shows."""

    images: Mapping[str, ImageCfg] = field(default_factory=dict)  # Raw images besides the groups, by observation key
    rewards: Mapping[str, RewardCfg]  # Reward terms by the names under which they are logged; the reward is their sum
    crash_reward: EndRewardCfg | None = None  # Reward of a crash; None: that of the terms alone
    success_reward: EndRewardCfg | None = None  # Reward of a success in the step in which it counts, likewise
    terminations: Mapping[str, TerminationCfg]  # Conditions that end episodes, besides the time limit, by name
    curriculum: CurriculumCfg | None = None  # Number of obstacles by the share of successes; None: all from the start

    imports: tuple[str, ...] = ()
    """Python files, from the folder of the task's own file on, or modules, that register what this task chooses by name."""

    source: str = NO_SOURCE  # Source of the numbers

    def __post_init__(self) -> None:
        require_count(self, "num_envs", "episode_len_steps", "num_vehicles")
        if not self.rewards:
            refuse("TaskCfg.rewards: needs at least one")
        if not self.observations.get(POLICY):
            refuse(f"TaskCfg.observations: needs a group {POLICY!r} of at least one term")
        for name in (*self.observations, *self.images):
            if name == OBSERVATIONS or (name in self.observations and name in self.images):
                refuse(f"TaskCfg: observation {name!r}: the name is taken. Choose another")
        self._check_reward_factors()
        self._check_fault_names()
        if self.success_reward is not None and not self._successes:
            refuse("TaskCfg.success_reward: needs a termination of kind success")
        if self.curriculum is not None and not self._successes:
            refuse("TaskCfg.curriculum: needs a termination of kind success, which defines it")
        radius = self.success_radius
        if radius is not None and not 0.0 < radius < inf:
            refuse(f"TaskCfg.terminations: radius = {radius!r}: must be > 0 and finite")

    def _check_fault_names(self) -> None:
        named = {term.fault for group in self.observations.values() for term in group if term.fault is not None}
        for name in sorted(named - set(self.faults)):
            refuse(f"TaskCfg.observations: no fault {name!r}. Known: {', '.join(self.faults) or 'none'}")
        for name in sorted(set(self.faults) - named):
            refuse(f"TaskCfg.faults.{name}: no observation has it. Give one fault: {name}")

    def _check_reward_factors(self) -> None:
        for name, reward in self.rewards.items():
            if name in ENDS:
                refuse(f"TaskCfg.rewards.{name}: the name is that of {name}_reward. Choose another")
            for other in reward.times:
                if other not in self.rewards:
                    known = ", ".join(self.rewards)
                    refuse(f"TaskCfg.rewards.{name}.times: no reward {other!r}. Known: {known}")
                elif self.rewards[other].times:
                    refuse(f"TaskCfg.rewards.{name}.times: reward {other!r} is multiplied by others itself")

    @property
    def _successes(self) -> list[TerminationCfg]:
        return [each for each in self.terminations.values() if each.kind == "success"]

    @property
    def defines_success(self) -> bool:
        """Whether the task defines success."""
        return bool(self._successes)

    @property
    def success_radius(self) -> float | None:
        """Success radius around the target [m]: ``radius`` of the first success that has one."""
        radii = (each.params["radius"] for each in self._successes if "radius" in each.params)
        radius = next(radii, None)
        return float(radius) if isinstance(radius, (int, float)) else None
