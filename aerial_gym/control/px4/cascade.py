"""PX4's cascade of setpoints (position and velocity, attitude, body rates) and its mixer. Pure functions of tensors.

The attitude controller has priority of tilt over heading. Filters of second order are in ``control.filters``.
The mixer turns normalised torque and thrust into motor signals, with sequential desaturation: commands are reduced one after
the other along their columns of the mixing matrix: thrust, roll, pitch, yaw. Thrust may rise to keep roll and pitch with
airmode 1, also to keep yaw with airmode 2, and never with airmode 0. The reduction along a column is exactly the unallocated
part of its command.
Frames: world z up, body x forward, y left, z up; quaternions xyzw. PX4's frames have opposite y and z in world and body,
which changes signs but not the law. Letters: E environments, R rotors.
Source: PX4 Autopilot 1.14, ``ControlAllocationSequentialDesaturation``, ``PositionControl``, ``ControlMath``,
``AttitudeControl``, ``src/lib/rate_control`` and the filters of ``src/lib/mathlib``, with parameters as in its reference;
Brescianini, Hehn, D'Andrea (2013), Nonlinear quadrocopter attitude control, ETH Zurich.
"""

from dataclasses import dataclass, field
from functools import partial
from math import pi, radians
from typing import NamedTuple

import torch
from torch import Tensor

from aerial_gym.control.lee import tilt_first_error
from aerial_gym.math.quaternion import world_up
from aerial_gym.math.rows import compute_if, unit_vector
from aerial_gym.physics.fused.allocation import NEGLIGIBLE
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


def rate_setpoint(
    attitude: Tensor, wanted: Tensor, yaw_rate: Tensor, *, gain: Tensor, yaw_weight: Tensor, limit: Tensor
) -> Tensor:
    """Return the body-rate setpoint [rad/s], (E, 3), for an attitude, with full weight of tilt and less of heading.

    The rates are twice ``lee.tilt_first_error``, times the gains, plus the yaw rate.

    Args:
        attitude: Body to world, (E, 4).
        wanted: Wanted attitude, (E, 4).
        yaw_rate: Rate of the wanted heading [rad/s], world, (E,).
        gain: Rates per error [1/s], (E, 3); the yaw gain does not depend on its weight.
        yaw_weight: Share of the heading error in the command, > 0 and <= 1, (E, 1).
        limit: Largest rates [rad/s], (E, 3).
    """
    error = tilt_first_error(attitude, wanted, yaw_weight)
    scaled = torch.cat((gain[:, :2], gain[:, 2:] / yaw_weight), dim=-1)
    rates = 2.0 * scaled * error + yaw_rate.unsqueeze(-1) * world_up(attitude)
    return rates.clamp(-limit, limit)


def attitude_from_thrust(thrust: Tensor, heading: Tensor) -> Tensor:
    """Return the attitude (E, 4) with body z along a thrust (E, 3) and body x in the vertical plane of a heading (E, 3).

    Lee's law takes the axis nearest to the heading instead. Thrusts point upwards, headings are horizontal; both in the world.

    Source: PX4, ``ControlMath::bodyzToAttitude``.
    """
    b3 = unit_vector(thrust)
    left = torch.stack((-heading[:, 1], heading[:, 0], torch.zeros_like(heading[:, 0])), dim=-1)
    b1 = unit_vector(torch.linalg.cross(left, b3))
    return quat_from_axes(b1, torch.linalg.cross(b3, b1), b3)


def quat_from_axes(x: Tensor, y: Tensor, z: Tensor) -> Tensor:
    """Return the quaternion (E, 4), body to world, of body axes x, y, z in the world, (E, 3) each.

    Source: Shepperd (1978), Quaternion from rotation matrix: of four forms the one with the largest divisor.
    """
    xx, yy, zz = x[:, 0], y[:, 1], z[:, 2]
    a, b, c = y[:, 2] - z[:, 1], z[:, 0] - x[:, 2], x[:, 1] - y[:, 0]
    d, e, f = x[:, 1] + y[:, 0], z[:, 0] + x[:, 2], y[:, 2] + z[:, 1]
    forms = (
        torch.stack((1.0 + xx - yy - zz, d, e, a), dim=-1),
        torch.stack((d, 1.0 - xx + yy - zz, f, b), dim=-1),
        torch.stack((e, f, 1.0 - xx - yy + zz, c), dim=-1),
        torch.stack((a, b, c, 1.0 + xx + yy + zz), dim=-1),
    )
    best, divisor = forms[0], forms[0][:, :1]
    for k, form in enumerate(forms[1:], start=1):
        better = form[:, k : k + 1] > divisor
        best, divisor = torch.where(better, form, best), torch.maximum(form[:, k : k + 1], divisor)
    return unit_vector(best)


RATE_NUMBERS = 19
"""Memory of the rate controller: integral (3), angular acceleration (3), previous body rates (3), state of the low-pass of
body rates (6), unallocated torque (3), yaw torque (1); then six numbers of each notch."""

FADING_RATE = radians(400.0)  # Rate error at which the integral stops [rad/s]. Source: PX4, `updateIntegral`


def rate_torque(
    error: Tensor, wanted: Tensor, ang_acc: Tensor, integral: Tensor, gains: tuple[Tensor, Tensor, Tensor]
) -> Tensor:
    """Return the normalised torque ``P e + I - D w' + FF w_d``, (E, 3).

    Args:
        error: Rate error e [rad/s], body, (E, 3).
        wanted: Wanted rate w_d [rad/s], body, (E, 3).
        ang_acc: Measured angular acceleration w' [rad/s²], body, (E, 3).
        integral: I before this run [-], (E, 3).
        gains: P [s/rad], D [s²/rad] and FF [s/rad], (E, 3) each.
    """
    proportional, derivative, forward = gains
    return proportional * error + integral - derivative * ang_acc + forward * wanted


