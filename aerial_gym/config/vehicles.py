"""Vehicles of an environment (``robots:`` in its file, or of ``build_env``), their radio network and shared payload."""

from dataclasses import dataclass
from math import pi, sin

from aerial_gym.config import checks
from aerial_gym.config.checks import Vec3

CABLES = ("rigid", "slack")  # Rigid links, which also push, or cables that only pull
MOST_CARRIERS = 4  # Largest number of vehicles that carry one payload


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


@dataclass(frozen=True, kw_only=True)
class PayloadCfg:
    """A point mass that all vehicles of an environment carry together, each on one cable without mass."""

    mass: float  # Mass [kg], > 0
    cable_length: float  # Length of every cable [m], > 0
    cables: str = "slack"  # `slack` cables only pull; `rigid` ones keep their length and also push
    anchor: Vec3 = (0.0, 0.0, 0.0)  # End of the cable on its vehicle, from the body origin [m], body
    angle: float = 0.5  # Angle of the cables to the vertical where an episode starts [rad], 0 to pi/2

    def __post_init__(self) -> None:
        checks.require_positive(self, "mass", "cable_length")
        checks.require_choice(self, "cables", CABLES)
        checks.require_finite(self, "anchor")
        checks.require(self, "angle", 0.0 <= self.angle < pi / 2.0, "must be 0 to pi/2 rad")

    def start_distance(self, count: int) -> float:
        """Return the distance between two neighbours of ``count`` vehicles where an episode starts [m]."""
        return 2.0 * self.cable_length * sin(self.angle) * sin(pi / count)
