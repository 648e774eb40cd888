"""Our answers to the random states of ``px4_vectors``, beside PX4's, in our frames. PX4's frames are north, east, down
and forward, right, down; ours have y and z the other way round, so everything is compared after two changes of sign."""

import numpy as np
import torch
from torch import Tensor

from aerial_gym.control.lee import canonical_quat
from aerial_gym.control.px4 import cascade
from tests.cross.firmware import px4_mixer_vectors as mixed
from tests.cross.firmware import px4_vectors as made
from tests.cross.firmware.draws import load_vectors

GRAVITY = 9.80665
"""PX4's [m/s²]."""

Pair = tuple[Tensor, Tensor, Tensor]
"""Ours, theirs, and the size of the numbers from which both were computed, (N, ...)."""


def read_vectors() -> dict[str, Tensor]:
    """Return PX4's answers by name, as they stand in the file."""
    return load_vectors(made.VECTORS, made.states_checksum())


def flip_axes(rows: Tensor) -> Tensor:
    """Return vectors (..., 3) in the other convention: y and z change their signs."""
    return rows * rows.new_tensor((1.0, -1.0, -1.0))


def quat(rows: Tensor) -> Tensor:
    """Return quaternions wxyz of PX4's frames (..., 4) as xyzw of ours."""
    return torch.cat((flip_axes(rows[..., 1:]), rows[..., :1]), dim=-1)


def split(rows: np.ndarray, *widths: int) -> list[Tensor]:
    """Return the parts of rows, float64."""
    return list(torch.from_numpy(rows).double().split(widths, dim=-1))


def rate_pair(vectors: dict[str, Tensor]) -> Pair:
    """Return the normalised torques of runs of four steps, (STEPS, RUNS, 3)."""
    gains, states = made.rate_states()
    p, i, d, forward, limit = split(gains, 3, 3, 3, 3, 3)
    rate, wanted, ang_acc, short, dt = (part.unbind(1) for part in split(states, 3, 3, 3, 3, 1))
    integral, result, sizes = torch.zeros_like(p), [], []
    for k in range(made.STEPS):
        w, w_d, a, s = (flip_axes(x[k]) for x in (rate, wanted, ang_acc, short))
        result.append(cascade.rate_torque(w_d - w, w_d, a, integral, (p, d, forward)))
        sizes.append((p * (w_d - w)).abs() + integral.abs() + (d * a).abs() + 1.0)
        integral = cascade.update_integral(integral, w_d - w, s, i, limit, dt[k])
    return torch.stack(result), flip_axes(vectors["torque"].transpose(0, 1)), torch.stack(sizes)


def attitude_pair(vectors: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
    """Return the body rates [rad/s], (N, 3), for ``attitude_cases``."""
    attitude, wanted, yaw_rate, gain, weight, limit = attitude_cases()
    rates = cascade.rate_setpoint(attitude, wanted, yaw_rate, gain=gain, yaw_weight=weight, limit=limit)
    return rates, flip_axes(vectors["rate"])


def attitude_cases() -> tuple[Tensor, ...]:
    """Return attitude, wanted attitude, yaw rate, gain, yaw weight and limit in our frames, (N, ...)."""
    attitude, wanted, yaw_rate, gain, weight, limit = split(made.attitude_states(), 4, 4, 1, 3, 1, 3)
    return quat(attitude), quat(wanted), -yaw_rate[:, 0], gain, weight, limit


def position_pairs(vectors: dict[str, Tensor]) -> dict[str, Pair]:
    """Return acceleration [m/s²], thrust [-] and attitude of runs of four steps, (STEPS, RUNS, ...), by name."""
    gains, states = made.position_states()
    position, velocity, integral_gain, derivative, *limits = split(gains, 3, 3, 3, 3, *[1] * 8)
    speed, up, down, least, most, margin, tilt, hover = limits
    actual = cascade.PositionGains(
        position=position, velocity=velocity, integral=integral_gain, derivative=derivative, speed=speed, up=up, down=down,
        least_thrust=least.clamp_min(1e-3), most_thrust=most, margin=margin, tilt=tilt, hover=hover,
        gravity=torch.full_like(hover, GRAVITY),
    )  # fmt: skip
    steps = [part.unbind(1) for part in split(states, 3, 3, 3, 3, 1, 1, 1)]
    integral, result, sizes = torch.zeros_like(position), [], []
    for k in range(made.STEPS):
        at, moving, measured, goal = (flip_axes(part[k]) for part in steps[:4])
        yaw, dt, is_velocity = (part[k] for part in steps[4:])
        error = cascade.limit_velocity(torch.where(is_velocity > 0.5, goal, position * (goal - at)), actual) - moving
        sizes.append((velocity * error).abs().amax(-1, keepdim=True) + integral.abs().amax(-1, keepdim=True) + 1.0)
        acceleration, thrust, integral = cascade.velocity_control(error, integral, measured, actual, dt)
        heading = torch.stack((torch.cos(yaw[:, 0]), -torch.sin(yaw[:, 0]), torch.zeros_like(yaw[:, 0])), dim=-1)
        result.append((acceleration, thrust, canonical_quat(cascade.attitude_from_thrust(thrust, heading))))
    reference = vectors["position"].transpose(0, 1)
    parts = (
        flip_axes(reference[..., :3]),
        flip_axes(reference[..., 3:6]),
        canonical_quat(quat(reference[..., 6:]).flatten(0, 1)),
    )
    acceleration, thrust, attitude = (torch.stack(each) for each in zip(*result, strict=True))
    size = torch.stack(sizes)
    return {
        "acceleration setpoint [m/s²]": (acceleration, parts[0], size),
        "normalised thrust": (thrust, parts[1], torch.ones_like(size)),
        "attitude setpoint (quaternion)": (attitude, parts[2].view_as(attitude), torch.ones_like(size)),
    }


def mixer_pair() -> tuple[Tensor, Tensor]:
    """Return the motor signals of all commands of ``px4_mixer_vectors``, (N, R)."""
    reference = load_vectors(mixed.VECTORS, mixed.states_checksum())["signals"]
    parts, wanted = (torch.from_numpy(rows).double() for rows in mixed.states())
    parts, low, wanted, airmode = parts[..., :4], parts[..., 4], wanted[:, :4], wanted[:, 4]
    down = parts.new_tensor((1.0, -1.0, -1.0, -1.0))  # pitch, yaw and thrust are positive the other way
    actual = torch.zeros_like(reference)
    for mode in range(3):
        rows = airmode == mode
        actual[rows] = cascade.mix(parts[rows] * down, wanted[rows] * down, low[rows], airmode=mode).signal
    return actual, reference
