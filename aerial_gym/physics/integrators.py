"""Integrators of the equations of motion, each with the exact solution of the rotors.

The state is that of the centre of mass (``MassState``), where Newton's and Euler's equations decouple; ``to_mass_state``
and ``to_body_state`` go from and to the body origin. Letters: E environments, R rotors.

Free motion of a hull with added mass: Kirchhoff's equations by the implicit midpoint rule.

With mass ``M = m + M_A`` along the body axes, v through water in steady uniform motion and no force::

    p' = p x w,    l' = l x w + p x v,    p = M v,    l = J w        body axes

Impulse ``R p``, its moment ``R l + x x R p`` and the energy ``(p . v + l . w) / 2`` are constant. The midpoint rule conserves
quadratic invariants of p and l. With the Cayley rotation of its mean w, and the matching position, it conserves all three.
Source: Lamb (1932), Hydrodynamics, articles 121-124; Hairer, Lubich, Wanner (2006), Geometric Numerical Integration, IV.2.1
(quadratic invariants); Cayley rotation and position: derived. With ``a = dt w / 2`` the rotation is ``(1 - [a])^-1 (1 + [a])``.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from aerial_gym.math.quaternion import quat_exp, quat_multiply, quat_normalize, quat_rotate
from aerial_gym.math.rows import dot, inverse_3x3
from aerial_gym.physics import rigid_body
from aerial_gym.physics.effects import FluidEffect
from aerial_gym.physics.model import Model
from aerial_gym.physics.rotor_lag import RotorCommand, follow_command, stage_rates, vehicle_lag
from aerial_gym.physics.state import BodyState

ITERATIONS = 5  # Newton steps for the mean angular velocity. Each squares the error, initially `dt / 2` times w'
cross = torch.linalg.cross


def force_free_motion_change(
    mass: Tensor, inertia: Tensor, lin_vel: Tensor, ang_vel: Tensor, dt: float
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return the changes of motion in a step without force; as small numbers they conserve the invariants in float32.

    Args:
        mass: Of hull and water along the body axes [kg], (E, 3).
        inertia: Of hull and water about the centre of mass [kg m²], (E, 3, 3).
        lin_vel: Velocity of the centre of mass through the water [m/s], body, (E, 3).
        ang_vel: Angular velocity [rad/s], body, (E, 3).

    Returns:
        In body axes of the start: the displacement beyond that of the initial velocity [m], (E, 3), and the change of velocity
        [m/s], (E, 3). Then the unnormalised quaternion of the rotation, xyzw, (E, 4), and the final angular velocity [rad/s],
        body axes of the end, (E, 3).
    """
    mean = _mean_ang_vel(mass, inertia, lin_vel, ang_vel, dt)
    a = 0.5 * dt * mean
    square = dot(a, a).unsqueeze(-1)
    more = -cross(a, _half_rotation(a, mass * lin_vel)) / mass  # of the mean velocity, body axes that turn
    end = lin_vel + 2.0 * more
    move = dt / (1.0 + square) * (more + cross(a, lin_vel + more) - square * lin_vel)
    gain = 2.0 * more + 2.0 / (1.0 + square) * (cross(a, end) + cross(a, cross(a, end)))
    return move, gain, torch.cat((a, torch.ones_like(square)), dim=-1), 2.0 * mean - ang_vel


def _mean_ang_vel(mass: Tensor, inertia: Tensor, lin_vel: Tensor, ang_vel: Tensor, dt: float) -> Tensor:
    """Return the mean angular velocity of a step without force [rad/s], body, (E, 3), by Newton's method."""
    half, impulse, spin, mean = 0.5 * dt, mass * lin_vel, rigid_body.multiply_rows(inertia, ang_vel), ang_vel
    unit = torch.eye(3, dtype=mass.dtype, device=mass.device).expand(mass.shape[0], 3, 3)
    for _ in range(ITERATIONS):
        turned, momentum = _half_rotation(half * mean, impulse), rigid_body.multiply_rows(inertia, mean)
        v = turned / mass
        missing = momentum - spin + half * (cross(mean, momentum) + cross(v, turned))
        w, p, v, spun = (rows.unsqueeze(1) for rows in (mean, turned, v, momentum))  # (E, 1, 3)
        more = half * _half_rotation(half * w, cross(p, unit))
        gyroscopic = cross(unit, spun) + cross(w, inertia)
        slopes = inertia + half * (gyroscopic + cross(more / mass.unsqueeze(1), p) + cross(v, more))
        mean = mean - dot(inverse_3x3(slopes.mT), missing.unsqueeze(1))
    return mean


