"""The relaxed hover of a quadrotor without a rotor: a spin about a fixed axis that keeps it where it is.

Seen from the body a vehicle that spins about the vertical and goes nowhere does not move: where the target is, its velocity,
up, its angular velocity and its rotors are constant. Heading plays no part in it. A *motion* is these, in this order: body
origin less target [m], velocity [m/s], up [-], angular velocity [rad/s], all along body axes, and rotor speeds [rad/s].

Frames: world z up; body x forward, y left, z up. Letters: E environments, R rotors, M = 12 + R entries of a motion.
Source: Mueller, D'Andrea (2014), Stability and control of a quadrocopter despite the complete loss of one, two, or three
propellers, ICRA; Mueller, D'Andrea (2016), Relaxed hover solutions for multicopters, IJRR 35(8).
"""

import torch
from torch import Tensor

from aerial_gym.control.reduced_attitude import shortest_turn, up_axis
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import quat_rotate, quat_rotate_inverse
from aerial_gym.physics.model import Model
from aerial_gym.physics.rigid_body import accelerations
from aerial_gym.physics.rotors import state_for_thrust
from aerial_gym.physics.state import BodyState

PLACE, VELOCITY, UP, TURN, ROTORS = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12), slice(12, None)
"""Parts of a motion."""

SHARES = 8
"""Steps in which the share of the opposite rotor grows from 0, where the solution is the level spin, to the wanted one."""

NEWTON_STEPS, CONVERGED = 30, 1e-10
"""At most, and largest acceleration [m/s², rad/s²] that counts as none; a step in its basin squares the error."""


def body_rates(model: Model, motion: Tensor, command: Tensor) -> Tensor:
    """Return how a motion changes, ``d' = v - w x d``, ``v' = f - g u - w x v``, ``u' = -w x u``, w', s', each (E, M).

    Args:
        model: The vehicle with its effects, at the origin of the world in still air. Of two lags of a rotor the longer holds.
        motion: d, v, u, w and s (module docstring), (E, M).
        command: Rotor speeds told [rad/s], (E, R).

    Source:
        Derived: the rate of a vector seen from a body that turns with w is that in the world less ``w x`` the vector.
    """
    place, velocity, up, turn, speed = (motion[:, part] for part in (PLACE, VELOCITY, UP, TURN, ROTORS))
    attitude, _ = shortest_turn(up, up_axis(up))
    state = BodyState(
        position=torch.zeros_like(place),
        attitude=attitude,
        lin_vel=quat_rotate(attitude, velocity),
        ang_vel=turn,
        rotor_speed=speed,
    )
    lag = torch.maximum(model.vehicle.time_constant_up, model.vehicle.time_constant_down)
    spun_up = (command - speed) / lag
    found, cross = accelerations(model, state, spun_up), torch.linalg.cross
    gained = found.specific_force - model.gravity * up - cross(turn, velocity)
    return torch.cat((velocity - cross(turn, place), gained, -cross(turn, up), found.ang_acc, spun_up), dim=-1)


def relaxed_hover(model: Model, lost: int, share: float) -> Tensor:
    """Return the motion (M,) that stays as it is, seen from the body, with a rotor that stands still.

    The two rotors beside it give the same thrust, the one opposite ``share`` of that. Up is then along the angular velocity,
    and the body origin circles the target.

    Args:
        model: One environment in float64.
        lost: Which rotor, from 0 on.
        share: Of the opposite rotor, >= 0. With 0 it leaves the law nothing to take away from; more leans the vehicle more.

    Raises:
        ConfigError: If there is no such motion, or rotors cannot give its thrusts.
    """
    _, sides = _around(model, lost)
    weight, sign = float(model.vehicle.mass[0]) * model.gravity, -float(model.vehicle.rotor_spin[0, sides[0]])
    unknown = torch.tensor((0.0, 0.0, sign, 0.0, 0.0, 0.0, weight / 2.0), dtype=torch.float64)
    for step in range(SHARES + 1):
        unknown = _solved(model, lost, share * step / SHARES, unknown)
    motion, vehicle = _motion(model, lost, share, unknown), model.vehicle
    speed, kept = motion[ROTORS], [i for i in range(4) if i != lost]
    if bool(((speed > vehicle.speed_high[0]) | (speed < vehicle.speed_low[0]))[kept].any()) or motion[UP][2] <= 0.0:
        raise ConfigError(
            f"rotor {lost + 1} lost, share {share:g}: hover needs speeds {speed.tolist()} rad/s, beyond those of the vehicle. "
            "Take a smaller share, or a vehicle with more thrust"
        )
    return motion


