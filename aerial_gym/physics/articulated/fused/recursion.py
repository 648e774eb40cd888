"""Articulated-body algorithm for one environment, unrolled for the topology of a tree.

All quantities are in axes of the base at this instant, without rotations between links, and each link's are about its own
origin. About a common origin, the small inertia of a rod would be a difference of large numbers, wrong by a thousandth in
float32 at the end of a snake. Each link is a function that calls those of its children. The inward pass eliminates one branch
before the next, and keeps 7 numbers of each joint for the outward pass, 13 of a joint with children. The velocity-dependent
acceleration of a link is computed from the base on and is part of its forces. ``implicit_euler`` adds to the diagonal of the
mass matrix in the rows of joints, hence to each joint's own inertia.
Topology, link geometry and joint laws are constants of the code; mass and inertia of the base are read.
Letters: D joints, R rotors, C joints with a drive.

Source: Featherstone (2008), Rigid Body Dynamics Algorithms, section 7.3 (articulated-body algorithm).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, reduce
from typing import Any

import warp as wp

from aerial_gym.math.warp_functions import vector_type
from aerial_gym.physics.articulated.articulation import Articulation
from aerial_gym.physics.articulated.fused.inertia import (
    Inertia,
    add_acceleration,
    rigid_inertia,
    shift_inertia,
    sum_of_inertias,
)
from aerial_gym.physics.articulated.fused.joint_formulas import dashpots_type, make_passive_efforts
from aerial_gym.physics.fused.types import RotorTypes


@dataclass(frozen=True)
class JointTypes:
    """Warp types whose size is the number of joints D of a vehicle: a vector and two structs."""

    vector: Any  # One number per joint
    way_back: Any  # `wp.struct` of the numbers of each joint that the outward pass needs
    held: Any  # `wp.struct` of the constants of a step


def joint_types(articulation: Articulation, params_type: Any, rotor_vector: Any) -> JointTypes:
    """Return the types for a vehicle's joints; ``params_type`` as for ``make_type_of_step_constants``."""
    num_joints = articulation.num_joints
    vector, rows = vector_type(num_joints), wp.types.matrix(shape=(num_joints, 3), dtype=wp.float32)
    fields = {
        "free": vector,  # acceleration of the joint for a parent without acceleration
        "by_turn": rows,  # its decrease per angular acceleration of the parent
        "by_push": rows,  # its decrease per acceleration of the parent's origin
        "axis": rows,
        "lever": rows,  # origin of the link from that of its parent [m]
    }
    struct = wp.struct(type("WayBack", (), {"__annotations__": fields, "__module__": __name__}))
    held = make_type_of_step_constants(vector, dashpots_type(articulation), params_type, rotor_vector)
    return JointTypes(vector, struct, held)


@cache
def make_type_of_step_constants(vector: Any, dashpots: Any, params_type: Any, rotor_vector: Any) -> Any:
    """Return the ``wp.struct`` of quantities that are constant over a step.

    It has the effort of drives and dry friction at the final rate 0, its decrease with this rate, and the positions of
    dashpots. With effects on links it also has their parameters, wind [m/s] and gravity [m/s²], axes of the base, the pose of
    the base, and states and accelerations of the rotors.

    Args:
        params_type: Type of the parameters; None without effects on links.
    """
    fields = {"effort": vector, "slope": vector, "crept": dashpots}
    if params_type is not None:
        fields |= {"params": params_type, "wind": wp.vec3, "weight": wp.vec3, "position": wp.vec3, "attitude": wp.quat}
        fields |= {"rotor_speed": rotor_vector, "rotor_acc": rotor_vector}
    return wp.struct(type("Held", (), {"__annotations__": fields, "__module__": __name__}))


