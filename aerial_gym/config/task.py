"""What a task is made of: a simulation, observation terms, a reward, terminations and an episode length."""

from collections.abc import Mapping
from dataclasses import dataclass, field

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
        if not 0.0 <= self.noise_std < float("inf"):
            raise ConfigError(f"ObservationCfg.noise_std = {self.noise_std!r}: must be >= 0 and finite")


@dataclass(frozen=True, kw_only=True)
class TaskCfg:
    """A task."""

    summary: str
    """One line for people who choose a task."""

    sim: str
    """Registered sim."""

    env: str
    """Registered environment."""

    robot: str
    """Registered robot."""

    controller: str
    """Registered controller."""

    num_envs: int
    """Environments if the caller does not say, >= 1."""

    episode_len_steps: int
    """Steps after which an episode is truncated, >= 1."""

    target: Vec3 = (0.0, 0.0, 0.0)
    """Where to fly [m], environment frame."""

    observations: tuple[ObservationCfg, ...]
    """Terms in the order in which they stand in the observation."""

    reward: str
    """Name in ``aerial_gym.task.rewards.REWARDS``."""

    reward_params: Mapping[str, float] = field(default_factory=dict)
    """Coefficients of the reward by name; every one that the reward has, and no other."""

    max_distance: float
    """The episode is terminated as a crash beyond this distance from the target [m], > 0."""

    source: str
    """Where the numbers come from."""

    def __post_init__(self) -> None:
        require_finite(self, "target", "max_distance")
        for name in ("num_envs", "episode_len_steps", "max_distance"):
            if getattr(self, name) <= 0:
                raise ConfigError(f"TaskCfg.{name} = {getattr(self, name)!r}: must be > 0")
        if not self.observations:
            raise ConfigError("TaskCfg.observations: needs at least one term")