def update_integral(integral: Tensor, error: Tensor, short: Tensor, gain: Tensor, limit: Tensor, dt: float) -> Tensor:
    """Return the integral [-], (E, 3), after a run: it slows with the error and stops for unallocated torque.

    Args:
        integral: Integral before the run [-], (E, 3).
        error: Rate error [rad/s], body, (E, 3).
        short: Sign of the unallocated torque in the previous run, (E, 3); 0 if all was allocated.
        gain: I [1/rad], (E, 3).
        limit: [-], (E, 3).
    """
    useful = torch.where(short * error > 0.0, 0.0, error)
    fading = (1.0 - (useful / FADING_RATE).square()).clamp_min(0.0)
    return (integral + fading * gain * useful * dt).clamp(-limit, limit)


def smoothing_coefficient(cutoff_hz: float, dt: float) -> float:
    """Return the coefficient of a first-order low-pass, the share of the new value: ``dt / (dt + 1 / (2 pi f))``; 1 for f = 0.

    Source: PX4, ``AlphaFilter``; the backward Euler step of ``tau y' = x - y``.
    """
    return 1.0 if cutoff_hz == 0.0 else dt / (dt + 1.0 / (2.0 * pi * cutoff_hz))


ROLL, PITCH, YAW, THRUST = range(4)  # Columns of the mixing matrix
WEAK = 0.2  # Normalised coefficient of a motor in a command below which the command does not desaturate that motor
YAW_MARGIN = 0.15  # Excess over the upper limit, in motor ranges, up to which yaw is kept and thrust reduced


class MixerOutput(NamedTuple):
    """Motor signals, and the signs of unallocated torque."""

    signal: Tensor  # Share of the full thrust, (E, R)
    short: Tensor  # Sign of the unallocated torque about each axis, (E, 3); 0 if all is allocated


def mix(columns: Tensor, wanted: Tensor, low: Tensor, *, airmode: int) -> MixerOutput:
    """Compute the motor signals of PX4's sequential desaturation.

    A motor that still exceeds a limit is clamped, and then no torque counts as allocated.

    Args:
        columns: Mixing matrix, normalised as ``parameters.unit_wrench``, (E, R, 4).
        wanted: Normalised roll, pitch and yaw torque and thrust, (E, 4).
        low: Lowest signals, (E, R); the highest are 1.
        airmode: MC_AIRMODE: 0, 1 or 2.
    """
    level = (columns * _without_yaw(wanted).unsqueeze(1)).sum(-1)
    plain = level + columns[..., YAW] * wanted[:, YAW : YAW + 1]
    beyond = ((torch.minimum(plain, level) < low) | (torch.maximum(plain, level) > 1.0)).any(-1, keepdim=True)
    return MixerOutput(
        *compute_if(
            beyond, partial(desaturate, airmode), (columns, wanted, low), (plain, torch.zeros_like(wanted[:, :3]))
        )
    )


def _without_yaw(wanted: Tensor) -> Tensor:
    zero = torch.zeros_like(wanted[:, YAW : YAW + 1])
    return torch.cat((wanted[:, :YAW], zero, wanted[:, THRUST:]), dim=-1)


def desaturate(airmode: int, columns: Tensor, wanted: Tensor, low: Tensor) -> tuple[Tensor, Tensor]:
    """Return the fields of ``MixerOutput`` by PX4's sequence of reductions; arguments as for ``mix``."""
    high, parts = torch.ones_like(low), columns.unbind(-1)
    given = list(wanted.split(1, dim=-1))

    def make_room(signal: Tensor, axis: int, top: Tensor, *, only_less: bool = False) -> Tensor:
        first = _desaturation_gain(signal, parts[axis], low, top)
        if only_less:
            first = torch.where(first > 0.0, 0.0, first)
        moved = signal + first * parts[axis]
        second = 0.5 * _desaturation_gain(moved, parts[axis], low, top)
        if only_less:
            second = torch.where(first == 0.0, 0.0, second)
        given[axis] = given[axis] + first + second
        return moved + second * parts[axis]

    yaw = parts[YAW] * wanted[:, YAW : YAW + 1]
    signal = (columns * _without_yaw(wanted).unsqueeze(1)).sum(-1)
    if airmode == 2:
        signal = make_room(make_room(signal + yaw, THRUST, high), YAW, high)
    else:
        signal = make_room(signal, THRUST, high, only_less=airmode == 0)
        if airmode == 0:
            signal = make_room(make_room(signal, ROLL, high), PITCH, high)
        signal = make_room(signal + yaw, YAW, high + YAW_MARGIN * (high - low))
        signal = make_room(signal, THRUST, high, only_less=True)
    cut = signal.clamp(low, high)
    within = ((cut - signal).abs() <= NEGLIGIBLE).all(-1, keepdim=True)
    lost = torch.where(within, wanted - torch.cat(given, dim=-1), wanted)[:, :3]
    return cut, torch.where(lost.abs() > NEGLIGIBLE, lost.sign(), 0.0)


def _desaturation_gain(signal: Tensor, column: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Return PX4's desaturation gain (E, 1): the multiple of ``column`` that removes the limit violation, or balances two."""
    beyond = signal.clamp(low, high) - signal
    strong = column.abs() >= WEAK
    steps = torch.where(strong, beyond / torch.where(strong, column, 1.0), 0.0)
    return steps.amin(-1, keepdim=True).clamp_max(0.0) + steps.amax(-1, keepdim=True).clamp_min(0.0)
