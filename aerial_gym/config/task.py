"""What a task is made of: a simulation, observation terms, a reward, terminations, an episode length, a curriculum."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf

from aerial_gym.config.checks import require_count
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.robot import Vec3, require_finite
from aerial_gym.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class ObservationCfg:
    """One term of the observation."""

    term: str
    """Name in ``aerial_gym.task.observations.OBSERVATIONS``."""

    noise_std: float = 0.0
    """Standard deviation of white noise added to every entry, in the unit of the term, >= 0."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.noise_std < inf:
            raise ConfigError(f"ObservationCfg.noise_std = {self.noise_std!r}: must be >= 0 and finite")


@dataclass(frozen=True, kw_only=True)
class CurriculumCfg:
    """How many obstacles stand in every environment, by the share of episodes that succeed.

    The level is the number of obstacle rows in use, those that are always present included. After every ``check_after``
    finished episodes of all environments together it is raised, lowered or left, and holds from the next resets on.
    """

    min_level: int
    """Fewest rows, >= 0; at least the rows that the environment always keeps."""

    max_level: int
    """Most rows, > min_level; at most the rows of the environment."""

    check_after: int
    """Finished episodes between two decisions, >= 1."""

    raise_above: float
    """Share of successes above which the level is raised, lower_below <= raise_above <= 1."""

    lower_below: float
    """Share of successes below which it is lowered, 0 <= lower_below <= raise_above."""

    raise_by: int
    """Rows by which it is raised, >= 0."""

    lower_by: int
    """Rows by which it is lowered, >= 0; 0, and ``raise_by`` 0 as well, keeps the first level for ever."""

    start_level: int | None = None
    """First level, from min_level to max_level; min_level if not given."""

    def __post_init__(self) -> None:
        if not 0 <= self.min_level < self.max_level:
            raise ConfigError(
                f"CurriculumCfg: min_level = {self.min_level!r}, max_level = {self.max_level!r}: "
                "needs 0 <= min_level < max_level"
            )
        if self.check_after < 1:
            raise ConfigError(f"CurriculumCfg.check_after = {self.check_after!r}: must be >= 1")
        if not 0.0 <= self.lower_below <= self.raise_above <= 1.0:
            raise ConfigError(
                f"CurriculumCfg: lower_below = {self.lower_below!r}, raise_above = {self.raise_above!r}: "
                "needs 0 <= lower_below <= raise_above <= 1"
            )
        for name in ("raise_by", "lower_by"):
            if getattr(self, name) < 0:
                raise ConfigError(f"CurriculumCfg.{name} = {getattr(self, name)!r}: must be >= 0")
        if not self.min_level <= self.first_level <= self.max_level:
            raise ConfigError(
                f"CurriculumCfg.start_level = {self.start_level!r}: must lie in {self.min_level} to {self.max_level}"
            )

    @property
    def first_level(self) -> int:
        """Level at which a task begins."""
        return self.min_level if self.start_level is None else self.start_level


@dataclass(frozen=True, kw_only=True)
class TaskCfg:
    """A task."""

    summary: str
    """One line for people who choose a task."""

    sim: str
    """Registered sim."""

    env: str
    """Registered environment, or path of an environment file."""

    robot: str
    """Registered robot."""

    controller: str
    """Registered controller."""

    num_envs: int
    """Environments if the caller does not say, >= 1."""

    episode_len_steps: int
    """Steps after which an episode is truncated, >= 1."""

    randomize: Mapping[str, RandomizeCfg] = field(default_factory=dict)
    """What a reset draws anew, beside what robot and environment say; the same names replace it."""

    target: Vec3 = (0.0, 0.0, 0.0)
    """Where to fly [m], environment frame; not used where ``target_ratio_low`` is given."""

    target_ratio_low: Vec3 | None = None
    """Lowest target as a share of the bounds, 0 to 1; given with ``target_ratio_high``, a target is drawn uniformly at every
    reset, and obstacles whose place is drawn keep the environment's clearance from a robot there."""

    target_ratio_high: Vec3 | None = None
    """Highest target, likewise."""

    action: str = "direct"
    """Name in ``aerial_gym.task.actions.ACTIONS``: from what a policy gives to what the controller takes."""

    action_params: Mapping[str, float] = field(default_factory=dict)
    """Numbers of the action by name; every one that it has, and no other."""

    observations: tuple[ObservationCfg, ...]
    """Terms in the order in which they stand in the observation."""

    reward: str
    """Name in ``aerial_gym.task.rewards.REWARDS``."""

    reward_params: Mapping[str, float] = field(default_factory=dict)
    """Coefficients of the reward by name; every one that the reward has, and no other."""

    max_distance: float
    """The episode is terminated as a crash beyond this distance from the target [m], > 0."""

    success_radius: float | None = None
    """An episode that lasts to its end and is then closer than this to its target [m] is a success, > 0; None tells no
    successes apart."""

    curriculum: CurriculumCfg | None = None
    """Number of obstacles by the share of successes; None has all of them from the start."""

    source: str
    """Where the numbers come from."""

    def __post_init__(self) -> None:
        require_finite(self, "target", "max_distance")
        self._check_target_ratios()
        if self.success_radius is not None and not 0.0 < self.success_radius < inf:
            raise ConfigError(f"TaskCfg.success_radius = {self.success_radius!r}: must be > 0 and finite")
        if self.curriculum is not None and self.success_radius is None:
            raise ConfigError("TaskCfg.curriculum: needs success_radius, which says what a success is")
        require_count(self, "num_envs", "episode_len_steps")
        if self.max_distance <= 0:
            raise ConfigError(f"TaskCfg.max_distance = {self.max_distance!r}: must be > 0")
        if not self.observations:
            raise ConfigError("TaskCfg.observations: needs at least one term")

    def _check_target_ratios(self) -> None:
        low, high = self.target_ratio_low, self.target_ratio_high
        if (low is None) != (high is None):
            raise ConfigError("TaskCfg: give both target_ratio_low and target_ratio_high, or neither")
        if low is None or high is None:
            return
        if not all(0.0 <= a <= b <= 1.0 for a, b in zip(low, high, strict=True)):
            raise ConfigError(
                f"TaskCfg: target_ratio_low = {low!r}, target_ratio_high = {high!r}: "
                "needs 0 <= low <= high <= 1 on every axis. They are shares of the bounds"
            )
