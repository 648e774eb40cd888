"""Accelerations and integrators of the fused kernel, composed for the chosen effects as Warp functions.

Letters: R rotors.
"""

from collections.abc import Callable, Sequence
from functools import cache
from types import SimpleNamespace
from typing import Any, cast

import warp as wp
from torch import Tensor

from aerial_gym.math.warp_functions import attitude_rate, rotation_quat, unit_quat
from aerial_gym.physics.effects import DelayEffect, FluidEffect, LoadEffect
from aerial_gym.physics.fused.formulas import Constants, VehicleRows, make_accelerations, make_force_free_motion
from aerial_gym.physics.fused.packing import effect_values_type
from aerial_gym.physics.fused.torch_trace import trace_to_warp
from aerial_gym.physics.fused.types import compile_source, rotor_types
from aerial_gym.physics.model import Model
from aerial_gym.physics.rotor_lag import (
    CommandSwitch,
    DecayLag,
    RotorCommand,
    RotorLag,
    SlewLimitedLag,
    follow_command,
    stage_rates,
    stop_in_dead_band,
)
from aerial_gym.physics.vehicle import Vehicle

SLEW_LIMITED = "tau_up", "tau_down", "slew_up", "slew_down"
DECAYS = "decay_up", "decay_down"  # Fields of the vehicle that are the fields of `SlewLimitedLag` and `DecayLag`


@cache
def make_rotor_lag(num_rotors: int, general: bool, late: bool = False, *, stages: int = 1) -> wp.Function:
    """Return the function of the states after one or two stages, (vehicle, states, commands, span [s]) -> states.

    Two stages in one call are rounded once. A state near its command stops once its change in a stage is below half a unit in
    the last place, so separate stages end twice as far from the command. With ``late``, the command changes within a step.
    """

    def follow(lag: RotorLag, states: list[Tensor], command: CommandOf, span: Tensor) -> tuple[Tensor]:
        if general:
            return (follow_command(lag, states[0], command(1.0), span),)
        return (follow_command(lag, states[0], command(stages / span), float(stages)),)

    return _trace_each_rotor("follow", follow, ["state"], 1, num_rotors, general, late)


@cache
def make_stage_rates(num_rotors: int, general: bool, late: bool = False) -> wp.Function:
    """Return the function of the rates of change in a step of two stages, (vehicle, three states, commands, step [s])."""

    def rates(lag: RotorLag, states: list[Tensor], command: CommandOf, dt: Tensor) -> tuple[Tensor, ...]:
        start, middle, end = states
        if general:
            return stage_rates(lag, (start, middle, end), command(1.0), dt)
        scale = 2.0 / dt
        return tuple(scale * rate for rate in stage_rates(lag, (start, middle, end), command(scale), 2.0))

    return _trace_each_rotor("stage_rates", rates, ["start", "middle", "end"], 3, num_rotors, general, late)


CommandOf = Callable[[Tensor | float], RotorCommand]  # Function from a factor of times to the command


def _trace_each_rotor(
    name: str, function: Callable[[RotorLag, list[Tensor], CommandOf, Tensor], tuple[Tensor, ...]],
    states: Sequence[str], num_results: int, num_rotors: int, general: bool, late: bool,
) -> wp.Function:  # fmt: skip
    """Return the function (vehicle, states, commands, span [s]) that calls a traced function of one rotor for each rotor.

    One trace for all rotors would mix their operations, which takes more registers.
    """
    types, fields = rotor_types(num_rotors, general), SLEW_LIMITED if general else DECAYS
    commands = ("earlier", "later", "change") if late else ("command",)

    def one(span: Tensor, **rows: Tensor) -> tuple[Tensor, ...]:
        lag = (SlewLimitedLag if general else DecayLag)(*(rows[field] for field in fields))

        def command(scale: Tensor | float) -> RotorCommand:
            if not late:
                return rows["command"]
            return CommandSwitch(earlier=rows["earlier"], later=rows["later"], change=rows["change"] * scale)

        return function(lag, [rows[state] for state in states], command, span)

    floats = dict.fromkeys((*fields, *states, *commands, "span"), float)
    traced = trace_to_warp(f"{name}_one", floats, one, [float] * num_results, constants={})
    numbers = [f"plant.{field}[i]" for field in fields] + [f"{state}[i]" for state in states]
    numbers += ["command.earlier[i]", "command.later[i]", "command.change"] if late else ["command[i]"]
    kinds = {"plant": types.vehicle, **dict.fromkeys(states, types.vector)}
    kinds |= {"command": types.succession if late else types.vector, "span": float}
    results = [f"after_{k}" for k in range(num_results)]
    code = [
        f"def {name}({', '.join(f'{argument}: {argument}_type' for argument in kinds)}):",
        *(f"    {result} = vector()" for result in results),
        f"    for i in range({num_rotors}):",
        f"        {', '.join(f'{result}_i' for result in results)} = one({', '.join(numbers)}, span)",
        *(f"        {result}[i] = {result}_i" for result in results),
        f"    return {', '.join(results)}",
    ]
    names = {f"{argument}_type": kind for argument, kind in kinds.items()} | {"one": traced, "vector": types.vector}
    return compile_source(name, "\n".join(code) + "\n", names)


