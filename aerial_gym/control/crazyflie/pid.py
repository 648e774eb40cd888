"""The Crazyflie's default cascade of PID controllers: position, velocity, attitude, rates.

Each has an integral. Angles are in degrees and moments in PWM counts, as in its gains. Derivatives are taken of measurements,
not of errors, so that a step of the setpoint gives no kick.
Frames: world z up, body x forward, y left, z up; pitch is positive nose down, unlike the Crazyflie's own.
Letters: E environments.
Source: the Crazyflie's documentation, "Cascaded PID controller", and its parameters.
Position and velocity run at 100 Hz, attitude and rates at 500 Hz.
"""

from dataclasses import dataclass
from math import degrees

import torch
from torch import Tensor

from aerial_gym.math.quaternion import euler_from_quat, yaw_from_quat
from aerial_gym.physics.state import BodyState

THRUST_PER_OUTPUT = 1000.0  # Counts per unit of the vertical velocity controller
MOST_THRUST = 65535.0  # Largest PWM of a motor [counts]
MOST_MOMENT = 32767.0  # Largest moment about any axis [counts]
LEEWAY = 1.1  # Factor by which the velocity setpoint may exceed the velocity limit
OUTER_NUMBERS = 6  # Memory of position and velocity: an integral of each (3)
INNER_NUMBERS = 12  # Memory of attitude and rates: an integral of each, previous angles and rates [deg, deg/s], 3 each


@dataclass(frozen=True, kw_only=True)
class PidLevel:
    """Three PID controllers side by side."""

    proportional: Tensor  # (E, 3)
    integral: Tensor  # [1/s], (E, 3)
    derivative: Tensor  # [s], (E, 3)
    limit: Tensor  # Of the integrated error, (E, 3); infinite for no limit

    def output_and_integral(self, error: Tensor, change: Tensor, integral: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        """Return output (E, 3) and new integral (E, 3) for an error and the change of the measurement."""
        integral = (integral + error * dt).clamp(-self.limit, self.limit)
        return self.proportional * error + self.integral * integral - self.derivative * change / dt, integral


@dataclass(frozen=True, kw_only=True)
class PidGains:
    """The cascade, with the limits between its levels."""

    position: PidLevel  # From position [m] to velocity [m/s], in the frame of the heading
    velocity: PidLevel  # From velocity [m/s] to pitch and roll [deg] and to vertical output
    attitude: PidLevel  # From roll, pitch, yaw [deg] to rates [deg/s]
    rates: PidLevel  # From rates [deg/s] to moments [counts]
    most_velocity: Tensor  # [m/s], (E, 3)
    most_tilt: Tensor  # Of roll and of pitch [deg], (E, 1)
    thrust_base: Tensor  # Hover thrust [counts], (E, 1)
    least_thrust: Tensor  # [counts], (E, 1)


def outer_loop(
    state: BodyState, position: Tensor, kept: Tensor, gains: PidGains, *, dt: float
) -> tuple[Tensor, Tensor]:
    """Return thrust [counts], roll and pitch [deg] of position and velocity control, (E, 3), and the new memory, (E, 6).

    Args:
        position: Wanted, world [m], (E, 3).
        kept: Memory of the previous run, (E, 6); zeros after a reset.
    """
    far, drift = kept.split(3, dim=-1)
    still, heading = torch.zeros_like(position), yaw_from_quat(state.attitude)
    error, moving = (_rotate_into_heading(x, heading) for x in (position - state.position, state.lin_vel))
    wanted, far = gains.position.output_and_integral(error, still, far, dt)
    most = LEEWAY * gains.most_velocity
    wanted = wanted.clamp(-most, most)
    output, drift = gains.velocity.output_and_integral(wanted - moving, still, drift, dt)
    tilt = output[:, :2].clamp(-gains.most_tilt, gains.most_tilt)
    thrust = (gains.thrust_base + THRUST_PER_OUTPUT * output[:, 2:]).clamp_max(MOST_THRUST)
    setpoint = torch.cat((torch.maximum(thrust, gains.least_thrust), -tilt[:, 1:], tilt[:, :1]), dim=-1)
    return setpoint, torch.cat((far, drift), dim=-1)


def inner_loop(state: BodyState, wanted: Tensor, kept: Tensor, gains: PidGains, *, dt: float) -> tuple[Tensor, Tensor]:
    """Return the moment [counts], body, (E, 3), of attitude and rate control, and the new memory, (E, 12).

    Args:
        wanted: Roll, pitch and yaw [deg], (E, 3).
        kept: Memory of the previous run, (E, 12); ``fresh`` after a reset.
    """
    leant, spun, angles_before, rates_before = kept.split(3, dim=-1)
    angles, rates = _angles_and_rates_in_degrees(state)
    error, change = (_wrap_yaw(x) for x in (wanted - angles, angles - angles_before))
    wanted_rates, leant = gains.attitude.output_and_integral(error, change, leant, dt)
    moment, spun = gains.rates.output_and_integral(wanted_rates - rates, rates - rates_before, spun, dt)
    return moment.clamp(-MOST_MOMENT, MOST_MOMENT), torch.cat((leant, spun, angles, rates), dim=-1)


def initial_memory_of_attitude_loops(state: BodyState) -> Tensor:
    """Return the memory of attitude and rate loops before their first run, (E, 12): no integrals, present angles and rates."""
    zero = torch.zeros_like(state.position)
    return torch.cat((zero, zero, *_angles_and_rates_in_degrees(state)), dim=-1)


def _angles_and_rates_in_degrees(state: BodyState) -> tuple[Tensor, Tensor]:
    """Return roll, pitch, yaw [deg] and body rates [deg/s], (E, 3) each."""
    return euler_from_quat(state.attitude) * degrees(1.0), state.ang_vel * degrees(1.0)


def _rotate_into_heading(vector: Tensor, heading: Tensor) -> Tensor:
    """Rotate a world vector (E, 3) into the heading frame, by the yaw [rad], (E,)."""
    cosine, sine = torch.cos(heading), torch.sin(heading)
    x, y, z = vector.unbind(-1)
    return torch.stack((cosine * x + sine * y, cosine * y - sine * x, z), dim=-1)


def _wrap_yaw(angles: Tensor) -> Tensor:
    """Return roll, pitch, yaw [deg], (E, 3), with the yaw wrapped to -180 to 180."""
    yaw = torch.remainder(angles[:, 2:] + 180.0, 360.0) - 180.0
    return torch.cat((angles[:, :2], yaw), dim=-1)
