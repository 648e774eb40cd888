"""The fused kernel: all substeps of a step in every environment, composed for one model, law and integrator.

Letters: E environments, R rotors, U entries of an action, N numbers per environment, C collision spheres.
"""

from functools import cache
from typing import Any

import warp as wp

from aerial_gym.math.warp_functions import load_quat, load_vec4, rotate, store_quat, store_vec4, vector_type
from aerial_gym.physics.effects import LoadEffect
from aerial_gym.physics.fused.contact import ContactParameters, make_push_off_ground
from aerial_gym.physics.fused.dynamics import make_dead_band, make_stepper
from aerial_gym.physics.fused.formulas import constant_entries_of_vehicle
from aerial_gym.physics.fused.hook import FusedHook, NoHook, Substep
from aerial_gym.physics.fused.law import FusedLaw, preparation
from aerial_gym.physics.fused.memory import make_substep_start, memory_type
from aerial_gym.physics.fused.packing import (
    Packing,
    collect_numbers,
    effect_values_type,
    num_parameters_and_memory,
    rotor_types_of_model,
)
from aerial_gym.physics.fused.types import make_completion, make_reader, make_vehicle_reader
from aerial_gym.physics.model import Model


@cache
def _make_access(kind: Any) -> tuple[wp.Function, wp.Function]:
    """Return differentiable functions that read and write one vector of an array."""

    @wp.func
    def get(source: wp.array[kind], i: int) -> kind:
        return source[i]

    @wp.func
    def put(out: wp.array[kind], i: int, value: kind):
        out[i] = value

    return get, put