def _half_rotation(a: Tensor, vector: Tensor) -> Tensor:
    """Return ``(1 + [a])^-1 b``, (..., 3): the mean of b and of ``(1 + [a])^-1 (1 - [a]) b``."""
    along = dot(a, vector).unsqueeze(-1) * a
    return (vector - cross(a, vector) + along) / (1.0 + dot(a, a).unsqueeze(-1))


@dataclass(frozen=True, kw_only=True)
class MassState:
    """Motion of the centre of mass."""

    position: Tensor  # Centre of mass [m], world, (E, 3)
    attitude: Tensor  # Body to world, unit, xyzw, (E, 4)
    lin_vel: Tensor  # Velocity of the centre of mass [m/s], world, (E, 3)
    ang_vel: Tensor  # Angular velocity [rad/s], body, (E, 3)
    rotor_speed: Tensor  # Rotor speeds [rad/s], (E, R)
    load: Tensor  # Direction of a load's link and its rate [1/s], world, (E, 6); (E, 0) without a load


Stepper = Callable[[Model, MassState, RotorCommand, float], MassState]
"""``(model, state, rotor_command, dt [s]) -> state after dt``."""


def to_mass_state(model: Model, state: BodyState, load: Tensor | None = None) -> MassState:
    """Return the motion of the centre of mass, ``p_c = p_o + R c``, ``v_c = v_o + R (w x c)``, with a load's (E, 6)."""
    com = model.vehicle.com
    return MassState(
        position=state.position + quat_rotate(state.attitude, com),
        attitude=state.attitude,
        lin_vel=state.lin_vel + quat_rotate(state.attitude, torch.linalg.cross(state.ang_vel, com)),
        ang_vel=state.ang_vel,
        rotor_speed=state.rotor_speed,
        load=state.position[:, :0] if load is None else load,
    )


def to_body_state(model: Model, state: MassState) -> BodyState:
    """Return the motion of the body origin, the inverse of ``to_mass_state``."""
    com = model.vehicle.com
    return BodyState(
        position=state.position - quat_rotate(state.attitude, com),
        attitude=state.attitude,
        lin_vel=state.lin_vel - quat_rotate(state.attitude, torch.linalg.cross(state.ang_vel, com)),
        ang_vel=state.ang_vel,
        rotor_speed=state.rotor_speed,
    )


