"""Time step, gravity and numerical method of a simulation."""

from dataclasses import dataclass

from aerial_gym.config.checks import NO_SOURCE, require_finite, require_positive

STANDARD_GRAVITY = 9.81  # Default downward acceleration of free fall [m/s²] of sims and flights


@dataclass(frozen=True, kw_only=True)
class SimCfg:
    """Time step, gravity and integrator."""

    summary: str  # One line for people who choose a sim
    dt: float  # Physics step [s], > 0; the controller runs at this rate
    gravity: float = STANDARD_GRAVITY  # Downward acceleration of free fall [m/s²]
    integrator: str = "euler"  # Stepper: `euler` (semi-implicit, order 1) or `rk4` (order 4)
    backend: str = "auto"  # Name of a physics backend; `auto` takes the fastest that is registered
    source: str = NO_SOURCE  # Source of the numbers

    def __post_init__(self) -> None:
        require_positive(self, "dt")
        require_finite(self, "gravity")