def make_kernel(
    model: Model, law: FusedLaw, integrator: str, packing: Packing, *, num_spheres: int, compliant: bool,
    com_offset: bool, hook: FusedHook | None, differentiable: bool,
) -> wp.Kernel:  # fmt: skip
    """Return the kernel; absent features cost nothing.

    Args:
        model: Gives the number of rotors and the effects.
        packing: Rows of numbers that differ between environments.
        num_spheres: Number of spheres in the ground test; 0 without ground.
        compliant: Whether the ground has contact forces.
        com_offset: Whether any centre of mass differs from the body origin.
        differentiable: Whether Warp generates the adjoint.
    """
    num_rotors, (num_params, num_memory) = model.vehicle.num_rotors, num_parameters_and_memory(model)
    general, types = not model.vehicle.plain, rotor_types_of_model(model)
    stop = make_dead_band(num_rotors) if general else None
    constants = {} if differentiable else constant_entries_of_vehicle(collect_numbers(model, law, 1.0).vehicle)
    vector, action_type, params_type = types.vector, vector_type(law.num_actions), effect_values_type(model)
    prepare, prepared_type = preparation(law), vector_type(law.num_prepared)
    remembers, num_loads = bool(model.effects.names_with_memory), 6 * len(model.effects[LoadEffect])
    any_load = num_loads > 0
    begin = make_substep_start(model) if remembers else None
    law_remembers, command_of, law_type = law.needs is not None, law.command, law.struct
    memories_type = memory_type(effects=remembers, law=law_remembers)
    vehicle_type = types.vehicle
    step = make_stepper(model, integrator, constants)
    read_vehicle = make_vehicle_reader(types, packing.vehicle, packing.entries)
    read_law = make_completion(law_type, {**packing.followed, **packing.law}, {})
    read_params = make_reader(params_type, num_params, 0)
    first_param = packing.effects
    follows, hook_type = hook is not None, NoHook if hook is None else hook.struct
    follow = None if hook is None else hook.function
    push_off_ground = make_push_off_ground(num_rotors, max(num_spheres, 1), general)
    get_quat, put_quat = (load_quat, store_quat) if not differentiable else _make_access(wp.quat)
    get_rotors, put_rotors = (load_vec4, store_vec4) if num_rotors == 4 and not differentiable else _make_access(vector)
    get_action = load_vec4 if law.num_actions == 4 and not differentiable else _make_access(action_type)[0]

    @wp.func
    def step_once(
        vehicle: vehicle_type, law: law_type, params: params_type, gravity: float, x: wp.vec3, q: wp.quat, v: wp.vec3,
        w: wp.vec3, n: vector, load: wp.spatial_vector, u: prepared_type, memory: memories_type, env: int, since: int,
        dt: float,
    ):  # fmt: skip
        origin = x
        origin_vel = v
        if wp.static(com_offset):
            origin = x - rotate(q, vehicle.com)
            origin_vel = v - rotate(q, wp.cross(w, vehicle.com))
        if wp.static(law_remembers):
            command = command_of(origin, q, origin_vel, w, n, law, u, memory.law, env)
        else:
            command = command_of(origin, q, origin_vel, w, n, law, u)
        if wp.static(general):
            command = stop(vehicle, command)
        values = params
        if wp.static(remembers and law_remembers):
            values, followed = begin(vehicle, params, command, n, memory.effects, env, since, dt)
        elif wp.static(remembers):
            values, followed = begin(vehicle, params, command, n, memory, env, since, dt)
        else:
            followed = command
        x, q, v, w, n, load = step(vehicle, values, gravity, x, q, v, w, n, load, followed, dt)
        return x, q, v, w, n, load, values

    @wp.kernel(module="unique", enable_backward=differentiable)
    def advance(
        # state
        position: wp.array[wp.vec3],  # (E,) body origin, world [m]
        attitude: wp.array[wp.quat],  # (E,) body to world, xyzw, unit
        lin_vel: wp.array[wp.vec3],  # (E,) world [m/s]
        ang_vel: wp.array[wp.vec3],  # (E,) body [rad/s]
        rotor_speed: wp.array[vector],  # (E,) [rad/s]
        action: wp.array[action_type],  # (E,)
        # params
        shared_vehicle: vehicle_type,
        shared_law: law_type,
        packed: wp.array2d[float],  # (N, E)
        spheres: wp.array[wp.vec4],  # (C,) centre in the body frame, radius [m]
        ground_height: float,  # [m] world
        ground_law: ContactParameters,
        gravity: float,  # [m/s²]
        dt: float,  # [s]
        substeps: int,
        first: int,  # environment of the first thread
        memory: memories_type,  # read and written
        hook_data: hook_type,  # read and written
        # out
        position_out: wp.array[wp.vec3],
        attitude_out: wp.array[wp.quat],
        lin_vel_out: wp.array[wp.vec3],
        ang_vel_out: wp.array[wp.vec3],
        rotor_speed_out: wp.array[vector],
        contact_out: wp.array[wp.bool],  # (E,) set at ground contact
        impulse_out: wp.array[wp.vec3],  # (E,) world [N s], the ground's impulse is added
    ):
        """Advance one environment; its state stays in registers over the substeps."""
        env = wp.tid() + first
        vehicle = read_vehicle(shared_vehicle, packed, env)
        law_numbers = read_law(shared_law, packed, env)
        params = read_params(packed, wp.static(first_param), env)
        x = position[env]
        q = get_quat(attitude, env)
        v = lin_vel[env]
        w = ang_vel[env]
        n = get_rotors(rotor_speed, env)
        u = prepare(get_action(action, env), law_numbers)
        if wp.static(com_offset):
            x = x + rotate(q, vehicle.com)
            v = v + rotate(q, wp.cross(w, vehicle.com))
        load = wp.spatial_vector()
        since = wp.int32(0)
        if wp.static(remembers and law_remembers):
            effects = memory.effects
        elif wp.static(remembers):
            effects = memory
        if wp.static(remembers):
            since = effects.since[env]
            for i in range(wp.static(num_memory)):
                params[wp.static(num_params) + i] = effects.numbers[i, env]
        if wp.static(any_load):
            for i in range(6):
                load[i] = effects.numbers[wp.static(num_memory - num_loads) + i, env]
        if wp.static(differentiable):  # no loop, because its adjoint would need the intermediate states
            x, q, v, w, n, load, params = step_once(
                vehicle, law_numbers, params, gravity, x, q, v, w, n, load, u, memory, env, since, dt
            )
            substeps = 0
        total = wp.vec3()
        for k in range(substeps):
            first_x = x
            first_q = q
            first_v = v
            first_w = w
            x, q, v, w, n, load, params = step_once(
                vehicle, law_numbers, params, gravity, x, q, v, w, n, load, u, memory, env,
                since + k, dt,
            )  # fmt: skip
            if wp.static(num_spheres > 0 and compliant):
                x, q, v, w, impulse, crashes = push_off_ground(
                    vehicle, ground_law, spheres, ground_height, first_v, first_w, x, q, v, w, dt
                )
                total += impulse
                if crashes:
                    contact_out[env] = True
            if wp.static(num_spheres > 0 and not compliant):
                for i in range(wp.static(num_spheres)):
                    center = wp.vec3(spheres[i][0], spheres[i][1], spheres[i][2])
                    if wp.static(com_offset):
                        center -= vehicle.com
                    if x[2] + rotate(q, center)[2] - spheres[i][3] < ground_height:
                        contact_out[env] = True
            if wp.static(follows):
                done = Substep()
                done.dt = dt
                done.mass = 1.0 / vehicle.mass_inverse
                done.inertia = vehicle.inertia
                done.com = vehicle.com
                done.first_position = first_x
                done.first_attitude = first_q
                done.first_lin_vel = first_v
                done.first_ang_vel = first_w
                done.position = x
                done.attitude = q
                done.lin_vel = v
                done.ang_vel = w
                x, q, v, w = follow(hook_data, env, k, done)
        if wp.static(remembers):
            effects.since[env] = since + substeps
            for i in range(wp.static(num_memory - num_loads)):
                effects.numbers[i, env] = params[wp.static(num_params) + i]
        if wp.static(any_load):
            for i in range(6):
                effects.numbers[wp.static(num_memory - num_loads) + i, env] = load[i]
        if wp.static(com_offset):
            x = x - rotate(q, vehicle.com)
            v = v - rotate(q, wp.cross(w, vehicle.com))
        position_out[env] = x
        put_quat(attitude_out, env, q)
        lin_vel_out[env] = v
        ang_vel_out[env] = w
        put_rotors(rotor_speed_out, env, n)
        if wp.static(num_spheres > 0 and compliant):
            impulse_out[env] = impulse_out[env] + total

    return advance