@cache
def make_dead_band(num_rotors: int) -> wp.Function:
    """Return ``rotor_lag.stop_in_dead_band`` as a function (vehicle, commands) -> commands."""
    types = rotor_types(num_rotors, general=True)

    def stop(plant: SimpleNamespace, command: Tensor) -> Tensor:
        return stop_in_dead_band(cast(Vehicle, VehicleRows(**vars(plant), traits=frozenset({"dead_band"}))), command)

    arguments = {"plant": types.vehicle, "command": types.vector}
    return trace_to_warp("stop_in_dead_band", arguments, stop, [types.vector], constants={})


STAGES = {"euler": 1.0, "rk4": 0.5}  # Share of a step between two evaluations of the rotor lag


@wp.func
def normalise_load_direction(load: wp.spatial_vector) -> wp.spatial_vector:
    """Normalise direction and rate of a link to ``|n| = 1``, ``n . n' = 0``."""
    direction = wp.normalize(wp.spatial_top(load))
    rate = wp.spatial_bottom(load)
    return wp.spatial_vector(direction, rate - wp.dot(rate, direction) * direction)


def make_stepper(model: Model, integrator: str, constants: Constants) -> wp.Function:
    """Return the function of one step of the centre of mass and the rotors."""
    num_rotors, general = model.vehicle.num_rotors, not model.vehicle.plain
    types, late = rotor_types(num_rotors, general), bool(model.effects[DelayEffect])
    parts = (
        types.vehicle,
        types.vector,
        types.succession if late else types.vector,
        effect_values_type(model),
        make_accelerations(model, constants),
        bool(model.effects[LoadEffect]),
    )
    follow = make_rotor_lag(num_rotors, general, late)
    if integrator == "euler" and model.effects[FluidEffect]:
        return _make_euler_in_fluid(*parts, follow, *make_force_free_motion(model, constants))
    if integrator == "euler":
        return _make_euler(*parts, follow)
    return _make_rk4(
        *parts, follow, make_rotor_lag(num_rotors, general, late, stages=2), make_stage_rates(num_rotors, general, late)
    )


def _make_euler(
    vehicle_type: Any, vector: Any, command_type: Any, params_type: Any, accelerations: wp.Function, any_load: bool,
    follow: wp.Function,
) -> wp.Function:  # fmt: skip
    @wp.func
    def euler(
        vehicle: vehicle_type, params: params_type, gravity: float, position: wp.vec3, attitude: wp.quat,
        lin_vel: wp.vec3, ang_vel: wp.vec3, rotor_speed: vector, load: wp.spatial_vector, command: command_type,
        dt: float,
    ):  # fmt: skip
        rotors = follow(vehicle, rotor_speed, command, dt)
        spin_up = (1.0 / dt) * (rotors - rotor_speed)
        acc, ang_acc, swing = accelerations(
            vehicle, params, gravity, position, attitude, lin_vel, ang_vel, rotors, spin_up, load
        )
        v = lin_vel + dt * acc
        w = ang_vel + dt * ang_acc
        hung = load
        if wp.static(any_load):
            rate = wp.spatial_bottom(load) + dt * wp.spatial_bottom(swing)
            hung = normalise_load_direction(wp.spatial_vector(wp.spatial_top(load) + dt * rate, rate))
        return position + dt * v, unit_quat(attitude * rotation_quat(dt * w)), v, w, rotors, hung

    return euler