def make_recursion(
    articulation: Articulation, types: RotorTypes, joints: JointTypes, air: Mapping[int, wp.Function],
    hubs: Mapping[int, wp.Function], *, centered: bool,
) -> tuple[wp.Function, wp.Function]:  # fmt: skip
    """Return the inward and the outward pass.

    Inward: (vehicle, positions of joints, their rates, rates of the velocity terms, constants of the step, thrusts, drag
    torques, angular velocity and velocity of the base at the start of the step, both of the velocity terms, dt) -> ``Inertia``
    of all links on the base, with the base's rotors, and the kept numbers. ``air`` are the
    functions of ``make_link_effects``, ``hubs`` those of ``make_hub_effects``. ``centered`` states whether the velocity terms
    have other rates than those of the start.
    Outward: (kept numbers, angular acceleration and acceleration of the base, gravity included) -> accelerations of joints.
    """
    vector, back_type, vehicle_type = joints.vector, joints.way_back, types.vehicle
    held_type = joints.held
    links = [
        _make_link(articulation, k, types, joints, air, hubs, passive_effort, centered)
        for k, passive_effort in enumerate(make_passive_efforts(articulation))
    ]
    inward, back = _make_leaf(types, joints)
    into: dict[int, wp.Function] = {}
    out: dict[int, wp.Function] = {}
    for k in reversed(range(articulation.num_joints)):  # children have larger indices
        into[k] = links[k](_function_of_joints(articulation, k + 1, into, inward, True))
        revolute = articulation.tree.joints[k].kind == "revolute"
        out[k] = _make_outward(k, revolute, joints, _function_of_joints(articulation, k + 1, out, back, False))
    way_in = _function_of_joints(articulation, 0, into, inward, True)
    way_back = _function_of_joints(articulation, 0, out, back, False)
    base_rotors = make_rotor_inertia(articulation, 0, types, joints, hubs.get(0))

    @wp.func
    def sweep_inward(
        vehicle: vehicle_type, pos: vector, vel: vector, swing_vel: vector, held: held_type,
        thrusts: types.vector, drags: types.vector, ang_vel_0: wp.vec3, lin_vel_0: wp.vec3, ang_vel: wp.vec3,
        lin_vel: wp.vec3, dt: float,
    ):  # fmt: skip
        kept = back_type()
        rotation = wp.identity(n=3, dtype=float)
        carried, kept = way_in(
            vehicle, pos, vel, swing_vel, held, thrusts, drags, rotation, wp.vec3(), ang_vel_0, lin_vel_0, ang_vel,
            lin_vel, wp.vec3(), wp.vec3(), dt, kept,
        )  # fmt: skip
        carried = base_rotors(vehicle, held, thrusts, drags, rotation, wp.vec3(), ang_vel_0, lin_vel_0, carried)
        return carried, kept

    @wp.func
    def sweep_outward(kept: back_type, turn: wp.vec3, push: wp.vec3) -> vector:
        return way_back(kept, turn, push, vector())

    return sweep_inward, sweep_outward


def _function_of_joints(
    articulation: Articulation, link: int, functions: dict[int, wp.Function], leaf: wp.Function, way_in: bool
) -> wp.Function:
    """Return the functions of all joints on a link as one, or ``nothing`` without joints, which avoids additions of zero."""
    carried = [functions[k] for k in articulation.tree.children(link)]
    return reduce(_join_inward if way_in else _join_outward, carried) if carried else leaf


def _make_leaf(types: RotorTypes, joints: JointTypes) -> tuple[wp.Function, wp.Function]:
    """Return both functions of a link without children."""
    vector, back_type, vehicle_type = joints.vector, joints.way_back, types.vehicle
    held_type = joints.held

    @wp.func
    def leaf_inward(
        vehicle: vehicle_type, pos: vector, vel: vector, swing_vel: vector, held: held_type,
        thrusts: types.vector, drags: types.vector, rotation: wp.mat33, place: wp.vec3, ang_vel_0: wp.vec3,
        lin_vel_0: wp.vec3, ang_vel: wp.vec3, lin_vel: wp.vec3, bend: wp.vec3, swing: wp.vec3, dt: float,
        kept: back_type,
    ):  # fmt: skip
        return Inertia(), kept

    @wp.func
    def leaf_outward(kept: back_type, turn: wp.vec3, push: wp.vec3, joint_acc: vector) -> vector:
        return joint_acc

    return leaf_inward, leaf_outward


def _join_inward(rest: wp.Function, one: wp.Function) -> wp.Function:
    @wp.func
    def join_inward(
        vehicle: Any, pos: Any, vel: Any, swing_vel: Any, held: Any,
        thrusts: Any, drags: Any, rotation: wp.mat33, place: wp.vec3, ang_vel_0: wp.vec3, lin_vel_0: wp.vec3,
        ang_vel: wp.vec3, lin_vel: wp.vec3, bend: wp.vec3, swing: wp.vec3, dt: float, kept: Any,
    ):  # fmt: skip
        first, kept_first = rest(
            vehicle, pos, vel, swing_vel, held, thrusts, drags, rotation, place, ang_vel_0, lin_vel_0, ang_vel,
            lin_vel, bend, swing, dt, kept,
        )  # fmt: skip
        second, kept_both = one(
            vehicle, pos, vel, swing_vel, held, thrusts, drags, rotation, place, ang_vel_0, lin_vel_0, ang_vel,
            lin_vel, bend, swing, dt, kept_first,
        )  # fmt: skip
        return sum_of_inertias(first, second), kept_both

    return join_inward


def _join_outward(rest: wp.Function, one: wp.Function) -> wp.Function:
    @wp.func
    def join_outward(kept: Any, turn: wp.vec3, push: wp.vec3, joint_acc: Any):
        return one(kept, turn, push, rest(kept, turn, push, joint_acc))

    return join_outward


