"""Rotor lag, thrust and drag torque of spinning rotors.

Pure functions of tensors: no state, no allocation that outlives the call, no device choice.
Frames: body is x forward, y left, z up. Letters: E environments, R rotors.
"""

from dataclasses import replace

import torch
from torch import Tensor

from aerial_gym.math.rows import sum_slices, times
from aerial_gym.physics.vehicle import Vehicle, is_shared

SHORTEST = 1e-12  # Time constant that represents zero [s]


def select_by_direction(state: Tensor, command: Tensor, up: Tensor, down: Tensor) -> Tensor:
    """Return ``up`` where the command is above the state, else ``down``."""
    return torch.where(command > state, up, down)


def approach(state: Tensor, command: Tensor, kept: Tensor) -> Tensor:
    """Return the state after which a share ``kept`` of the distance to the command remains."""
    return command + (state - command) * kept


def lag_speed(speed: Tensor, command: Tensor, tau_up: Tensor, tau_down: Tensor, dt: float | Tensor) -> Tensor:
    """Return the rotor speed after ``dt`` under a constant command, ``w_c + (w - w_c) exp(-dt / tau)``.

    This is the exact solution of ``tau dw/dt = w_c - w``, independent of the division of a span into steps. The time constant
    cannot change within it, because the speed approaches the command from one side.

    Args:
        speed: Rotor speeds w [rad/s], (E, R).
        command: Commanded speeds w_c [rad/s], (E, R).
        tau_up: Time constant for a command above the speed [s], (E, R). Zero follows at once.
        tau_down: Time constant for a command below [s], (E, R).
        dt: Span [s], scalar or (E, 1).

    Returns:
        Rotor speeds [rad/s], (E, R).

    Source:
        Derived: linear first-order equation with constant input.
    """
    tau = select_by_direction(speed, command, tau_up, tau_down).clamp_min(SHORTEST)
    return approach(speed, command, torch.exp(-dt / tau))


def lag_acceleration(
    speed: Tensor, command: Tensor, tau_up: Tensor, tau_down: Tensor, jump: Tensor, dt: float | Tensor
) -> Tensor:
    """Return the angular acceleration of the rotors [rad/s²], (E, R): ``(w_c - w) / tau``.

    A rotor without lag follows at once, with the mean acceleration ``jump / dt`` of the step.

    Args:
        speed: Rotor speeds w [rad/s], (E, R).
        command: Commanded speeds w_c [rad/s], (E, R).
        tau_up: Time constant for a command above the speed [s], (E, R).
        tau_down: Time constant for a command below [s], (E, R).
        jump: Command minus the speed at the start of the step [rad/s], (E, R).

    Source:
        Derived: linear first-order equation.
    """
    tau = select_by_direction(speed, command, tau_up, tau_down)
    lags = tau > 0.0
    return torch.where(lags, (command - speed) / torch.where(lags, tau, torch.ones_like(tau)), jump / dt)


def rotor_thrust(vehicle: Vehicle, state: Tensor) -> Tensor:
    """Return the thrusts along the axes [N], (E, R), for rotor states: speed [rad/s] or, in force mode, thrust [N]."""
    return _evaluate_map(vehicle, "thrust_map", state)


def rotor_torque(vehicle: Vehicle, state: Tensor) -> Tensor:
    """Return the drag torques against the spin of the rotors [N m], (E, R); those of reversed rotors are negative."""
    return _evaluate_map(vehicle, "torque_map", state)


def _evaluate_map(vehicle: Vehicle, name: str, state: Tensor) -> Tensor:
    """Return the map of the magnitude of rotor states, (E, R); with its own coefficients and negative for reversed rotors."""
    coefficients = getattr(vehicle, name)
    if "reversible" not in vehicle.traits:
        return vehicle.rotor_map.evaluate(coefficients, state)
    reverse = state < 0.0
    coefficients = torch.where(reverse.unsqueeze(-1), getattr(vehicle, f"reverse_{name}"), coefficients)
    value = vehicle.rotor_map.evaluate(coefficients, state.abs())
    return torch.where(reverse, -value, value)


