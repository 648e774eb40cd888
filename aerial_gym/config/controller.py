"""Gains and limits of the controllers."""

from dataclasses import dataclass

from aerial_gym.config.robot import Vec3, require_finite, require_ordered, require_positive
from aerial_gym.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class LeeGainsCfg:
    """Ranges of the gains of the geometric controllers; the middle is used unless ``randomize`` draws per environment."""

    position_gain_low: Vec3
    """Acceleration per position error [1/s²], world axes."""

    position_gain_high: Vec3
    """Upper end [1/s²]."""

    velocity_gain_low: Vec3
    """Acceleration per velocity error [1/s], world axes."""

    velocity_gain_high: Vec3
    """Upper end [1/s]."""

    attitude_gain_low: Vec3
    """Torque per attitude error [N m/rad], body axes."""

    attitude_gain_high: Vec3
    """Upper end [N m/rad]."""

    rate_gain_low: Vec3
    """Torque per rate error [N m s/rad], body axes."""

    rate_gain_high: Vec3
    """Upper end [N m s/rad]."""

    max_yaw_rate: float
    """Yaw rate commands are clamped to this [rad/s], > 0."""

    max_inclination: float
    """Largest tilt that position, velocity and acceleration control ask for [rad], > 0 and < pi/2."""

    randomize: bool = False
    """Whether a reset draws new gains per environment."""

    source: str
    """Where the numbers come from."""

    def __post_init__(self) -> None:
        require_positive(self, "max_yaw_rate", "max_inclination")
        if self.max_inclination >= 1.57:
            raise ConfigError(f"LeeGainsCfg.max_inclination = {self.max_inclination!r}: must be below pi/2")
        for name in ("position", "velocity", "attitude", "rate"):
            low, high = f"{name}_gain_low", f"{name}_gain_high"
            require_finite(self, low, high)
            require_ordered(self, low, high)
            if min(getattr(self, low)) < 0.0:
                raise ConfigError(f"LeeGainsCfg.{low} = {getattr(self, low)!r}: must be >= 0")


@dataclass(frozen=True, kw_only=True)
class ControllerCfg:
    """A controller: which law, with which gains."""

    summary: str
    """One line for people who choose a controller."""

    law: str
    """Name in ``aerial_gym.control.laws.LAWS``."""

    gains: LeeGainsCfg | None = None
    """Needed by the geometric laws."""
