"""Vehicles of an environment: an entry of ``robots:`` in an environment file, or of ``build_env(robots=[...])``, and their
radio network."""

from dataclasses import dataclass

from aerial_gym.config import checks


@dataclass(frozen=True, kw_only=True)
class VehiclesCfg:
    """Vehicles of one kind: robot and controller."""

    name: str  # Registered robot, or a robot file
    count: int = 1  # Vehicles in every environment, >= 1
    controller: str = ""  # Registered controller; empty for that of the call
    kind: str = ""  # Name of the kind; empty for the name of the robot. Two kinds have different names

    def __post_init__(self) -> None:
        checks.require(self, "name", bool(self.name), "must not be empty")
        checks.require_count(self, "count", most=checks.MAX_MADE)


@dataclass(frozen=True, kw_only=True)
class NetworkCfg:
    """One network for all vehicles of an environment. In each environment step, each vehicle sends its state to each other one.

    A vehicle knows the last state that has reached it. An episode begins with the states at its start.
    """

    latency_s: float = 0.0  # Time from a state to its reception [s], >= 0, rounded to whole environment steps
    dropout: float = 0.0  # Probability that a message is lost, of each pair and step by itself, 0 <= dropout < 1
    needs_line_of_sight: bool = False  # Whether obstacles and ground between two vehicles block their messages

    def __post_init__(self) -> None:
        checks.require_not_negative(self, "latency_s")
        checks.require(self, "dropout", 0.0 <= self.dropout < 1.0, "must be a probability, 0 <= dropout < 1")
