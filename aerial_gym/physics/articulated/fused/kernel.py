"""The fused kernel of articulated vehicles, composed for one model and control law.

One step of ``steppers.implicit_euler`` per substep; the state stays in registers over the substeps.
Letters: E environments, R rotors, D joints, C joints with a drive, U entries of an action, N numbers per environment (of
dashpots: creep elements of a joint).
"""

from functools import cache
from types import SimpleNamespace

import warp as wp
from torch import Tensor

from aerial_gym.math.warp_functions import rotate, rotate_inverse, rotation_quat, solve_motion, unit_quat, vector_type
from aerial_gym.physics.articulated.fused.inertia import Inertia, center_of_mass, rigid_inertia, sum_of_inertias
from aerial_gym.physics.articulated.fused.joint_formulas import dashpots_type, make_creep
from aerial_gym.physics.articulated.fused.limit_solver import make_limit_solver, make_solver_without_limits
from aerial_gym.physics.articulated.fused.link_effects import (
    effect_links,
    hub_links,
    make_hub_effects,
    make_link_effects,
)
from aerial_gym.physics.articulated.fused.recursion import joint_types, make_recursion
from aerial_gym.physics.effects import DelayEffect, LinkFluidEffect, WrenchEffect
from aerial_gym.physics.fused.contact import ContactParameters
from aerial_gym.physics.fused.dynamics import make_dead_band, make_rotor_lag
from aerial_gym.physics.fused.formulas import constant_entries_of_vehicle, make_loads, make_wind, vehicle_rows
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
from aerial_gym.physics.fused.torch_trace import trace_to_warp
from aerial_gym.physics.fused.types import make_completion, make_reader, make_vehicle_reader
from aerial_gym.physics.model import Model


@cache
def _make_split(num_actions: int, num_driven: int) -> tuple[wp.Function, wp.Function]:
    """Return functions that extract the control law's action and the drives' commands from an action."""
    whole, law, drives = (
        vector_type(num_actions + num_driven),
        vector_type(num_actions),
        vector_type(max(num_driven, 1)),
    )

    @wp.func
    def of_law(action: whole) -> law:
        part = law()
        for i in range(wp.static(num_actions)):
            part[i] = action[i]
        return part

    @wp.func
    def of_drives(action: whole) -> drives:
        part = drives()
        for i in range(wp.static(num_driven)):
            part[i] = action[wp.static(num_actions) + i]
        return part

    return of_law, of_drives


def make_base_inertia(model: Model) -> wp.Function:
    """Return the function of the base's inertia: (vehicle, angular velocity, velocity) -> ``Inertia``."""
    articulation, vehicle_type = model.articulation, rotor_types_of_model(model).vehicle
    assert articulation is not None

    def base_numbers(plant: SimpleNamespace) -> tuple[Tensor, Tensor, Tensor]:
        vehicle = vehicle_rows(model, plant)
        return articulation.base(vehicle.mass, vehicle.com, vehicle.inertia)

    numbers = trace_to_warp(
        "base_numbers", {"plant": vehicle_type}, base_numbers, [float, wp.vec3, wp.mat33], constants={}
    )

    @wp.func
    def base_inertia(vehicle: vehicle_type, ang_vel: wp.vec3, lin_vel: wp.vec3) -> Inertia:
        mass, com, about = numbers(vehicle)
        return rigid_inertia(mass, com, about, ang_vel, lin_vel)

    return base_inertia


