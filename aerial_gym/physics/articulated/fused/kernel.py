"""The fused kernel of articulated vehicles, composed for one model and control law.

One step of ``steppers.implicit_euler`` per substep; the state stays in registers over the substeps.
Letters: E environments, R rotors, D joints, C joints with a drive, U entries of an action, N numbers per environment (of
dashpots: creep elements of a joint).
"""

from functools import cache
from typing import Any

import warp as wp

from aerial_gym.math.warp_functions import rotate, rotate_inverse, small_turn, solve_motion, unit_quat, vector_type
from aerial_gym.physics.articulated.articulation import Articulation
from aerial_gym.physics.articulated.complementarity import ROUNDS
from aerial_gym.physics.articulated.fused.effort_limits import make_bounded
from aerial_gym.physics.articulated.fused.efforts import make_creep
from aerial_gym.physics.articulated.fused.hubs import hub_links, make_hubs
from aerial_gym.physics.articulated.fused.inertia import Inertia, center_of_mass, plus, rigid_inertia
from aerial_gym.physics.articulated.fused.link_effects import effect_links, make_on_links
from aerial_gym.physics.articulated.fused.recursion import joint_types, make_recursion
from aerial_gym.physics.effects import DelayEffect, WrenchEffect
from aerial_gym.physics.fused.contact import ContactParameters
from aerial_gym.physics.fused.formulas import make_loads, make_wind
from aerial_gym.physics.fused.hook import FusedHook, NoHook, Substep
from aerial_gym.physics.fused.law import FusedLaw, preparation
from aerial_gym.physics.fused.memory import make_begin, memory_type
from aerial_gym.physics.fused.packing import Packing, collect_numbers, model_types, num_values, values_type
from aerial_gym.physics.fused.readers import make_completion, make_reader, make_vehicle_reader
from aerial_gym.physics.fused.rotors import make_dead_band, make_follow
from aerial_gym.physics.fused.row_model import structure_constants
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


def make_base(articulation: Articulation, vehicle_type: Any) -> wp.Function:
    """Return the function of the base's inertia: (vehicle, angular velocity, velocity) -> ``Inertia``.

    It is the whole vehicle in its reference pose minus the links, as in ``Articulation.links``; inertias about the base's
    origin add up.
    """
    carried = float(articulation.link_mass.sum())
    moment = wp.vec3(*(articulation.link_mass @ articulation.link_com).tolist())
    inertia = articulation.link_inertia.new_zeros(3, 3)
    for mass, com, own in zip(articulation.link_mass, articulation.link_com, articulation.link_inertia, strict=True):
        inertia = inertia + own + mass * (com @ com * inertia.new_ones(3).diag() - com.outer(com))
    links = wp.mat33(*inertia.flatten().tolist())

    @wp.func
    def base(vehicle: vehicle_type, ang_vel: wp.vec3, lin_vel: wp.vec3) -> Inertia:
        mass = 1.0 / vehicle.mass_inverse
        lever = wp.skew(vehicle.com)
        own = mass - wp.static(carried)
        com = (mass * vehicle.com - moment) / own
        about = vehicle.inertia - mass * (lever * lever) - links  # about the origin
        own_lever = wp.skew(com)
        return rigid_inertia(own, com, about + own * (own_lever * own_lever), ang_vel, lin_vel)

    return base


