"""Rotor maps: thrust and drag torque of a rotor as functions of its speed, and the speed for a thrust.

A map is linear in its coefficients, so that a factor on them is a factor on the thrust. A reversed rotor has the map of the
magnitude of its speed, against its axis. In force mode the thrust takes the place of the speed.
Letters: E environments, R rotors.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence

import torch
from torch import Tensor

from aerial_gym.config.checks import Vec3
from aerial_gym.config.rotor import RotorCfg
from aerial_gym.errors import ConfigError
from aerial_gym.physics.catalog import ROTOR_MAPS

SAMPLES = 9  # Number of thrusts at which the inverse of a map is checked
INVERSE_ERROR = 1e-6  # Largest error of the thrust at the speed for a thrust, as a share of the largest thrust


class RotorMap(ABC):
    """Thrust [N] or drag torque [N m] of the speed w [rad/s]: ``c0 t0(w) + c1 t1(w) + c2 t2(w)``."""

    name: str  # Name in `ROTOR_MAPS`
    summary: str  # One line about the map

    @abstractmethod
    def terms(self, speed: Tensor) -> tuple[Tensor, ...]:
        """Return up to three terms ``t0, t1, t2`` of speeds w >= 0 [rad/s], each (E, R)."""

    @abstractmethod
    def speed_for_thrust(self, coefficients: Tensor, thrust: Tensor) -> Tensor:
        """Return the speeds [rad/s], (E, R), that give thrusts [N], (E, R).

        Args:
            coefficients: c0, c1, c2 of the thrust, (E, R, 3).
        """

    def evaluate(self, coefficients: Tensor, speed: Tensor) -> Tensor:
        """Return thrust [N] or drag torque [N m], (E, R).

        Args:
            coefficients: c0, c1, c2, (E, R, 3).
            speed: Rotor speeds w [rad/s], (E, R).
        """
        first, *rest = (c * term for c, term in zip(coefficients.unbind(-1), self.terms(speed), strict=False))
        return sum(rest, first)


class PolynomialMap(RotorMap):
    """``c0 + c1 w + c2 w²`` with c2 > 0.

    Source:
        Static propeller data fit a quadratic with linear term, e.g. Foerster (2015), System identification of the
        Crazyflie 2.0, section 3.2.
    """

    name = "polynomial"
    summary = "polynomial c0 + c1 w + c2 w² of the speed w"

    def terms(self, speed: Tensor) -> tuple[Tensor, ...]:
        """Return 1, w and w²."""
        return torch.ones_like(speed), speed, speed.square()

    def evaluate(self, coefficients: Tensor, speed: Tensor) -> Tensor:
        """Return thrust or drag torque by Horner's rule."""
        c0, c1, c2 = coefficients.unbind(-1)
        return c0 + speed * (c1 + speed * c2)

    def speed_for_thrust(self, coefficients: Tensor, thrust: Tensor) -> Tensor:
        """Return the larger root of ``c0 + c1 w + c2 w² = T``; the speed of the minimum for a thrust below it."""
        c0, c1, c2 = coefficients.unbind(-1)
        return (_root_or_zero(c1 * c1 + 4.0 * c2 * (thrust - c0)) - c1) / (2.0 * c2)


class ThrustOrPolynomialMap(PolynomialMap):
    """The map of robots with rotors in force mode: for them c2 = 0, and the state is a thrust."""

    def speed_for_thrust(self, coefficients: Tensor, thrust: Tensor) -> Tensor:
        """Return the larger root of the polynomial; ``(T - c0) / c1`` where c2 = 0."""
        c0, c1, c2 = coefficients.unbind(-1)
        linear = c2 == 0.0
        square, slope = torch.where(linear, 1.0, c2), torch.where(linear, c1, 1.0)
        root = _root_or_zero(torch.where(linear, 1.0, c1 * c1 + 4.0 * square * (thrust - c0)))
        return torch.where(linear, (thrust - c0) / slope, (root - c1) / (2.0 * square))


def _root_or_zero(square: Tensor) -> Tensor:
    """Return the square root; 0 with gradient 0 for arguments <= 0, where that of the root is infinite."""
    none = square <= 0.0
    return torch.where(none, 0.0, torch.where(none, 1.0, square).sqrt())


