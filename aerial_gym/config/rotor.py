"""One rotor type: state, thrust and drag torque, lag and limits.

In speed mode the state of a rotor is its speed [rad/s], in force mode its thrust [N]; lag, slew rate and dead band are those of
the state. A rotor whose thrust may be negative is reversible: its state has a sign. At a negative speed it gives the thrust
of ``reverse_thrust_map`` at the absolute speed, against its axis, and the opposite drag torque.
"""

from dataclasses import dataclass, field
from math import inf

from aerial_gym.config import checks
from aerial_gym.config.checks import NO_SOURCE, Vec3

ROTOR_TRAITS = ("reversible", "force", "slew", "dead_band")  # Features beyond an unsigned, lagging speed


POLYNOMIAL_MAP = "polynomial"  # Name of the built-in rotor map


@dataclass(frozen=True, kw_only=True)
class RotorCfg:
    """Mode, thrust curve, drag torque, lag and limits of one rotor type."""

    mode: str = "speed"  # State: `speed` [rad/s], with a thrust map, or `force`, the thrust [N], without

    rotor_map: str = field(default=POLYNOMIAL_MAP, repr=False)  # a state of release 0.1 has the digest of its repr
    """Name in ``aerial_gym.physics.ROTOR_MAPS``: the terms of the speed that the coefficients below multiply."""

    thrust_map: Vec3 = (0.0, 0.0, 0.0)
    """Thrust c0 + c1 w + c2 w² [N] of the speed w [rad/s], c2 > 0, or coefficients of another ``rotor_map``. Needed in speed
    mode, and only there."""

    torque_ratio: float | None = None  # Drag torque per thrust [m], >= 0. Exactly one of this and `torque_map` is given
    torque_map: Vec3 | None = None  # Drag torque q0 + q1 w + q2 w² [N m], or coefficients of another `rotor_map`
    reverse_thrust_map: Vec3 | None = None  # Thrust of a reversible rotor in reverse, of |w|; `thrust_map` if not given
    reverse_torque_map: Vec3 | None = None  # Likewise; default: `torque_map`, or `torque_ratio` times the reverse map
    time_constant_up: float  # First-order lag of a state that grows in size [s], > 0
    time_constant_down: float  # First-order lag of a state that falls in size [s], > 0

    thrust_range: tuple[float, float]
    """Lowest and highest thrust [N] that may be commanded, low < high, high > 0. A lowest one below 0 makes the rotor
    reversible."""

    slew_rate: float | None = None  # Largest growth of the state's size [rad/s², in force mode N/s], > 0; None: any
    slew_rate_down: float | None = None  # Largest rate at which it falls, likewise; `slew_rate` if not given
    dead_band: float = 0.0  # Dead band: a command of smaller size [rad/s, in force mode N] stops the rotor, >= 0
    radius: float | None = None  # Of the propeller [m], > 0; only effects that depend on it need it
    source: str = NO_SOURCE  # Source of the numbers

    def __post_init__(self) -> None:
        checks.require_positive(self, "time_constant_up", "time_constant_down", "radius", "slew_rate", "slew_rate_down")
        checks.require_finite(
            self, "thrust_map", "thrust_range", "torque_map", "reverse_thrust_map", "reverse_torque_map"
        )
        checks.require_choice(self, "mode", ("speed", "force"))
        if (self.torque_ratio is None) == (self.torque_map is None):
            checks.refuse("RotorCfg: give exactly one of torque_ratio and torque_map")
        checks.require_not_negative(self, "dead_band", "torque_ratio")
        low, high = self.thrust_range
        checks.require(self, "thrust_range", low < high and high > 0.0, "needs low < high, and high > 0")
        if self.mode == "force":
            self._check_force_mode()
        else:
            self._check_maps()

    def _check_force_mode(self) -> None:
        for name in ("torque_map", "reverse_thrust_map", "reverse_torque_map"):
            given = getattr(self, name) is not None
            checks.require(self, name, not given, "in force mode the state is the thrust; give torque_ratio alone")
        checks.require(self, "thrust_map", not any(self.thrust_map), "in force mode the state is the thrust: omit it")
        is_polynomial = self.rotor_map == POLYNOMIAL_MAP
        checks.require(self, "rotor_map", is_polynomial, "in force mode the state is the thrust: omit it")

    def _check_maps(self) -> None:
        if self.rotor_map == POLYNOMIAL_MAP:
            checks.require(self, "thrust_map", self.thrust_map[2] > 0.0, "the coefficient of w² must be > 0")
        checks.require(self, "thrust_map", any(self.thrust_map), "in speed mode a coefficient other than 0 is needed")
        if not self.reversible:
            for name in ("reverse_thrust_map", "reverse_torque_map"):
                rule = "only for a reversible rotor, with a thrust_range that begins below 0"
                checks.require(self, name, getattr(self, name) is None, rule)
        elif self.rotor_map == POLYNOMIAL_MAP:
            self._check_reversible_polynomials()

    def _check_reversible_polynomials(self) -> None:
        for name in ("thrust_map", "reverse_thrust_map"):
            c0, c1, c2 = getattr(self, name) or self.thrust_map
            rule = "the thrust of a reversible rotor is 0 without speed and grows with it: needs c0 = 0, c1 >= 0 and c2 > 0"
            checks.require(self, name, c0 == 0.0 and c1 >= 0.0 and c2 > 0.0, rule)
        for name in ("torque_map", "reverse_torque_map"):
            q0, *_ = getattr(self, name) or (0.0,)
            checks.require(self, name, q0 == 0.0, "the torque of a reversible rotor is 0 without speed: needs q0 = 0")

    @property
    def reversible(self) -> bool:
        """Whether the rotor state has a sign."""
        return self.thrust_range[0] < 0.0

    @property
    def traits(self) -> frozenset[str]:
        """Special features of the rotor, names of ``ROTOR_TRAITS``."""
        has = {"reversible": self.reversible, "force": self.mode == "force", "slew": min(self.slew_rates) < inf}
        has["dead_band"] = self.dead_band > 0.0
        return frozenset(name for name, yes in has.items() if yes)

    @property
    def slew_rates(self) -> tuple[float, float]:
        """Largest rates of growing and of falling, infinite where there is no limit."""
        up = inf if self.slew_rate is None else self.slew_rate
        return up, up if self.slew_rate_down is None else self.slew_rate_down

    @property
    def thrust_coefficients(self) -> Vec3:
        """Coefficients of the thrust [N] of the state."""
        return (0.0, 1.0, 0.0) if self.mode == "force" else self.thrust_map

    @property
    def reverse_thrust_coefficients(self) -> Vec3:
        """Coefficients of the thrust [N] of the magnitude of a negative state."""
        return self.reverse_thrust_map or self.thrust_coefficients

    @property
    def torque_coefficients(self) -> Vec3:
        """Coefficients of the drag torque [N m] of the state, whichever way it was given."""
        return self.torque_map or self._drag_torque(self.thrust_coefficients)

    @property
    def reverse_torque_coefficients(self) -> Vec3:
        """Coefficients of the drag torque [N m] of the magnitude of a negative state."""
        return self.reverse_torque_map or self.torque_map or self._drag_torque(self.reverse_thrust_coefficients)

    def _drag_torque(self, thrust: Vec3) -> Vec3:
        ratio = self.torque_ratio or 0.0
        return ratio * thrust[0], ratio * thrust[1], ratio * thrust[2]