def linearised(model: Model, motion: Tensor, lost: int) -> tuple[Tensor, Tensor, Tensor]:
    """Return A (N, N), B (N, 3) in ``x' = A x + B u`` about a motion, and the rows (N, M) with ``x = rows (motion - hover)``.

    N = 14: up is a direction, with two deviations, and the lost rotor has none; u are the commands of the others.
    """
    kept = [i for i in range(4) if i != lost]

    def rates(at: Tensor, command: Tensor) -> Tensor:
        return body_rates(model, at.unsqueeze(0), command.unsqueeze(0))[0]

    by_motion, by_command = torch.autograd.functional.jacobian(rates, (motion, motion[ROTORS]))
    across = torch.linalg.svd(motion[UP].unsqueeze(0)).Vh[1:]
    unit = torch.eye(4, dtype=motion.dtype)
    rows = torch.block_diag(torch.eye(6, dtype=motion.dtype), across, unit[:3, :3], unit[kept])
    return rows @ by_motion @ rows.T, (rows @ by_command)[:, kept], rows


def motion_from_body(state: BodyState, target: Tensor) -> Tensor:
    """Return the motion (E, M) of a state relative to targets [m], world, (E, 3)."""
    seen = (state.position - target, state.lin_vel, up_axis(state.position))
    return torch.cat(
        (*(quat_rotate_inverse(state.attitude, v) for v in seen), state.ang_vel, state.rotor_speed), dim=-1
    )


def _around(model: Model, lost: int) -> tuple[int, list[int]]:
    """Return the rotor opposite to one, and the two beside it."""
    vehicle = model.vehicle
    if vehicle.num_rotors != 4 or not vehicle.plain or not vehicle.upright:
        raise ConfigError("hover without a rotor: is for quadrotors of plain rotors that thrust along body z")
    hubs, spin = vehicle.rotor_position[0] - vehicle.com[0], vehicle.rotor_spin[0]
    opposite = int((hubs @ hubs[lost]).argmin())
    sides = [i for i in range(4) if i not in (lost, opposite)]
    if spin[sides[0]] != spin[sides[1]] or spin[lost] != spin[opposite]:
        raise ConfigError("hover without a rotor: opposite rotors of this vehicle do not turn the same way")
    return opposite, sides


def _motion(model: Model, lost: int, share: float, unknown: Tensor) -> Tensor:
    """Return the motion (M,) of angular velocity, velocity and thrust of a rotor beside the lost one (7,)."""
    opposite, sides = _around(model, lost)
    turn, velocity, thrust = unknown[:3], unknown[3:6], unknown[6]
    weights = torch.zeros(4, dtype=unknown.dtype)
    weights[sides], weights[opposite] = 1.0, share
    speed = torch.where(weights > 0.0, state_for_thrust(model.vehicle, (weights * thrust).unsqueeze(0))[0], 0.0)
    up = -model.vehicle.rotor_spin[0, sides[0]] * turn / turn.norm()
    return torch.cat((torch.linalg.cross(velocity, turn) / (turn @ turn), velocity, up, turn, speed))


def _solved(model: Model, lost: int, share: float, unknown: Tensor) -> Tensor:
    """Return the unknowns of ``_motion`` with which nothing accelerates and the velocity is square to up (Newton's method)."""

    def residual(at: Tensor) -> Tensor:
        motion = _motion(model, lost, share, at)
        rates = body_rates(model, motion.unsqueeze(0), motion[ROTORS].unsqueeze(0))[0]
        return torch.cat((rates[VELOCITY], rates[TURN], (motion[VELOCITY] @ motion[UP]).unsqueeze(0)))

    for _ in range(NEWTON_STEPS):
        left = residual(unknown)
        if bool(left.abs().max() < CONVERGED):
            return unknown
        slope = torch.autograd.functional.jacobian(residual, unknown)
        unknown = unknown - torch.linalg.lstsq(slope, left).solution
    raise ConfigError(
        f"rotor {lost + 1} lost, share {share:g}: no spin balances the torque of the others. The vehicle needs something that "
        "brakes it, such as h_force_flapping (base_quadrotor_braked_in_spin)"
    )
