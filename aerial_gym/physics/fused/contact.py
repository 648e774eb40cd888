"""Compliant contact with friction: the Warp version of ``physics.contact``, which states formula and source.

Letters: C contacts.
"""

from functools import cache
from typing import Any

import warp as wp

from aerial_gym.config.environment import ContactCfg
from aerial_gym.math.warp_functions import rotate, rotate_inverse, rotation_quat, solve_motion, vector_type
from aerial_gym.physics.contact import CAUTIOUS_ITERATIONS, ITERATIONS, PENALTY
from aerial_gym.physics.fused.types import rotor_types


@wp.struct
class ContactParameters:
    """Parameters of contact forces."""

    stiffness: float  # per mass [1/s²]
    damping: float  # per mass [1/s]
    friction: float
    crash_approach_speed: float  # least approach speed of a crash [m/s]
    share: float  # displacement at the end of a step per dt times the change of velocity
    iterations: int  # an argument, not a constant, so that the loop is not unrolled


def contact_parameters(cfg: ContactCfg | None, share: float) -> ContactParameters:
    """Return the struct of a configuration; zeros for None."""
    struct = ContactParameters()
    struct.iterations = ITERATIONS + CAUTIOUS_ITERATIONS
    if cfg is not None:
        struct.stiffness, struct.damping, struct.friction = cfg.stiffness, cfg.damping, cfg.friction
        struct.crash_approach_speed, struct.share = cfg.crash_approach_speed, share
    return struct


def rows_type(count: int) -> Any:
    """Return the type of a vector of three numbers for each contact."""
    return wp.types.matrix(shape=(count, 3), dtype=wp.float32)


@wp.func
def point_velocity(lin_vel: wp.vec3, turn: wp.vec3, lever: wp.vec3) -> wp.vec3:
    """Return the velocity of a point [m/s]; ``lever`` [m] from the centre of mass, all in world axes."""
    return lin_vel + wp.cross(turn, lever)


@wp.func
def _friction(base: wp.vec3, heading: wp.vec3, grip: float, slip: wp.vec3) -> wp.vec3:
    return base - grip * (slip - wp.dot(heading, slip) * heading)


@wp.func
def _choose_branch(
    law: ContactParameters, press: float, normal: wp.vec3, slip: wp.vec3, base: wp.vec3, heading: wp.vec3, grip: float,
    penalty: float, cautious: wp.bool,
):  # fmt: skip
    """Return the impulse of friction in the last solution, the direction of the next if it slides, else 0, and its grip.

    ``base`` and ``heading`` (0 for sticking) are those of the last solution, ``press`` and ``slip`` its results.
    """
    limit = law.friction * wp.max(press, 0.0)
    ease = wp.min(limit / wp.max(wp.length(slip), 1.0e-15), penalty)
    if cautious:
        return wp.vec3(), wp.vec3(), ease
    slid = wp.length(heading) > 0.0
    rub = _friction(base, heading, grip, slip)
    sticks = wp.where(slid, wp.dot(heading, slip) > 0.0, wp.length(rub) <= limit) and press > 0.0
    if sticks:
        return rub, wp.vec3(), penalty
    onwards = wp.where(slid, -slip, rub)
    onwards -= wp.dot(normal, onwards) * normal  # again, because of rounding along the normal at very small slip
    return rub, wp.normalize(onwards), ease


@wp.func
def displace(
    law: ContactParameters, dt: float, position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3, ang_vel: wp.vec3,
    delta: wp.vec3, delta_turn: wp.vec3,
):  # fmt: skip
    """Return position [m], attitude, velocity [m/s] and angular velocity [rad/s, body] after changes in world axes."""
    turned = rotation_quat(law.share * dt * delta_turn) * attitude
    return (
        position + law.share * dt * delta,
        wp.normalize(turned),
        lin_vel + delta,
        ang_vel + rotate_inverse(attitude, delta_turn),
    )