def make_jointed_kernel(
    model: Model, law: FusedLaw, packing: Packing, *, num_spheres: int, hook: FusedHook | None, efforts: bool = False
) -> wp.Kernel:
    """Return the kernel; absent features cost nothing.

    Args:
        packing: Rows of numbers that differ between environments.
        num_spheres: Number of the base's spheres in the ground test; 0 without ground.
        hook: Hook after every substep, with the base's origin in place of a centre of mass.
        efforts: Whether to write the efforts that drives and dry friction applied in the last substep.
    """
    articulation = model.articulation
    assert articulation is not None
    num_rotors, (num_params, num_memory) = model.vehicle.num_rotors, num_parameters_and_memory(model)
    in_air = bool(effect_links(model) or hub_links(model))
    general, types = not model.vehicle.plain, rotor_types_of_model(model)
    joints = joint_types(articulation, effect_values_type(model) if in_air else None, types.vector)
    vector, params_type, joint_vector = types.vector, effect_values_type(model), joints.vector
    action_type = vector_type(law.num_actions + articulation.num_driven)
    drive_type = vector_type(max(articulation.num_driven, 1))
    prepare, command_of, law_type = preparation(law), law.command, law.struct
    law_part, drive_part = _make_split(law.num_actions, articulation.num_driven)
    remembers, law_remembers = bool(model.effects.names_with_memory), law.needs is not None
    begin = make_substep_start(model) if remembers else None
    memories_type = memory_type(effects=remembers, law=law_remembers)
    vehicle_type = types.vehicle
    stop = make_dead_band(num_rotors) if general else None
    late = bool(model.effects[DelayEffect])
    follow_rotors = make_rotor_lag(num_rotors, general, late)
    constants = constant_entries_of_vehicle(collect_numbers(model, law, 1.0).vehicle)
    loads = make_loads(model, constants, lambda effect: not effect.at_hubs)
    any_wrench = any(not effect.at_hubs for effect, _ in model.effects[WrenchEffect])
    air, hubs = make_link_effects(model, joints), make_hub_effects(model, joints)
    ahead, in_fluid = articulation.solves_limits, bool(model.effects[LinkFluidEffect])
    way_in, way_back = make_recursion(articulation, types, joints, air, hubs, centered=ahead or in_fluid)
    base_in_air, wind = air.get(0), make_wind(model) if in_air else None
    base, floating = make_base_inertia(model), articulation.tree.floating
    (initialise_creep, advance_creep), num_creep = make_creep(articulation), articulation.num_creep
    num_joints = articulation.num_joints
    dashpot_type, held_type = dashpots_type(articulation), joints.held
    writes_efforts = efforts and ahead
    read_vehicle = make_vehicle_reader(types, packing.vehicle, packing.entries)
    read_law = make_completion(law_type, {**packing.followed, **packing.law}, {})
    read_params = make_reader(params_type, num_params, 0)
    first_param = packing.effects
    follows, hook_type = hook is not None, NoHook if hook is None else hook.struct
    follow, records = (None, False) if hook is None else (hook.function, hook.joints)

    @wp.func
    def solve(whole: Inertia):
        """Return angular acceleration and acceleration of the base for its articulated inertia."""
        rise, turn = solve_motion(whole.push, whole.mixed, whole.turn, whole.force, whole.torque)
        return -turn, -rise

    @wp.func
    def find(
        vehicle: vehicle_type, more: wp.spatial_vector, fall: wp.vec3, pos: joint_vector, vel: joint_vector,
        swing_vel: joint_vector, given: held_type, thrusts: vector, drags: vector, w_0: wp.vec3, move_0: wp.vec3,
        w: wp.vec3, move: wp.vec3, dt: float,
    ):  # fmt: skip
        """Return rates of joints at the end of the step, angular acceleration of the base, and acceleration of its origin with
        gravity, with the velocity terms of ``w``, ``move`` and ``swing_vel``."""
        carried, kept = way_in(vehicle, pos, vel, swing_vel, given, thrusts, drags, w_0, move_0, w, move, dt)
        turn = wp.vec3()
        rise = fall
        if wp.static(floating):
            own = base(vehicle, w, move)
            if wp.static(any_wrench):
                push = wp.spatial_top(more)
                own.force -= push
                own.torque -= wp.spatial_bottom(more) + wp.cross(vehicle.com, push)
            if wp.static(base_in_air is not None):
                own = base_in_air(
                    own,
                    wp.identity(n=3, dtype=float),
                    center_of_mass(own),
                    w_0,
                    move_0,
                    w,
                    move,
                    wp.vec3(),
                    wp.vec3(),
                    given,
                    dt,
                )
            turn, rise = solve(sum_of_inertias(carried, own))
        return vel + dt * way_back(kept, turn, rise), turn, rise + wp.cross(w, move)

    if ahead:
        solve_step = make_limit_solver(find, articulation, types, joints, in_fluid=in_fluid)
    else:
        solve_step = make_solver_without_limits(find, articulation, types, joints, in_fluid=in_fluid)

    @wp.func
    def step_once(
        vehicle: vehicle_type, params: params_type, gravity: float, x: wp.vec3, q: wp.quat, v: wp.vec3, w: wp.vec3,
        before: vector, n: vector, pos: joint_vector, vel: joint_vector, drives: drive_type, crept: dashpot_type,
        dt: float,
    ):  # fmt: skip
        com = rotate(q, vehicle.com)
        com_vel = v + rotate(q, wp.cross(w, vehicle.com))
        thrusts, drags, more = loads(vehicle, params, x + com, q, com_vel, w, n, (n - before) / dt)
        move = rotate_inverse(q, v)
        held = rotate_inverse(q, wp.vec3(0.0, 0.0, gravity))
        given = held_type()
        if wp.static(in_air):
            given.params = params
            given.wind = rotate_inverse(q, wind(x + com, params))
            given.weight = held
            given.position = x
            given.attitude = q
            given.rotor_speed = n
            given.rotor_acc = (n - before) / dt
        given.crept = crept
        rates, turn, rise, drive, friction = solve_step(
            vehicle, more, held, pos, vel, drives, given, thrusts, drags, w, move, dt
        )
        lin_vel = v
        ang_vel = w
        if wp.static(floating):
            lin_vel = v + dt * (rotate(q, rise) - wp.vec3(0.0, 0.0, gravity))
            ang_vel = w + dt * turn
        return (
            x + dt * lin_vel,
            unit_quat(q * rotation_quat(dt * ang_vel)),
            lin_vel,
            ang_vel,
            pos + dt * rates,
            rates,
            drive,
            friction,
        )

    @wp.kernel(module="unique", enable_backward=False)
    def advance(
        # state
        position: wp.array[wp.vec3],  # (E,) base origin, world [m]
        attitude: wp.array[wp.quat],  # (E,) base to world, xyzw, unit
        lin_vel: wp.array[wp.vec3],  # (E,) world [m/s]
        ang_vel: wp.array[wp.vec3],  # (E,) body [rad/s]
        rotor_speed: wp.array[vector],  # (E,) [rad/s]
        joint_pos: wp.array[joint_vector],  # (E,) [rad]
        joint_vel: wp.array[joint_vector],  # (E,) [rad/s]
        action: wp.array[action_type],  # (E,)
        # params
        shared_vehicle: vehicle_type,
        shared_law: law_type,
        packed: wp.array2d[float],  # (N, E)
        spheres: wp.array[wp.vec4],  # (C,) centre in the body frame, radius [m]
        ground_height: float,  # [m] world
        ground_law: ContactParameters,  # of the rigid kernel; not used
        gravity: float,  # [m/s²]
        dt: float,  # [s]
        substeps: int,
        first: int,  # environment of the first thread
        memory: memories_type,  # read and written
        hook_data: hook_type,  # read and written
        dashpots: wp.array2d[float],  # (N D, E) of joints that creep, NaN where an episode begins; read and written
        # out
        position_out: wp.array[wp.vec3],
        attitude_out: wp.array[wp.quat],
        lin_vel_out: wp.array[wp.vec3],
        ang_vel_out: wp.array[wp.vec3],
        rotor_speed_out: wp.array[vector],
        joint_pos_out: wp.array[joint_vector],
        joint_vel_out: wp.array[joint_vector],
        contact_out: wp.array[wp.bool],  # (E,) set where the base touches the ground
        impulse_out: wp.array[wp.vec3],  # (E,) of the rigid kernel; not written
        drive_effort_out: wp.array[joint_vector],  # (E,) of the last substep [N m]; written on request
        friction_effort_out: wp.array[joint_vector],
    ):
        """Advance one environment."""
        env = wp.tid() + first
        vehicle = read_vehicle(shared_vehicle, packed, env)
        law_numbers = read_law(shared_law, packed, env)
        params = read_params(packed, wp.static(first_param), env)
        drive = joint_vector()
        friction = joint_vector()
        x = position[env]
        q = attitude[env]
        v = lin_vel[env]
        w = ang_vel[env]
        n = rotor_speed[env]
        pos = joint_pos[env]
        vel = joint_vel[env]
        if wp.static(not floating):
            v = wp.vec3()
            w = wp.vec3()
        u = prepare(law_part(action[env]), law_numbers)
        drives = drive_part(action[env])
        crept = dashpot_type()
        for i in range(wp.static(num_creep * num_joints)):
            crept[i] = dashpots[i, env]
        crept = initialise_creep(crept, pos)
        since = wp.int32(0)
        if wp.static(remembers and law_remembers):
            effects = memory.effects
        elif wp.static(remembers):
            effects = memory
        if wp.static(remembers):
            since = effects.since[env]
            for i in range(wp.static(num_memory)):
                params[wp.static(num_params) + i] = effects.numbers[i, env]
        for k in range(substeps):
            if wp.static(law_remembers):
                command = command_of(x, q, v, w, n, law_numbers, u, memory.law, env)
            else:
                command = command_of(x, q, v, w, n, law_numbers, u)
            if wp.static(general):
                command = stop(vehicle, command)
            if wp.static(remembers):
                params, followed = begin(vehicle, params, command, n, effects, env, since + k, dt)
            else:
                followed = command
            before = n
            first_x = x
            first_q = q
            first_v = v
            first_w = w
            if wp.static(records):  # noqa: SIM102 (only what stands alone is static)
                if k == 0:
                    for i in range(wp.static(num_joints)):
                        hook_data.joint_pos[0, env, i] = pos[i]
            n = follow_rotors(vehicle, before, followed, dt)
            x, q, v, w, pos, vel, drive, friction = step_once(
                vehicle, params, gravity, x, q, v, w, before, n, pos, vel, drives, crept, dt
            )
            if wp.static(num_creep > 0):
                crept = advance_creep(crept, pos, dt)
            if wp.static(num_spheres > 0):
                for i in range(wp.static(num_spheres)):
                    center = wp.vec3(spheres[i][0], spheres[i][1], spheres[i][2])
                    if x[2] + rotate(q, center)[2] - spheres[i][3] < ground_height:
                        contact_out[env] = True
            if wp.static(follows):
                done = Substep()
                done.dt = dt
                done.mass = 1.0 / vehicle.mass_inverse
                done.inertia = vehicle.inertia
                done.first_position = first_x
                done.first_attitude = first_q
                done.first_lin_vel = first_v
                done.first_ang_vel = first_w
                done.position = x
                done.attitude = q
                done.lin_vel = v
                done.ang_vel = w
                x, q, v, w = follow(hook_data, env, k, done)
            if wp.static(records):
                for i in range(wp.static(num_joints)):
                    hook_data.joint_pos[k + 1, env, i] = pos[i]
        if wp.static(remembers):
            effects.since[env] = since + substeps
            for i in range(wp.static(num_memory)):
                effects.numbers[i, env] = params[wp.static(num_params) + i]
        for i in range(wp.static(num_creep * num_joints)):
            dashpots[i, env] = crept[i]
        position_out[env] = x
        attitude_out[env] = q
        lin_vel_out[env] = v
        ang_vel_out[env] = w
        rotor_speed_out[env] = n
        joint_pos_out[env] = pos
        joint_vel_out[env] = vel
        if wp.static(writes_efforts):
            drive_effort_out[env] = drive
            friction_effort_out[env] = friction

    return advance
