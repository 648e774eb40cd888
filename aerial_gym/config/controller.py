"""Gains and limits of the controllers."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from typing import ClassVar, Literal

from aerial_gym.config.autopilots import (
    BetaflightCfg,
    BrescianiniCfg,
    CrazyflieLeeCfg,
    CrazyfliePidCfg,
    MellingerCfg,
    Px4Cfg,
)
from aerial_gym.config.checks import NO_SOURCE, Vec3, require, require_choice, require_not_negative, require_positive
from aerial_gym.errors import ConfigError

_DRAWN_BY_NAME = (
    "gains have no ranges of their own: give each gain as one number per axis (position: [2.5, 2.5, 1.5]) and random gains by "
    "name, randomize: {gains.position: {how: value, low: [2.0, 2.0, 1.0], high: [3.0, 3.0, 2.0]}} (docs/guides/randomise.md)"
)

AUTOPILOTS = ("px4", "betaflight", "mellinger", "crazyflie_pid", "crazyflie_lee", "brescianini")
"""Fields of ``ControllerCfg`` and ``ControlCfg`` with the parameters of a real autopilot; a controller has one at most."""

EFFECTIVENESS = ("nominal", "actual")  # Of which vehicle an allocation inverts the control effectiveness


@dataclass(frozen=True, kw_only=True)
class LeeGainsCfg:
    """Explicit gains of the geometric controllers; ``gains.NAME`` of ``randomize:`` draws them per environment."""

    MOVED: ClassVar[Mapping[str, str]] = {
        "randomize": _DRAWN_BY_NAME,
        **{
            f"{name}_gain_{end}": _DRAWN_BY_NAME
            for name in ("position", "velocity", "attitude", "rate")
            for end in ("low", "high")
        },
    }

    position: Vec3  # Acceleration per position error [1/s²], >= 0, world axes
    velocity: Vec3  # Acceleration per velocity error [1/s], >= 0, world axes
    attitude: Vec3  # Torque per attitude error [N m/rad], >= 0, body axes
    rate: Vec3  # Torque per rate error [N m s/rad], >= 0, body axes
    max_yaw_rate: float  # Yaw rate commands are clamped to this [rad/s], > 0
    max_inclination: float  # Largest tilt of position, velocity and acceleration control [rad], > 0 and < pi/2
    source: str = NO_SOURCE  # Source of the numbers

    def __post_init__(self) -> None:
        require_positive(self, "max_yaw_rate", "max_inclination")
        require(self, "max_inclination", self.max_inclination < pi / 2, "must be below pi/2")
        require_not_negative(self, "position", "velocity", "attitude", "rate")


@dataclass(frozen=True, kw_only=True)
class ControlCfg:
    """Control settings of a robot; missing ones follow from its inertia, rotor lag, thrust limits and the time step.

    The attitude loop has the natural frequency w and the damping ratio z, so the torque is ``J w²`` per rad and ``2 z w J`` per
    rad/s; the position loop likewise gives the acceleration ``w²`` per m and ``2 z w`` per m/s. ``control.gains`` derives both.
    """

    phase_margin: float = pi / 4
    """Of the attitude loop, and of the position loop around it, at their crossovers [rad], > 0 and < pi/2: the more, the
    calmer and the slower."""

    attitude_frequency: Vec3 | None = None
    """Natural frequencies about the body axes [rad/s], >= 0, in place of the derived ones; 0 leaves an axis alone."""

    attitude_damping: Vec3 | None = None  # Damping ratios about the body axes, >= 0, in place of the derived ones
    position_frequency: Vec3 | None = None  # Natural frequencies along world axes [rad/s], >= 0; default: derived
    position_damping: Vec3 | None = None  # Damping ratios along the world axes, >= 0, in place of the derived ones
    max_yaw_rate: float = pi / 3  # Limit of yaw rate commands [rad/s], > 0; default of the Aerial Gym Simulator

    max_inclination: float | None = None
    """Largest tilt that position, velocity and acceleration control ask for [rad], > 0 and < pi/2. If not given it leaves half
    of the thrust beyond the weight for climbing and turning, and is pi/3 at most."""

    buoyancy: float = 0.0  # Buoyancy that the autopilot assumes [N], >= 0: the value of the effect `buoyancy`, if known
    gains: LeeGainsCfg | None = None  # Explicit gains in place of all above, identified or published for this robot
    px4: Px4Cfg | None = None  # Parameters of PX4's cascade, as flown or published for this robot; derived if not given
    betaflight: BetaflightCfg | None = None  # Parameters of Betaflight's rate loop, likewise
    mellinger: MellingerCfg | None = None  # Parameters of the Crazyflie's Mellinger controller, likewise
    crazyflie_pid: CrazyfliePidCfg | None = None  # Parameters of the Crazyflie's cascade of PID controllers, likewise
    crazyflie_lee: CrazyflieLeeCfg | None = None  # Parameters of the Crazyflie's controller of Lee, likewise
    brescianini: BrescianiniCfg | None = None  # Parameters of the Crazyflie's controller of Brescianini, likewise

    effectiveness: str = "nominal"
    """``nominal`` or ``actual``: which control effectiveness matrix the allocation inverts, and with which thrust maps it goes
    on to the rotors. With ``nominal`` those of the robot file, one for all; with ``actual`` those of each environment's own
    vehicle, with what a reset has drawn and the effects on its parameters. Gains are those of the robot file in either case."""

    source: str = "Derived: aerial_gym.control.gains"  # Source of the numbers

    def __post_init__(self) -> None:
        require_choice(self, "effectiveness", EFFECTIVENESS)
        require(self, "phase_margin", 0.0 < self.phase_margin < pi / 2, "must be > 0 and < pi/2 rad")
        require_not_negative(self, "attitude_frequency", "attitude_damping", "position_frequency", "position_damping")
        require_positive(self, "max_yaw_rate", "max_inclination")
        require_not_negative(self, "buoyancy")
        require(self, "max_inclination", (self.max_inclination or 0.0) < pi / 2, "must be below pi/2")


@dataclass(frozen=True, kw_only=True)
class RateLoopCfg:
    """A controller of body rates with memory, as flight firmware has it: proportional, integral and filtered derivative action.

    The desired angular acceleration is ``P e + I - D``: e is the rate error, I the integral of ``integral e``, and D the
    low-passed angular acceleration times ``derivative``. Under saturation of an axis I grows no further in
    that direction. Missing values are derived (``control.gains``).
    """

    rate_hz: float | None = None  # Rate [1/s], > 0, a whole number of physics steps; default: every physics step
    proportional: Vec3 | None = None  # Angular acceleration per rate error [1/s], >= 0, body axes
    integral: Vec3 | None = None  # Growth of angular acceleration per rate error [1/s²], >= 0, body axes; 0 for none

    integral_limit: Vec3 | None = None
    """Largest angular acceleration of the integral [rad/s²], > 0. If not given it is half of what the rotors can give at
    hover."""

    derivative: Vec3 = (0.0, 0.0, 0.0)
    """Share of the measured angular acceleration that is taken back [-], >= 0; 0 for none. It is not derived: what it gains
    depends on the noise of the gyro."""

    cutoff_hz: float | None = None  # Of the first-order low-pass on the derivative [1/s], > 0; no low-pass if not given
    source: str = "Derived: aerial_gym.control.gains"  # Source of the numbers

    def __post_init__(self) -> None:
        require_positive(self, "rate_hz", "cutoff_hz")
        require_not_negative(self, "proportional", "integral", "derivative", "integral_limit")


@dataclass(frozen=True, kw_only=True)
class ControllerCfg:
    """A controller: law, gains, and priorities under rotor saturation."""

    summary: str  # One line for people who choose a controller
    law: str  # Name in `aerial_gym.control.laws.LAWS` or `aerial_gym.control.CONTROL_LAWS`
    gains: LeeGainsCfg | None = None  # Explicit gains for any robot; if not given, the robot's own (`RobotCfg.control`)

    allocation: Literal["prioritised", "clamp"] = "prioritised"
    """Priority under rotor saturation: with ``prioritised`` yaw first, then thrust, then roll and pitch; with
    ``clamp`` each rotor by itself. Where no rotor is, both are the pseudo-inverse."""

    rate_loop: RateLoopCfg | None = None
    """A loop with memory between the law and the rotors: the law then wants body rates of it. None where the law itself
    asks for torque."""

    px4: Px4Cfg | None = None
    """PX4's cascade with these parameters in place of gains and rate loop; those of the robot if all are left out."""

    betaflight: BetaflightCfg | None = None  # Betaflight's rate loop with these parameters, likewise
    mellinger: MellingerCfg | None = None  # The Crazyflie's Mellinger controller, likewise
    crazyflie_pid: CrazyfliePidCfg | None = None  # The Crazyflie's cascade of PID controllers, likewise
    crazyflie_lee: CrazyflieLeeCfg | None = None  # The Crazyflie's controller of Lee, with integrals, likewise
    brescianini: BrescianiniCfg | None = None  # The Crazyflie's controller of Brescianini, likewise

    rate_hz: float | None = None
    """Rate of the law [1/s], > 0; every physics step, or with a rate loop as often as that, if not given. What it
    wants is held in between."""

    delay: float = 0.0  # Delay between the law and its rate loop [s], >= 0: a whole number of physics steps

    action_delay: float = 0.0
    """Until an action has reached the law [s], >= 0: a whole number of physics steps. The first one after a reset acts at
    once."""

    if_unstable: Literal["refuse", "warn"] = "refuse"
    """Whether a vehicle that these gains do not hold at hover is refused, or flies with a warning, to reproduce someone's
    result as it is."""

    def __post_init__(self) -> None:
        require_positive(self, "rate_hz")
        require_not_negative(self, "delay", "action_delay")
        own = [name for name in AUTOPILOTS if getattr(self, name) is not None]
        if own and (self.rate_loop is not None or self.gains is not None):
            raise ConfigError(f"ControllerCfg.{own[0]}: has its own gains and rate loop. Leave gains and rate_loop out")
        if len(own) > 1:
            raise ConfigError(f"ControllerCfg: {' and '.join(own)} are {len(own)} autopilots. Leave all but one out")
        holds = self.delay == 0.0 or self.rate_settings is not None
        require(self, "delay", holds, "there is no rate loop to reach. Give rate_loop, or action_delay")
        require_choice(self, "if_unstable", ("refuse", "warn"))
        require_choice(self, "allocation", ("prioritised", "clamp"))

    @property
    def rate_settings(self) -> RateLoopCfg | Px4Cfg | BetaflightCfg | CrazyfliePidCfg | BrescianiniCfg | None:
        """Settings of the body-rate loop: of an autopilot, else ``rate_loop``; None without one."""
        return self.px4 or self.betaflight or self.crazyflie_pid or self.brescianini or self.rate_loop

    @property
    def autopilot(self) -> str | None:
        """Name of the autopilot in ``AUTOPILOTS``; None for other laws."""
        return next((name for name in AUTOPILOTS if getattr(self, name) is not None), None)