def _derivative(model: Model, state: MassState, rotor_acc: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    position, attitude, lin_vel, ang_vel, rotor_speed, _ = vars(state).values()
    return _accelerations(
        model, state, rigid_body.body_wrench(model, position, attitude, lin_vel, ang_vel, rotor_speed, rotor_acc)
    )


def _accelerations(model: Model, state: MassState, wrench: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor, Tensor]:
    """Return the accelerations of vehicle and load under a force and a torque."""
    (force, torque), attitude, ang_vel = wrench, state.attitude, state.ang_vel
    acc, ang_acc = (
        rigid_body.com_acceleration(model, attitude, force),
        rigid_body.angular_acceleration(model, ang_vel, torque),
    )
    return rigid_body.with_load(model, attitude, ang_vel, state.load, acc, ang_acc)


def speeds_and_wrench_of_step(
    model: Model, state: MassState, rotor_command: RotorCommand, dt: float
) -> tuple[Tensor, tuple[Tensor, Tensor]]:
    """Return the rotor speeds after a step (E, R), and the constant wrench of a first-order integrator.

    It combines the rotors at the end of the step with the motion at its start.

    Returns:
        Speeds [rad/s], and force without gravity and load [N] with torque about the centre of mass [N m], body, each (E, 3).
    """
    position, attitude, lin_vel, ang_vel, before, _ = vars(state).values()
    rotor_speed = follow_command(vehicle_lag(model.vehicle), before, rotor_command, dt)
    rotor_acc = (rotor_speed - before) / dt  # the mean over the step makes the rotors' momentum exact
    return rotor_speed, rigid_body.body_wrench(model, position, attitude, lin_vel, ang_vel, rotor_speed, rotor_acc)


def advance_load(load: Tensor, swing: Tensor, dt: float) -> Tensor:
    """Return direction and rate of a load's link, (E, 6), after a semi-implicit step under n'' [1/s²], (E, 3)."""
    rate = load[:, 3:] + dt * swing
    return _normalise_load_direction(torch.cat((load[:, :3] + dt * rate, rate), dim=-1))


def _normalise_load_direction(load: Tensor) -> Tensor:
    """Normalise direction and rate of a slung load's link to ``|n| = 1``, ``n . n' = 0``."""
    if load.shape[1] == 0:
        return load
    direction = load[:, :3] / load[:, :3].norm(dim=-1, keepdim=True)
    rate = load[:, 3:]
    return torch.cat((direction, rate - (rate * direction).sum(-1, keepdim=True) * direction), dim=-1)


def semi_implicit_euler(model: Model, state: MassState, rotor_command: RotorCommand, dt: float) -> MassState:
    """Return the state after one step of order 1: velocities first, then positions with the new velocities.

    The attitude follows the exact rotation ``exp(w dt)``. Source: Hairer, Lubich, Wanner (2006), Geometric Numerical
    Integration, I.1.2 (symplectic Euler). With added mass it is ``euler_in_fluid``.
    """
    if model.effects[FluidEffect]:
        return euler_in_fluid(model, state, rotor_command, dt)
    rotor_speed, wrench = speeds_and_wrench_of_step(model, state, rotor_command, dt)
    acc, ang_acc, swing = _accelerations(model, state, wrench)
    lin_vel, ang_vel = state.lin_vel + dt * acc, state.ang_vel + dt * ang_acc
    return MassState(
        position=state.position + dt * lin_vel,
        attitude=quat_normalize(quat_multiply(state.attitude, quat_exp(dt * ang_vel))),
        lin_vel=lin_vel,
        ang_vel=ang_vel,
        rotor_speed=rotor_speed,
        load=advance_load(state.load, swing, dt),
    )


def euler_in_fluid(model: Model, state: MassState, rotor_command: RotorCommand, dt: float) -> MassState:
    """Return the state after one step of a hull with added mass: coast half the step, apply all impulses, coast the rest.

    Without force it conserves energy, impulse and moment of impulse of hull and fluid (see above). Forces are
    evaluated at the middle. The method has order 2 for forces of position and attitude only, else order 1.
    Source: Hairer, Lubich, Wanner (2006), Geometric Numerical Integration, II.5 (Strang splitting).
    """
    middle = coast(model, state, 0.5 * dt)
    rotor_speed, (force, torque) = speeds_and_wrench_of_step(model, middle, rotor_command, dt)
    acc, ang_acc, swing = _accelerations(model, middle, (force, torque))
    free_force, free_torque = wrench_of_coast(model, middle)
    acc = acc - quat_rotate(middle.attitude, free_force / model.vehicle.mass.unsqueeze(-1))
    ang_acc = ang_acc - rigid_body.multiply_rows(model.inertia_inverse, free_torque)
    pushed = replace(
        middle,
        lin_vel=middle.lin_vel + dt * acc,
        ang_vel=middle.ang_vel + dt * ang_acc,
        rotor_speed=rotor_speed,
        load=torch.cat((middle.load[:, :3], middle.load[:, 3:] + dt * swing), dim=-1),
    )
    return coast(model, pushed, 0.5 * dt)


def coast(model: Model, state: MassState, dt: float) -> MassState:
    """Return the state of a hull with added mass after a time [s] without force; a load moves on at its rate."""
    ((effect, params),) = model.effects[FluidEffect]
    attitude, load = state.attitude, state.load
    through = rigid_body.air_velocity(model, state.position, attitude, state.lin_vel)
    mass = model.vehicle.mass.unsqueeze(-1) + effect.added_mass(params)
    move, gain, turn, ang_vel = force_free_motion_change(mass, model.vehicle.inertia, through, state.ang_vel, dt)
    return replace(
        state,
        position=state.position + dt * state.lin_vel + quat_rotate(attitude, move),
        attitude=quat_normalize(quat_multiply(attitude, turn)),
        lin_vel=state.lin_vel + quat_rotate(attitude, gain),
        ang_vel=ang_vel,
        load=_normalise_load_direction(torch.cat((load[:, :3] + dt * load[:, 3:], load[:, 3:]), dim=-1)),
    )


def wrench_of_coast(model: Model, state: MassState) -> tuple[Tensor, Tensor]:
    """Return force [N] and torque [N m], body, each (E, 3), that give a hull without fluid the motion of ``coast``."""
    ((effect, params),) = model.effects[FluidEffect]
    v, w = rigid_body.air_velocity(model, state.position, state.attitude, state.lin_vel), state.ang_vel
    added, mass = effect.added_mass(params), model.vehicle.mass.unsqueeze(-1)
    momentum, spin = added * v, rigid_body.multiply_rows(model.vehicle.inertia, w)
    force = mass / (mass + added) * (added * torch.linalg.cross(w, v) - torch.linalg.cross(w, momentum))
    return force, -torch.linalg.cross(w, spin) - torch.linalg.cross(v, momentum)


def rk4(model: Model, state: MassState, rotor_command: RotorCommand, dt: float) -> MassState:
    """Return the state after one classical Runge-Kutta step of order 4; rotor speeds are exact at every stage.

    Source: Hairer, Norsett, Wanner (1993), Solving Ordinary Differential Equations I, table II.1.2.
    """
    lag = vehicle_lag(model.vehicle)
    half = follow_command(lag, state.rotor_speed, rotor_command, 0.5 * dt)
    end = follow_command(lag, state.rotor_speed, rotor_command, dt)
    speeds = (state.rotor_speed, half, end)
    rates = stage_rates(lag, speeds, rotor_command, dt)
    slopes, stage = [], state
    for place, weight in ((0, 0.5), (1, 0.5), (1, 1.0), (2, 0.0)):
        stage, rotor_acc = MassState(**{**vars(stage), "rotor_speed": speeds[place]}), rates[place]
        acc, ang_acc, swing = _derivative(model, stage, rotor_acc)
        turning = _attitude_rate(stage.attitude, stage.ang_vel)
        slopes.append((stage.lin_vel, turning, acc, ang_acc, torch.cat((stage.load[:, 3:], swing), dim=-1)))
        stage = _advance(state, slopes[-1], weight * dt)
    mean = [(a + 2.0 * b + 2.0 * c + d) / 6.0 for a, b, c, d in zip(*slopes, strict=True)]
    final = _advance(state, mean, dt)
    settled = {
        "attitude": quat_normalize(final.attitude),
        "rotor_speed": end,
        "load": _normalise_load_direction(final.load),
    }
    return MassState(**{**vars(final), **settled})


def _attitude_rate(attitude: Tensor, ang_vel: Tensor) -> Tensor:
    """Return ``q' = q (w, 0) / 2``."""
    return 0.5 * quat_multiply(attitude, torch.cat((ang_vel, torch.zeros_like(ang_vel[:, :1])), dim=-1))


def _advance(state: MassState, slope: tuple[Tensor, ...] | list[Tensor], dt: float) -> MassState:
    return MassState(
        position=state.position + dt * slope[0],
        attitude=state.attitude + dt * slope[1],
        lin_vel=state.lin_vel + dt * slope[2],
        ang_vel=state.ang_vel + dt * slope[3],
        rotor_speed=state.rotor_speed,
        load=state.load + dt * slope[4],
    )


INTEGRATORS: dict[str, Stepper] = {"euler": semi_implicit_euler, "rk4": rk4}  # Integrators by their public names
