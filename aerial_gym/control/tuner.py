"""Gain tuning for a bandwidth and a damping ratio, with rotor lag and dead time, in all environments at once.

The attitude loop is ``L(s) = (k_p + k_d s) H(s) / s²`` with the response of angular acceleration to its command,
``H(s) = exp(-d s) / (T s + 1)``. A pole pair at ``s = w (-z + i sqrt(1 - z²))`` requires ``k_p + k_d s = -s² / H(s)``: one
complex equation, linear in both gains, exact with lag and dead time. Bisection finds the frequency w at which the closed loop
``k_p H / (s² + (k_p + k_d s) H)`` has the wanted bandwidth. The position loop is the same, with the closed attitude loop as
its H.
Letters: E environments.
Source: Derived, above; dominant poles placed by two gains: Astrom, Hagglund (2006), Advanced PID Control, section 6.4.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import inf, sqrt

import torch
from torch import Tensor

from aerial_gym.errors import ConfigError
from aerial_gym.physics.vehicle import Vehicle

HALVINGS = 60  # Bisections of the frequency, to the precision of float64
HELD = 0.5  # Mean delay of a held command, in time steps
LEAST_DAMPING, MOST_DAMPING = 0.3, 1.0  # Range of damping ratios; 1 is taken as just below 1
FAR_POLE = 1.5  # Least ratio of the decay of other poles to that of the placed pair, which makes the pair dominant
Bandwidth = float | tuple[float, float, float]  # Bandwidth [rad/s] of all axes or of x, y, z
Response = Callable[[Tensor], Tensor]  # Function from s, complex (E, 3), to the response at s, likewise


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """Tuned gains of one loop."""

    frequency: Tensor  # Frequency w of the placed pair [rad/s], (E, 3)
    proportional: Tensor  # Acceleration per error k_p [1/s²], (E, 3)
    derivative: Tensor  # Acceleration per rate k_d [1/s], (E, 3)
    inner: Response  # Response H of acceleration to its command

    @property
    def closed_loop_response(self) -> Response:
        """Closed-loop response of angle or position to its setpoint."""
        return _close_loop(self.proportional, self.derivative, self.inner)

    @property
    def natural_frequency(self) -> Tensor:
        """``sqrt k_p`` [rad/s], (E, 3), as ``ControlCfg.attitude_frequency`` and ``position_frequency``."""
        return self.proportional.sqrt()

    @property
    def damping(self) -> Tensor:
        """``k_d / (2 sqrt k_p)``, (E, 3), as ``ControlCfg.attitude_damping`` and ``position_damping``."""
        return self.derivative / (2.0 * self.proportional.sqrt())


def rotor_response(lag: Tensor, delay: float | Tensor) -> Response:
    """Return the response ``exp(-d s) / (T s + 1)`` of a lag T [s], (E, 3), and a dead time d [s], scalar or (E, 1)."""
    return lambda s: torch.exp(-delay * s) / (lag * s + 1.0)


def place_poles(frequency: Tensor, damping: float, inner: Response) -> tuple[Tensor, Tensor]:
    """Return k_p [1/s²] and k_d [1/s], (E, 3), that place a pair of poles.

    Args:
        frequency: Frequency of the pair [rad/s], (E, 3).
        damping: Damping ratio of the pair, < 1.
    """
    s = frequency * complex(-damping, sqrt(1.0 - damping**2))
    wanted = -s.square() / inner(s)
    derivative = wanted.imag / s.imag
    return wanted.real - derivative * s.real, derivative


def tune_loop(inner: Response, lag: Tensor, *, bandwidth: Bandwidth, damping: float, loop_name: str) -> Tuning:
    """Tune the gains of a loop around H to a bandwidth and a damping ratio.

    Args:
        lag: Sum of lag and dead time [s], (E, 3), which bounds the frequency.
        bandwidth: Frequency at which the closed-loop gain is ``sqrt 1/2`` [rad/s].
        damping: Damping ratio of the placed pair, ``LEAST_DAMPING`` to ``MOST_DAMPING``.

    Raises:
        ConfigError: If a value is out of range, or the lag of an environment is too long; the message states the limit.
    """
    asked = lag.new_tensor(bandwidth).expand(3)
    if not bool(((asked > 0.0) & (asked < inf)).all()):
        raise ConfigError(f"bandwidth = {bandwidth!r} rad/s: must be > 0 and finite")
    if not LEAST_DAMPING <= damping <= MOST_DAMPING:
        raise ConfigError(f"damping = {damping!r}: must be from {LEAST_DAMPING} to {MOST_DAMPING}")
    damping = min(damping, 1.0 - 1e-6)
    highest = 1.0 / ((1.0 + FAR_POLE) * damping * lag.clamp_min(1e-6))
    low, high = torch.zeros_like(highest), highest
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        short = _closed_loop_gain(asked, middle, damping, inner) < sqrt(0.5)
        low, high = torch.where(short, middle, low), torch.where(short, high, middle)
    if bool((_closed_loop_gain(asked, highest, damping, inner) < sqrt(0.5)).any()):
        most = [f"{value:.4g}" for value in _bandwidth(highest, damping, inner).amin(0).tolist()]
        raise ConfigError(
            f"{loop_name} loop: a bandwidth of {bandwidth!r} rad/s with a damping of {damping:.3g} is more than a lag of "
            f"{float(lag.amax()):.3g} s allows. Ask for at most {', '.join(most)} rad/s about x, y, z, or for less damping"
        )
    proportional, derivative = place_poles(high, damping, inner)
    return Tuning(frequency=high, proportional=proportional, derivative=derivative, inner=inner)


def _close_loop(proportional: Tensor, derivative: Tensor, inner: Response) -> Response:
    def closed(s: Tensor) -> Tensor:
        response = inner(s)
        return proportional * response / (s.square() + (proportional + derivative * s) * response)

    return closed


def _closed_loop_gain(bandwidth: Tensor, frequency: Tensor, damping: float, inner: Response) -> Tensor:
    """Return the gain of the closed loop at an angular frequency [rad/s], (E, 3), with poles placed at another."""
    safe = frequency.clamp_min(1e-9)
    s = torch.complex(torch.zeros_like(safe), bandwidth.expand_as(safe))
    return _close_loop(*place_poles(safe, damping, inner), inner)(s).abs()


def _bandwidth(frequency: Tensor, damping: float, inner: Response) -> Tensor:
    """Return the bandwidth [rad/s], (E, 3), of poles placed at a frequency: the first gain below ``sqrt 1/2``."""
    low, high = torch.zeros_like(frequency), 4.0 * frequency
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        above = _closed_loop_gain(middle, frequency, damping, inner) > sqrt(0.5)
        low, high = torch.where(above, middle, low), torch.where(above, high, middle)
    return low


def tune_attitude(
    vehicle: Vehicle, *, bandwidth: Bandwidth, damping: float, delay: float | Tensor, dt: float
) -> Tuning:
    """Tune the attitude loop of every environment's own vehicle, on all three axes.

    Args:
        vehicle: Identified or drawn vehicle; the slower of rotor rise and fall counts.
        bandwidth: [rad/s], of all axes or of roll, pitch and yaw. The yaw authority of the rotors is not checked.
        delay: Dead time of the rotors [s], as in the effect ``actuation_delay``; scalar or (E,).

    Raises:
        ConfigError: As in ``tuned``.
    """
    slowest = torch.maximum(vehicle.time_constant_up, vehicle.time_constant_down).amax(-1, keepdim=True).double()
    lag, late = (
        slowest.expand(-1, 3),
        HELD * dt + (delay.double().unsqueeze(-1) if isinstance(delay, Tensor) else delay),
    )
    return tune_loop(rotor_response(lag, late), lag + late, bandwidth=bandwidth, damping=damping, loop_name="attitude")


def tune_position(attitude: Tuning, *, bandwidth: Bandwidth, damping: float) -> Tuning:
    """Tune the position loop along x, y, z around tuned pitch, tuned roll, and rotors.

    Args:
        bandwidth: [rad/s], of all axes or of each.

    Raises:
        ConfigError: As in ``tuned``.
    """

    def inner(s: Tensor) -> Tensor:
        pitch_and_roll = attitude.closed_loop_response(s[:, [1, 0, 2]])[:, [1, 0]]
        return torch.cat((pitch_and_roll, attitude.inner(s)[:, 2:]), dim=-1)

    lag = attitude.derivative / attitude.proportional
    lag = torch.cat((lag[:, [1, 0]], 1.0 / ((1.0 + FAR_POLE) * attitude.frequency[:, 2:])), dim=-1)
    return tune_loop(inner, lag, bandwidth=bandwidth, damping=damping, loop_name="position")
