"""PX4's position and velocity controller: from positions to a thrust in the world. Pure functions of tensors.

Frames: world z up. PX4's opposite y and z change signs but not the law.
Letters: E environments.
Source: PX4 Autopilot 1.14, ``PositionControl`` and ``ControlMath``.
"""

from dataclasses import dataclass, field

import torch
from torch import Tensor

from aerial_gym.physics.vehicle import is_shared, share_row


@dataclass(frozen=True, kw_only=True)
class PositionGains:
    """Gains and limits of position and velocity control."""

    position: Tensor  # MPC_XY_P, MPC_Z_P [1/s], (E, 3)
    velocity: Tensor  # MPC_XY_VEL_P_ACC, MPC_Z_VEL_P_ACC [1/s], (E, 3)
    integral: Tensor  # MPC_XY_VEL_I_ACC, MPC_Z_VEL_I_ACC [1/s²], (E, 3)
    derivative: Tensor  # MPC_XY_VEL_D_ACC, MPC_Z_VEL_D_ACC [-], (E, 3)
    speed: Tensor  # MPC_XY_VEL_MAX [m/s], (E, 1), as all that follow
    up: Tensor  # MPC_Z_VEL_MAX_UP [m/s]
    down: Tensor  # MPC_Z_VEL_MAX_DN [m/s]
    least_thrust: Tensor  # MPC_THR_MIN [-]
    most_thrust: Tensor  # MPC_THR_MAX [-]
    margin: Tensor  # MPC_THR_XY_MARG [-]
    tilt: Tensor  # MPC_TILTMAX_AIR [rad]
    hover: Tensor  # MPC_THR_HOVER [-]
    gravity: Tensor  # Gravity at hover thrust [m/s²]
    sine: Tensor = field(init=False)  # Of the tilt
    cosine: Tensor = field(init=False)

    def __post_init__(self) -> None:
        for name, function in (("sine", torch.sin), ("cosine", torch.cos)):
            tilt = self.tilt
            rows = share_row(function(tilt[0]), len(tilt)) if is_shared(tilt) else function(tilt)
            object.__setattr__(self, name, rows)


def limit_velocity(velocity: Tensor, gains: PositionGains) -> Tensor:
    """Limit a velocity setpoint [m/s], world, (E, 3), in horizontal speed, climb and descent."""
    rise = velocity[:, 2:].clamp(-gains.down, gains.up)
    return torch.cat((_limit_length(velocity[:, :2], gains.speed), rise), dim=-1)


def _limit_length(vector: Tensor, most: Tensor) -> Tensor:
    """Limit a vector (E, 2) to a length."""
    length = vector.norm(dim=-1, keepdim=True)
    return torch.where(length > most, vector / torch.where(length > most, length, 1.0) * most, vector)


def velocity_control(
    error: Tensor, integral: Tensor, acceleration: Tensor, gains: PositionGains, dt: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Return the wanted acceleration and thrust, world, (E, 3) each, and the integral after the run, (E, 3).

    Args:
        error: Velocity error [m/s], world, (E, 3).
        integral: Integral before the run [m/s²], world, (E, 3).
        acceleration: Measured [m/s²], world, (E, 3).
        dt: Period of the runs [s].

    Returns:
        Acceleration [m/s²], thrust as a share of the largest [-], and the integral [m/s²]. The integral stops at a limit of
        vertical thrust, and is reduced at a limit of horizontal thrust.

    Source:
        PX4, ``PositionControl::_velocityControl``; the horizontal anti-windup is that of Rundqwist (1990), Anti-reset windup
        for PID controllers.
    """
    wanted = error * gains.velocity + integral - acceleration * gains.derivative
    asked = thrust_setpoint(wanted, gains)
    low, high = asked[:, 2:] <= gains.least_thrust, asked[:, 2:] >= gains.most_thrust
    rise, drift = error[:, 2:], error[:, :2]
    rise = torch.where((low & (rise <= 0.0)) | (high & (rise >= 0.0)), 0.0, rise)
    kept = torch.minimum(asked[:, :2].norm(dim=-1, keepdim=True), gains.margin)
    up = torch.minimum(asked[:, 2:], (gains.most_thrust**2 - kept.square()).sqrt())
    left = (gains.most_thrust**2 - up.square()).clamp_min(0.0)
    lateral = _limit_length(asked[:, :2], torch.where(left > 0.0, left, 1.0).sqrt() * (left > 0.0))
    made, meant = lateral * (gains.gravity / gains.hover), wanted[:, :2]
    short = meant.square().sum(-1, keepdim=True) > made.square().sum(-1, keepdim=True)
    drift = drift - torch.where(short, 2.0 / gains.velocity[:, :1] * (meant - made), 0.0)
    integral = integral + torch.cat((drift, rise), dim=-1) * gains.integral * dt
    vertical = integral[:, 2:].clamp(-gains.gravity, gains.gravity)
    integral = torch.cat((integral[:, :2], vertical), dim=-1)
    return wanted, torch.cat((lateral, up), dim=-1), integral


def thrust_setpoint(acceleration: Tensor, gains: PositionGains) -> Tensor:
    """Return the thrust setpoint (E, 3), world, along ``(a_x, a_y, g)``, with the vertical part that carries the vehicle.

    Args:
        acceleration: Wanted [m/s²], world, (E, 3).

    Source:
        PX4, ``PositionControl::_accelerationControl`` and ``ControlMath::limitTilt``.
    """
    axis = torch.cat((acceleration[:, :2], gains.gravity.expand_as(acceleration[:, 2:])), dim=-1)
    axis = axis / axis.norm(dim=-1, keepdim=True)
    flat, largest = axis[:, :2].norm(dim=-1, keepdim=True), gains.sine
    steep = flat > largest
    leaning = axis[:, :2] / torch.where(steep, flat, 1.0) * largest
    axis = torch.where(steep, torch.cat((leaning, gains.cosine.expand_as(flat)), dim=-1), axis)
    collective = (acceleration[:, 2:] / gains.gravity + 1.0) * gains.hover / axis[:, 2:]
    return axis * torch.maximum(collective, gains.least_thrust)