def map_terms(vehicle: Vehicle, state: Tensor) -> Tensor:
    """Return the terms of the rotor map, regressors of the coefficients of thrust and torque, (K, E, R).

    K is 3, or 6 with the coefficients of reversed rotors at the end.
    """
    count = 6 if "reversible" in vehicle.traits else 3
    unit, rows = torch.eye(6, dtype=state.dtype, device=state.device), (*state.shape, 3)
    maps = [(unit[k, :3].expand(rows), unit[k, 3:].expand(rows)) for k in range(count)]
    return torch.stack([rotor_thrust(replace(vehicle, thrust_map=a, reverse_thrust_map=b), state) for a, b in maps])


def state_for_thrust(vehicle: Vehicle, thrust: Tensor) -> Tensor:
    """Return the states for thrusts [N], (E, R): speeds [rad/s], or in force mode thrusts; the inverse of ``rotor_thrust``.

    Source:
        Derived: the inverse of an odd function is odd.
    """
    inverse = vehicle.rotor_map.speed_for_thrust
    if "reversible" not in vehicle.traits:
        return inverse(vehicle.thrust_map, thrust)
    reverse = (thrust < 0.0) & (vehicle.speed_low < 0.0)
    coefficients = torch.where(reverse.unsqueeze(-1), vehicle.reverse_thrust_map, vehicle.thrust_map)
    size = inverse(coefficients, torch.where(reverse, -thrust, thrust))
    return torch.where(reverse, -size, size)


def rotor_wrench(vehicle: Vehicle, thrust: Tensor, torque: Tensor) -> tuple[Tensor, Tensor]:
    """Return force and torque of all rotors on the body, ``sum T a`` and ``sum (r - c) x T a - s q a``.

    Args:
        vehicle: Gives hubs r, axes a, spins s and the centre of mass c.
        thrust: Thrusts T [N], (E, R).
        torque: Magnitudes q of the drag torques [N m], (E, R).

    Returns:
        Force [N] and torque about the centre of mass [N m], body, each (E, 3).

    Source:
        Mahony, Kumar, Corke (2012), Multirotor Aerial Vehicles, eq. 6-8, for arbitrary axes.
    """
    geometry = (vehicle.rotor_position, vehicle.com, vehicle.rotor_axis, vehicle.rotor_spin)
    if all(is_shared(rows) for rows in geometry):
        wrench = times(torch.cat((thrust, torque), dim=-1), rotor_matrix(vehicle))
        return wrench[:, :3], wrench[:, 3:]
    force, turn, twist = (
        sum_slices(weight.unsqueeze(-1) * rows, 1)
        for weight, rows in (
            (thrust, vehicle.rotor_axis),
            (thrust, vehicle.rotor_moment),
            (torque, vehicle.rotor_reaction),
        )
    )
    return force, turn + twist


def rotor_matrix(vehicle: Vehicle) -> Tensor:
    """Return the matrix of ``rotor_wrench`` of the first environment, (2 R, 6): its rows are thrusts, then drag torques."""
    names = ("rotor_position", "com", "rotor_axis", "rotor_spin")
    first = replace(vehicle, **{name: getattr(vehicle, name)[:1] for name in names})
    axis, moment, reaction = first.rotor_axis[0], first.rotor_moment[0], first.rotor_reaction[0]
    return torch.cat((torch.cat((axis, moment), dim=-1), torch.cat((0.0 * axis, reaction), dim=-1)))


def hover_speed(vehicle: Vehicle, gravity: float) -> Tensor:
    """Return the rotor states (R,) [rad/s], in force mode [N], for equal shares of the weight."""
    share = (vehicle.mass * gravity / vehicle.num_rotors).unsqueeze(-1).expand(-1, vehicle.num_rotors)
    return torch.clamp(state_for_thrust(vehicle, share)[0], vehicle.speed_low[0], vehicle.speed_high[0])