def _make_outward(k: int, revolute: bool, joints: JointTypes, carried: wp.Function) -> wp.Function:
    """Return the outward pass through one joint and its link's children."""
    vector, back_type = joints.vector, joints.way_back

    @wp.func
    def joint_outward(kept: back_type, turn: wp.vec3, push: wp.vec3, joint_acc: vector) -> vector:
        after = joint_acc
        by_turn = wp.vec3(kept.by_turn[k, 0], kept.by_turn[k, 1], kept.by_turn[k, 2])
        by_push = wp.vec3(kept.by_push[k, 0], kept.by_push[k, 1], kept.by_push[k, 2])
        lever = wp.vec3(kept.lever[k, 0], kept.lever[k, 1], kept.lever[k, 2])
        acc = kept.free[k] - wp.dot(by_turn, turn) - wp.dot(by_push, push)
        after[k] = acc
        axis = wp.vec3(kept.axis[k, 0], kept.axis[k, 1], kept.axis[k, 2])
        own_turn = turn
        own_push = push + wp.cross(turn, lever)
        if wp.static(revolute):
            own_turn = own_turn + acc * axis
        else:
            own_push = own_push + acc * axis
        return carried(kept, own_turn, own_push, after)

    return joint_outward


def _make_link(
    articulation: Articulation, k: int, types: RotorTypes, joints: JointTypes, air: Mapping[int, wp.Function],
    hubs: Mapping[int, wp.Function], passive_effort: wp.Function, centered: bool,
) -> Any:  # fmt: skip
    """Return a function that makes the inward pass of joint k from that of its link's children."""
    vector, back_type, vehicle_type = joints.vector, joints.way_back, types.vehicle
    held_type = joints.held
    joint, reference = articulation.tree.joints[k], float(articulation.reference[k])
    revolute, own_axis, offset = joint.kind == "revolute", wp.vec3(*joint.axis), wp.vec3(*joint.position)
    if not revolute:
        offset = offset + reference * own_axis
    com = wp.vec3(*(articulation.link_com[k] - articulation.origins[k + 1]).tolist())  # from the origin of the link
    in_air = air.get(k + 1)
    damped, felt = in_air is not None, any(articulation.tree.joint_moves_link[link][k] for link in (*air, *hubs))
    mass = float(articulation.link_mass[k])
    inertia = wp.mat33(*articulation.link_inertia[k].flatten().tolist())
    has_mass, has_inertia = mass > 0.0, bool(articulation.link_inertia[k].any())
    carries = bool(articulation.tree.children(k + 1))
    rotors = make_rotor_inertia(articulation, k + 1, types, joints, hubs.get(k + 1))
    bounded = k in articulation.driven or float(articulation.friction[0, k]) > 0.0

    def wrap_children(carried: wp.Function) -> wp.Function:
        @wp.func
        def link_inward(
            vehicle: vehicle_type, pos: vector, vel: vector, swing_vel: vector, held: held_type,
            thrusts: types.vector, drags: types.vector, rotation: wp.mat33, place: wp.vec3, ang_vel_0: wp.vec3,
            lin_vel_0: wp.vec3, ang_vel: wp.vec3, lin_vel: wp.vec3, bend: wp.vec3, swing: wp.vec3, dt: float,
        kept: back_type,
        ):  # fmt: skip
            after = kept
            q = pos[k]
            rate = swing_vel[k]
            axis = rotation * own_axis
            lever = rotation * offset
            turned = rotation
            if wp.static(revolute):
                turned = rotation * wp.quat_to_matrix(wp.quat_from_axis_angle(own_axis, q - wp.static(reference)))
            else:
                lever = lever + axis * (q - wp.static(reference))
            turn = ang_vel
            move = lin_vel + wp.cross(ang_vel, lever)
            bent = bend
            swung = swing + wp.cross(bend, lever)
            if wp.static(revolute):
                turn = ang_vel + rate * axis
                bent = bent + rate * wp.cross(ang_vel, axis)
                swung = swung + rate * wp.cross(move, axis)
            else:
                move = move + rate * axis
                swung = swung + rate * wp.cross(ang_vel, axis)
            turn_0 = turn
            move_0 = move
            if wp.static(felt and centered):  # effects of the air use the start of the step
                turn_0 = ang_vel_0
                move_0 = lin_vel_0 + wp.cross(ang_vel_0, lever)
                if wp.static(revolute):
                    turn_0 = turn_0 + vel[k] * axis
                else:
                    move_0 = move_0 + vel[k] * axis
            origin = place + lever
            whole, after = carried(
                vehicle, pos, vel, swing_vel, held, thrusts, drags, turned, origin, turn_0, move_0, turn, move,
                bent, swung, dt, after,
            )  # fmt: skip
            if wp.static(has_mass):
                about = wp.mat33()
                if wp.static(has_inertia):
                    about = turned * inertia * wp.transpose(turned)
                own = rigid_inertia(wp.static(mass), turned * com, about, turn, move)
                own = add_acceleration(own, wp.static(mass), turned * com, bent, swung)
                if wp.static(carries):
                    own = sum_of_inertias(whole, own)
                whole = own
            whole = rotors(vehicle, held, thrusts, drags, turned, origin, turn_0, move_0, whole)
            if wp.static(damped):
                whole = in_air(whole, turned, turned * com, turn_0, move_0, turn, move, bent, swung, held, dt)
            effort, stiff = passive_effort(pos, vel, held.crept, dt)
            if wp.static(bounded):
                effort += held.effort[k] - held.slope[k] * vel[k]
                stiff += dt * held.slope[k]
            if wp.static(revolute):
                by_turn = whole.turn * axis
                by_push = wp.transpose(whole.mixed) * axis
                inverse = 1.0 / (wp.dot(axis, by_turn) + stiff)
                left = effort - wp.dot(axis, whole.torque)
            else:
                by_turn = whole.mixed * axis
                by_push = whole.push * axis
                inverse = 1.0 / (wp.dot(axis, by_push) + stiff)
                left = effort - wp.dot(axis, whole.force)
            free = inverse * left
            beyond = Inertia()
            beyond.turn = whole.turn - inverse * wp.outer(by_turn, by_turn)
            beyond.mixed = whole.mixed - inverse * wp.outer(by_turn, by_push)
            beyond.push = whole.push - inverse * wp.outer(by_push, by_push)
            beyond.torque = whole.torque + free * by_turn
            beyond.force = whole.force + free * by_push
            after.free[k] = free
            by_turn += wp.cross(lever, by_push)  # about the origin of the parent
            for i in range(3):
                after.by_turn[k, i] = inverse * by_turn[i]
                after.by_push[k, i] = inverse * by_push[i]
                after.axis[k, i] = axis[i]
                after.lever[k, i] = lever[i]
            return shift_inertia(beyond, lever), after

        return link_inward

    return wrap_children