def make_jointed_kernel(
    model: Model, law: FusedLaw, packing: Packing, *, num_spheres: int, hook: FusedHook | None
) -> wp.Kernel:
    """Return the kernel; absent features cost nothing.

    Args:
        packing: Rows of numbers that differ between environments.
        num_spheres: Number of the base's spheres in the ground test; 0 without ground.
        hook: Hook after every substep, with the base's origin in place of a centre of mass.
    """
    articulation = model.articulation
    assert articulation is not None
    num_rotors, (num_params, num_memory) = model.vehicle.num_rotors, num_values(model)
    in_air = bool(effect_links(model) or hub_links(model))
    general, types = not model.vehicle.plain, model_types(model)
    joints = joint_types(articulation.num_joints, values_type(model) if in_air else None, types.vector)
    vector, params_type, joint_vector = types.vector, values_type(model), joints.vector
    action_type = vector_type(law.num_actions + articulation.num_driven)
    drive_type = vector_type(max(articulation.num_driven, 1))
    prepare, command_of, law_type = preparation(law), law.command, law.struct
    law_part, drive_part = _make_split(law.num_actions, articulation.num_driven)
    remembers, law_remembers = bool(model.effects.names_with_memory), law.needs is not None
    begin = make_begin(model) if remembers else None
    memories_type = memory_type(effects=remembers, law=law_remembers)
    vehicle_type = types.vehicle
    stop = make_dead_band(num_rotors) if general else None
    late = bool(model.effects[DelayEffect])
    follow_rotors = make_follow(num_rotors, general, late)
    constants = structure_constants(collect_numbers(model, law, 1.0).vehicle)
    loads = make_loads(model, constants, lambda effect: not effect.at_hubs)
    any_wrench = any(not effect.at_hubs for effect, _ in model.effects[WrenchEffect])
    air, hubs = make_on_links(model, joints), make_hubs(model, joints)
    way_in, way_back = make_recursion(articulation, types, joints, air, hubs)
    base_in_air, wind = air.get(0), make_wind(model) if in_air else None
    base, floating = make_base(articulation, vehicle_type), articulation.tree.floating
    bounded, rubs, ahead = make_bounded(articulation), articulation.rubs, articulation.solves_limits
    ask, sides, tangent, fits = bounded.ask, bounded.sides, bounded.tangent, bounded.fits
    line_search, driven, rubbing, pushes = bounded.line_search, bounded.driven, bounded.rubbing, bounded.pushes
    (pull, creep_on), num_creep = make_creep(articulation), articulation.num_creep
    num_joints, held_type = articulation.num_joints, joints.held
    dashpot_type = vector_type(max(num_creep * num_joints, 1))
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
        vehicle: vehicle_type, more: wp.spatial_vector, held: wp.vec3, pos: joint_vector, vel: joint_vector,
        swing_vel: joint_vector, given: held_type, thrusts: vector, drags: vector, w_0: wp.vec3, w: wp.vec3,
        move: wp.vec3, dt: float,
    ):  # fmt: skip
        """Return rates of joints at the end of the step, angular acceleration and acceleration of the base with gravity,
        with the velocity terms of ``w`` and ``swing_vel``."""
        carried, kept = way_in(vehicle, pos, vel, swing_vel, given, thrusts, drags, w_0, w, move, dt)
        turn = wp.vec3()
        rise = held
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
                    move,
                    w,
                    move,
                    wp.vec3(),
                    wp.vec3(),
                    given,
                    dt,
                )
            turn, rise = solve(plus(carried, own))
        return vel + dt * way_back(kept, turn, rise), turn, rise

    @wp.func
    def solve_limits(
        vehicle: vehicle_type, more: wp.spatial_vector, held: wp.vec3, pos: joint_vector, vel: joint_vector,
        asked: joint_vector, given: held_type, thrusts: vector, drags: vector, w: wp.vec3, move: wp.vec3, dt: float,
    ):  # fmt: skip
        """Return the results of ``find`` with limited drives and dry friction, and the rate of velocity terms.

        It is the Warp version of ``steppers.with_drive``, with one loop over all solutions, which compiles ``find`` once.
        """
        acts = given
        rates = vel
        turn = wp.vec3()
        rise = held
        half_w = w
        half_vel = vel
        at = vel  # rates of the tried limited laws
        efforts = joint_vector()  # efforts at these rates
        stage = wp.int32(
            0
        )  # velocity terms 0: of the start, 1: of the middle; 2: constant efforts; 3: without friction
        rounds = wp.int32(0)
        while stage < 4:
            of_drives, of_friction = sides(asked, at, dt)
            value, slope = tangent(asked, of_drives, of_friction, dt)
            if stage > 1:
                value = efforts
                slope = joint_vector()
            acts.bounded_value = value
            acts.bounded_slope = slope
            rates, turn, rise = find(vehicle, more, held, pos, vel, half_vel, acts, thrusts, drags, w, half_w, move, dt)
            if stage > 1:
                stage += 2
                if wp.static(rubs) and stage == 4 and pushes(rubbing(at), rates):
                    efforts = driven(asked, at, dt)
                    stage = 3
            elif fits(asked, of_drives, of_friction, rates, dt) or (stage == 0 and rounds == wp.static(ROUNDS)):
                if stage == 0:
                    half_w = w + 0.5 * dt * turn
                    half_vel = 0.5 * (vel + rates)
                stage = wp.where(stage == 0, 1, 4)
                rounds = 0
                at = rates
            elif rounds == wp.static(ROUNDS):
                efforts = driven(asked, at, dt) + rubbing(at)
                stage = 2
            else:
                end = value - wp.cw_mul(slope, rates)
                share = wp.float32(1.0)
                if rounds > 0:
                    share = line_search(asked, at, efforts, rates, end, dt)
                efforts += share * (end - efforts)
                at += share * (rates - at)
                rounds += 1
        return rates, turn, rise, half_w

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
        if wp.static(num_creep > 0):
            given.crept = pull(crept)
        if wp.static(ahead):
            rates, turn, rise, half_w = solve_limits(
                vehicle, more, held, pos, vel, ask(pos, drives), given, thrusts, drags, w, move, dt
            )
        else:
            half_w = w
            rates, turn, rise = find(vehicle, more, held, pos, vel, vel, given, thrusts, drags, w, w, move, dt)
        lin_vel = v
        ang_vel = w
        if wp.static(floating):
            lin_vel = v + dt * (rotate(q, rise + wp.cross(half_w, move)) - wp.vec3(0.0, 0.0, gravity))
            ang_vel = w + dt * turn
        return (
            x + dt * lin_vel,
            unit_quat(q * small_turn(dt * ang_vel)),
            lin_vel,
            ang_vel,
            pos + dt * rates,
            rates,
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
    ):
        """Advance one environment."""
        env = wp.tid() + first
        vehicle = read_vehicle(shared_vehicle, packed, env)
        law_numbers = read_law(shared_law, packed, env)
        params = read_params(packed, wp.static(first_param), env)
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
            if wp.isnan(crept[i]):
                crept[i] = pos[i % wp.static(num_joints)]
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
            x, q, v, w, pos, vel = step_once(
                vehicle, params, gravity, x, q, v, w, before, n, pos, vel, drives, crept, dt
            )
            if wp.static(num_creep > 0):
                crept = creep_on(crept, pos, dt)
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

    return advance