POLYNOMIAL, THRUST_OR_POLYNOMIAL = PolynomialMap(), ThrustOrPolynomialMap()


def find_rotor_map(rotors: Sequence[RotorCfg]) -> RotorMap:
    """Return the map of a robot's rotors.

    Raises:
        ConfigError: If the rotors have several maps, or the map and its inverse differ.
    """
    names = sorted({rotor.rotor_map for rotor in rotors})
    if len(names) > 1:
        raise ConfigError(
            f"robot: its rotors have the rotor maps {', '.join(names)}: all need the same. Write one rotor map with the "
            "terms of both, and give each rotor coefficients of 0 for the other terms"
        )
    (name,) = names
    if name == PolynomialMap.name:
        return THRUST_OR_POLYNOMIAL if any(rotor.mode == "force" for rotor in rotors) else POLYNOMIAL
    rotor_map = ROTOR_MAPS.get(name)
    for rotor in dict.fromkeys(rotors):
        _check_inverse(rotor_map, rotor)
    return rotor_map


def rotor_state_for_thrust(rotor: RotorCfg, thrust: float) -> float:
    """Return the state of a rotor for a thrust [N]: the speed [rad/s], or in force mode the thrust."""
    if rotor.mode == "force":
        return thrust
    backwards = thrust < 0.0 and rotor.reversible
    coefficients = rotor.reverse_thrust_coefficients if backwards else rotor.thrust_coefficients
    speed = ROTOR_MAPS.get(rotor.rotor_map).speed_for_thrust(
        _row(coefficients), _number(-thrust if backwards else thrust)
    )
    return -float(speed) if backwards else float(speed)


def rotor_loads(rotor: RotorCfg, speed: float) -> tuple[float, float]:
    """Return thrust [N] and drag torque [N m] of a rotor at a speed >= 0 [rad/s], or in force mode at a thrust [N]."""
    evaluate = ROTOR_MAPS.get(rotor.rotor_map).evaluate
    thrust, torque = (
        float(evaluate(_row(c), _number(speed))) for c in (rotor.thrust_coefficients, rotor.torque_coefficients)
    )
    return thrust, torque


def _row(coefficients: Vec3) -> Tensor:
    return torch.tensor([[coefficients]], dtype=torch.float64)


def _number(value: float) -> Tensor:
    return torch.full((1, 1), value, dtype=torch.float64)


def _check_inverse(rotor_map: RotorMap, rotor: RotorCfg) -> None:
    """Raise ``ConfigError`` unless ``speed_for_thrust`` inverts the map over the thrust range of a rotor."""
    low, high = rotor.thrust_range
    if rotor.reversible and any(rotor_loads(rotor, 0.0)):
        raise ConfigError(
            f"rotor map {rotor_map.name!r}: a reversible rotor has thrust or drag torque without speed. Both must be 0"
        )
    ranges = [(rotor.thrust_coefficients, max(low, 0.0), high)]
    if rotor.reversible:
        ranges.append((rotor.reverse_thrust_coefficients, 0.0, -low))
    for coefficients, least, most in ranges:
        thrust = torch.linspace(least, most, SAMPLES, dtype=torch.float64).unsqueeze(0)
        rows = _row(coefficients).expand(1, SAMPLES, 3)
        speed = rotor_map.speed_for_thrust(rows, thrust)
        error = (rotor_map.evaluate(rows, speed) - thrust).abs()
        fits = (error <= INVERSE_ERROR * most) & (speed >= 0.0)  # written so that NaN fails as well
        if not bool(fits.all()):
            at = int((~fits).int().argmax())
            raise ConfigError(
                f"rotor map {rotor_map.name!r}: speed_for_thrust gives {float(speed[0, at]):.6g} rad/s for "
                f"{float(thrust[0, at]):.6g} N, where the map with coefficients {coefficients} is not that thrust. It must be "
                f"the inverse from {least:g} to {most:g} N, at speeds >= 0. Correct speed_for_thrust, the coefficients or "
                "the thrust_range"
            )
