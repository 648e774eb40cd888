"""Contact of a robot with ground and obstacles: compliant, with friction."""

from dataclasses import dataclass
from math import inf

from aerial_gym.config.checks import require, require_not_negative, require_positive
from aerial_gym.config.sim import STANDARD_GRAVITY


@dataclass(frozen=True, kw_only=True)
class ContactCfg:
    """A spring, a damper and Coulomb friction at every collision sphere; they scale with the robot's mass."""

    friction: float  # Coulomb coefficient, friction per normal force, >= 0

    sinking: float = 1e-3
    """Depth to which the robot's weight on Earth presses one sphere into a surface [m], > 0. The default is the rest offset
    of PhysX in the Aerial Gym Simulator."""

    damping_ratio: float = 1.0  # Damping of the robot's mass on one sphere per critical damping, >= 0; 1: no bounce

    crash_speed: float = 0.0
    """A touch is a crash where the surfaces approach at this speed or faster [m/s], >= 0: every touch with 0, none with inf."""

    def __post_init__(self) -> None:
        require_positive(self, "sinking")
        require_not_negative(self, "friction", "damping_ratio")
        require(self, "crash_speed", self.crash_speed >= 0.0, "must be >= 0; .inf for no crash at all")

    @property
    def stiffness(self) -> float:
        """Spring constant per mass of the robot [1/s²]."""
        return STANDARD_GRAVITY / self.sinking

    @property
    def damping(self) -> float:
        """Damping constant per mass of the robot [1/s]."""
        return 2.0 * self.damping_ratio * self.stiffness**0.5

    @property
    def least_approach(self) -> float:
        """Approach speed from which a touch is a crash [m/s]; -inf if every touch is one, even when separating."""
        return self.crash_speed if self.crash_speed > 0.0 else -inf