def make_rotor_inertia(
    articulation: Articulation, link: int, types: RotorTypes, joints: JointTypes, hubs: wp.Function | None
) -> wp.Function:
    """Return the function that adds the rotors of a link to its inertia.

    Arguments: vehicle; constants of the step; thrusts; drag torques; rotation; position of its origin; its angular velocity and
    velocity at the start of the step; inertia. ``hubs`` is the function of effects at hubs (``hubs.make_hub_effects``).
    """
    vector, vehicle_type, held_type = types.vector, types.vehicle, joints.held
    start, blown = wp.vec3(*articulation.origins[link].tolist()), hubs is not None

    @wp.func
    def none(vehicle: vehicle_type, thrusts: vector, drags: vector, rotation: wp.mat33, of: Inertia) -> Inertia:
        return of

    def with_rotor(rest: wp.Function, i: int) -> wp.Function:
        @wp.func
        def rotor(vehicle: vehicle_type, thrusts: vector, drags: vector, rotation: wp.mat33, of: Inertia) -> Inertia:
            more = rest(vehicle, thrusts, drags, rotation, of)
            lever = wp.vec3(vehicle.rotor_lever[i, 0], vehicle.rotor_lever[i, 1], vehicle.rotor_lever[i, 2])
            hub = rotation * (lever + vehicle.com - start)
            axis = wp.vec3(vehicle.rotor_axis[i, 0], vehicle.rotor_axis[i, 1], vehicle.rotor_axis[i, 2])
            reaction = wp.vec3(vehicle.rotor_reaction[i, 0], vehicle.rotor_reaction[i, 1], vehicle.rotor_reaction[i, 2])
            force = thrusts[i] * (rotation * axis)
            more.torque -= wp.cross(hub, force) + drags[i] * (rotation * reaction)
            more.force -= force
            return more

        return rotor

    total = none
    for number in articulation.link_rotors(link):
        total = with_rotor(total, number)

    @wp.func
    def rotors(
        vehicle: vehicle_type, held: held_type, thrusts: vector, drags: vector, rotation: wp.mat33, place: wp.vec3,
        ang_vel: wp.vec3, lin_vel: wp.vec3, of: Inertia,
    ) -> Inertia:  # fmt: skip
        whole = of
        own = thrusts
        if wp.static(blown):
            own, more = hubs(vehicle, held, thrusts, rotation, place, ang_vel, lin_vel)
            whole.torque -= rotation * wp.spatial_bottom(more)
            whole.force -= rotation * wp.spatial_top(more)
        return total(vehicle, own, drags, rotation, whole)

    return rotors