@cache
def make_velocity_change(count: int) -> wp.Function:
    """Return the function of the changes of velocity [m/s] and angular velocity [rad/s], world, by up to ``count`` contacts.

    Its inputs are mass and inertia [kg, kg m², body], attitude, velocity and angular velocity [world] after a step without
    contact, and of each contact gap [m; >= 0: none], lever [m], normal and surface velocity [m/s], world.
    """
    vector, rows = vector_type(count), rows_type(count)

    @wp.func
    def velocity_change(
        law: ContactParameters, dt: float, mass: float, inertia: wp.mat33, attitude: wp.quat, lin_vel: wp.vec3,
        turn: wp.vec3, gaps: vector, levers: rows, normals: rows, surface_vels: rows,
    ):  # fmt: skip
        one = wp.identity(n=3, dtype=float)
        rotation = wp.quat_to_matrix(attitude)
        hardness = dt * mass * (law.share * dt * law.stiffness + law.damping)
        penalty = mass * wp.static(PENALTY)
        delta = wp.vec3()
        delta_turn = wp.vec3()
        bases = rows()
        headings = rows()
        grips = vector()
        for k in range(law.iterations):
            if k == wp.static(ITERATIONS):
                work = float(wp.static(0.0))
                for i in range(wp.static(count)):
                    if gaps[i] < 0.0:
                        normal = normals[i]
                        start = point_velocity(lin_vel, turn, levers[i]) - surface_vels[i]
                        slip_at_start = start - wp.dot(normal, start) * normal
                        change = point_velocity(delta, delta_turn, levers[i])
                        slip = slip_at_start + change - wp.dot(normal, change) * normal
                        work += wp.dot(_friction(bases[i], headings[i], grips[i], slip), slip_at_start + slip)
                if work <= 0.0:
                    break
            a = mass * one
            b = wp.mat33()
            d = rotation * inertia * wp.transpose(rotation)
            force = wp.vec3()
            torque = wp.vec3()
            for i in range(wp.static(count)):  # branches of the last solution, then their sum
                if gaps[i] < 0.0:
                    lever = levers[i]
                    normal = normals[i]
                    start = point_velocity(lin_vel, turn, lever) - surface_vels[i]
                    slip_at_start = start - wp.dot(normal, start) * normal
                    load = dt * mass * (-law.stiffness * gaps[i] - law.damping * wp.dot(normal, start))
                    press = load
                    base = wp.vec3()
                    heading = wp.vec3()
                    grip = penalty
                    if k > 0:
                        change = point_velocity(delta, delta_turn, lever)
                        press = load - hardness * wp.dot(normal, change)
                        slip = slip_at_start + change - wp.dot(normal, change) * normal
                        rub, heading, grip = _choose_branch(
                            law,
                            press,
                            normal,
                            slip,
                            bases[i],
                            headings[i],
                            grips[i],
                            penalty,
                            k >= wp.static(ITERATIONS),
                        )
                        base = wp.where(wp.length(heading) > 0.0, law.friction * wp.max(press, 0.0) * heading, rub)
                    bases[i] = base
                    headings[i] = heading
                    grips[i] = grip
                    push = wp.where(press > 0.0, 1.0, 0.0)
                    held = one - wp.outer(normal, normal) - wp.outer(heading, heading)
                    give = push * hardness * wp.outer(normal, normal) + grip * held
                    impulse = push * load * normal + base - grip * (held * slip_at_start)
                    arm = wp.skew(lever)
                    a += give
                    b += arm * give
                    d -= arm * give * arm
                    force += impulse
                    torque += wp.cross(lever, impulse)
            delta, delta_turn = solve_motion(a, b, d, force, torque)
        return delta, delta_turn

    return velocity_change


def make_push_off_ground(num_rotors: int, num_spheres: int, general: bool) -> wp.Function:
    """Return the function of a horizontal plane's impulses on one environment.

    Its inputs are spheres from the body origin, and the motion of the centre of mass before and after a step without contact.
    It returns the motion, the impulse [N s, world] and a crash flag; a motion without contact is returned bit for bit.
    """
    vehicle_type, vector, rows = (
        rotor_types(num_rotors, general).vehicle,
        vector_type(num_spheres),
        rows_type(num_spheres),
    )
    velocity_change = make_velocity_change(num_spheres)

    @wp.func
    def push_off_ground(
        vehicle: vehicle_type, law: ContactParameters, spheres: wp.array[wp.vec4], height: float,
        first_lin_vel: wp.vec3, first_ang_vel: wp.vec3, position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3,
        ang_vel: wp.vec3, dt: float,
    ):  # fmt: skip
        first_turn = rotate(attitude, first_ang_vel)
        gaps = vector()
        levers = rows()
        normals = rows()
        lowest = float(wp.inf)
        crashes = wp.bool(False)
        for i in range(wp.static(num_spheres)):
            lever = rotate(attitude, wp.vec3(spheres[i][0], spheres[i][1], spheres[i][2]) - vehicle.com)
            lever[2] = lever[2] - spheres[i][3]
            gap = position[2] + lever[2] - height
            approach = -point_velocity(first_lin_vel, first_turn, lever)[2]
            if gap < 0.0 and approach >= law.crash_approach_speed:
                crashes = True
            lowest = wp.min(lowest, gap)
            gaps[i] = gap
            levers[i] = lever
            normals[i] = wp.vec3(0.0, 0.0, 1.0)
        if lowest >= 0.0:
            return position, attitude, lin_vel, ang_vel, wp.vec3(), crashes
        mass = 1.0 / vehicle.mass_inverse
        turn = rotate(attitude, ang_vel)
        delta, delta_turn = velocity_change(
            law, dt, mass, vehicle.inertia, attitude, lin_vel, turn, gaps, levers, normals, rows()
        )
        x, q, v, w = displace(law, dt, position, attitude, lin_vel, ang_vel, delta, delta_turn)
        return x, q, v, w, mass * delta, crashes

    return push_off_ground