def _make_euler_in_fluid(
    vehicle_type: Any, vector: Any, command_type: Any, params_type: Any, accelerations: wp.Function, any_load: bool,
    follow: wp.Function, coast: wp.Function, free_accelerations: wp.Function,
) -> wp.Function:  # fmt: skip
    """Return the Warp version of ``integrators.euler_in_fluid``."""

    @wp.func
    def advance_load(load: wp.spatial_vector, dt: float) -> wp.spatial_vector:
        rate = wp.spatial_bottom(load)
        return normalise_load_direction(wp.spatial_vector(wp.spatial_top(load) + dt * rate, rate))

    @wp.func
    def euler_in_fluid(
        vehicle: vehicle_type, params: params_type, gravity: float, position: wp.vec3, attitude: wp.quat,
        lin_vel: wp.vec3, ang_vel: wp.vec3, rotor_speed: vector, load: wp.spatial_vector, command: command_type,
        dt: float,
    ):  # fmt: skip
        half = 0.5 * dt
        rotors = follow(vehicle, rotor_speed, command, dt)
        spin_up = (1.0 / dt) * (rotors - rotor_speed)
        x, q, v, w = coast(vehicle, params, position, attitude, lin_vel, ang_vel, half)
        hung = load
        if wp.static(any_load):
            hung = advance_load(load, half)
        acc, ang_acc, swing = accelerations(vehicle, params, gravity, x, q, v, w, rotors, spin_up, hung)
        free_acc, free_ang_acc = free_accelerations(vehicle, params, x, q, v, w)
        pushed = v + dt * (acc - free_acc)
        turning = w + dt * (ang_acc - free_ang_acc)
        end_x, end_q, end_v, end_w = coast(vehicle, params, x, q, pushed, turning, half)
        ends = hung
        if wp.static(any_load):
            rate = wp.spatial_bottom(hung) + dt * wp.spatial_bottom(swing)
            ends = advance_load(wp.spatial_vector(wp.spatial_top(hung), rate), half)
        return end_x, end_q, end_v, end_w, rotors, ends

    return euler_in_fluid


def _make_rk4(
    vehicle_type: Any, vector: Any, command_type: Any, params_type: Any, accelerations: wp.Function, any_load: bool,
    follow_half: wp.Function, follow: wp.Function, stage_rates: wp.Function,
) -> wp.Function:  # fmt: skip
    @wp.func
    def rk4(
        vehicle: vehicle_type, params: params_type, gravity: float, position: wp.vec3, attitude: wp.quat,
        lin_vel: wp.vec3, ang_vel: wp.vec3, rotor_speed: vector, load: wp.spatial_vector, command: command_type,
        dt: float,
    ):  # fmt: skip
        half = 0.5 * dt
        middle = follow_half(vehicle, rotor_speed, command, half)
        end = follow(vehicle, rotor_speed, command, dt)
        n1, n2, n4 = stage_rates(vehicle, rotor_speed, middle, end, command, dt)
        a1, b1, s1 = accelerations(
            vehicle, params, gravity, position, attitude, lin_vel, ang_vel, rotor_speed, n1, load
        )
        r1 = attitude_rate(attitude, ang_vel)
        v2 = lin_vel + half * a1
        w2 = ang_vel + half * b1
        q2 = attitude + half * r1
        l2 = load + half * s1
        a2, b2, s2 = accelerations(vehicle, params, gravity, position + half * lin_vel, q2, v2, w2, middle, n2, l2)
        r2 = attitude_rate(q2, w2)
        v3 = lin_vel + half * a2
        w3 = ang_vel + half * b2
        q3 = attitude + half * r2
        l3 = load + half * s2
        a3, b3, s3 = accelerations(vehicle, params, gravity, position + half * v2, q3, v3, w3, middle, n2, l3)
        r3 = attitude_rate(q3, w3)
        v4 = lin_vel + dt * a3
        w4 = ang_vel + dt * b3
        q4 = attitude + dt * r3
        l4 = load + dt * s3
        a4, b4, s4 = accelerations(vehicle, params, gravity, position + dt * v3, q4, v4, w4, end, n4, l4)
        r4 = attitude_rate(q4, w4)
        sixth = dt / 6.0
        hung = load
        if wp.static(any_load):
            hung = normalise_load_direction(load + sixth * (s1 + 2.0 * s2 + 2.0 * s3 + s4))
        return (
            position + sixth * (lin_vel + 2.0 * v2 + 2.0 * v3 + v4),
            unit_quat(attitude + sixth * (r1 + 2.0 * r2 + 2.0 * r3 + r4)),
            lin_vel + sixth * (a1 + 2.0 * a2 + 2.0 * a3 + a4),
            ang_vel + sixth * (b1 + 2.0 * b2 + 2.0 * b3 + b4),
            end,
            hung,
        )

    return rk4
