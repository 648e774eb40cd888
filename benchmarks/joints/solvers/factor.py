"""Accelerations of a tree for one environment by its mass matrix and a factor of it, unrolled for its topology.

It has the functions of ``aerial_gym.physics.articulated.fused.recursion``: ``make_factor`` may stand where ``make_recursion``
does. Axes are those of the base, and what is of a link is about its own origin, as there. From the leaves up a link gathers
mass, first moment and inertia of all that it carries. A joint's column of the mass matrix is the torque and force that moving
it takes; taken down to the base, it gives an entry at each joint on its way. Joints of which none is above the other have none.
The matrix is factored from the leaves up as L^T D L, which fills in nothing in a tree, until the block of the base is left.
Letters: D joints, R rotors, C joints with a drive.

Source: Featherstone (2008), Rigid Body Dynamics Algorithms, sections 6.2 (composite rigid bodies) and 6.5 (L^T D L).
"""

from collections.abc import Mapping
from functools import reduce
from typing import Any

import warp as wp

from aerial_gym.errors import CapabilityError
from aerial_gym.physics.articulated.articulation import Articulation
from aerial_gym.physics.articulated.fused.efforts import make_effort
from aerial_gym.physics.articulated.fused.inertia import Inertia
from aerial_gym.physics.articulated.fused.recursion import JointTypes, make_rotors
from aerial_gym.physics.fused.types import RotorTypes, vector_of
from benchmarks.joints.solvers.composite import Composite, shifted, together, turned_by
from benchmarks.joints.solvers.rows import above, depths_of, factor_types, make_columns, make_elimination


def make_factor(
    articulation: Articulation,
    types: RotorTypes,
    joints: JointTypes,
    air: Mapping[int, wp.Function],
    hubs: Mapping[int, wp.Function],
) -> tuple[wp.Function, wp.Function]:
    """Return the ways in and back, as ``make_recursion`` does; what is kept between them is the factor.

    Raises:
        CapabilityError: If the air damps links: what it adds is not the inertia of a rigid body; or acts at hubs, for which a
            link would have to know its place.
    """
    if air or hubs:
        raise CapabilityError("benchmarks: the factor of the mass matrix knows no effects on links or at hubs")
    factor, vector, vehicle_type = factor_types(articulation), joints.vector, types.vehicle
    held_type = joints.held
    path_type = vector_of(max(depths_of(articulation)) + 1)
    masses = _carried_masses(articulation)
    into: dict[int, wp.Function] = {}
    out: dict[int, wp.Function] = {}
    nothing_in, nothing_back = _make_nothing(types, joints, factor, path_type)

    def carried_by(link: int) -> tuple[wp.Function, wp.Function]:
        joints_on = articulation.tree.children(link)
        if not joints_on:
            return nothing_in, nothing_back
        return reduce(_beside_in, [into[k] for k in joints_on]), reduce(_beside_back, [out[k] for k in joints_on])

    for k in reversed(range(articulation.num_joints)):  # links that are carried come later
        carried, after = carried_by(k + 1)
        into[k] = _make_link(articulation, k, types, joints, factor, masses[k], carried)
        out[k] = _make_back(k, depths_of(articulation)[k], after)
    way_in, way_back = carried_by(0)
    eliminate, base_rotors = make_elimination(articulation, factor), make_rotors(articulation, 0, types, joints, None)
    total = sum(masses[child] for child in articulation.tree.children(0))

    @wp.func
    def all_in(
        vehicle: vehicle_type, pos: vector, vel: vector, swing_vel: vector, held: held_type,
        thrusts: types.vector, drags: types.vector, ang_vel_0: wp.vec3, ang_vel: wp.vec3, lin_vel: wp.vec3, dt: float,
    ):  # fmt: skip
        rotation = wp.identity(n=3, dtype=float)
        whole, kept = way_in(
            vehicle, pos, vel, swing_vel, held, thrusts, drags, rotation, ang_vel, lin_vel, wp.vec3(), wp.vec3(),
            dt, factor(),
        )  # fmt: skip
        carried = Inertia()
        d = whole.diagonal
        b = whole.beside
        carried.turn = wp.mat33(d[0], b[2], b[1], b[2], d[1], b[0], b[1], b[0], d[2])
        carried.mixed = wp.skew(whole.moment)
        carried.push = wp.static(total) * wp.identity(n=3, dtype=float)
        carried.torque = whole.torque
        carried.force = whole.force
        left, eliminated = eliminate(carried, kept)
        none = wp.vec3()
        return base_rotors(vehicle, held, thrusts, drags, rotation, none, none, none, left), eliminated

    @wp.func
    def all_back(kept: factor, turn: wp.vec3, push: wp.vec3) -> vector:
        return way_back(kept, turn, push, path_type(), vector())

    return all_in, all_back


def _carried_masses(articulation: Articulation) -> list[float]:
    """Return the mass that each joint carries [kg]."""
    masses, moves = articulation.link_mass.tolist(), articulation.tree.moves[1:]
    return [sum(mass for mass, row in zip(masses, moves, strict=True) if row[k]) for k in range(len(masses))]


def _make_nothing(
    types: RotorTypes, joints: JointTypes, factor: Any, path_type: Any
) -> tuple[wp.Function, wp.Function]:
    """Return the functions of a link that carries nothing."""
    vector, vehicle_type, held_type = joints.vector, types.vehicle, joints.held

    @wp.func
    def nothing_in(
        vehicle: vehicle_type, pos: vector, vel: vector, swing_vel: vector, held: held_type,
        thrusts: types.vector, drags: types.vector, rotation: wp.mat33, ang_vel: wp.vec3, lin_vel: wp.vec3,
        bend: wp.vec3, swing: wp.vec3, dt: float, kept: factor,
    ):  # fmt: skip
        return Composite(), kept

    @wp.func
    def nothing_back(kept: factor, turn: wp.vec3, push: wp.vec3, path: path_type, found: vector) -> vector:
        return found

    return nothing_in, nothing_back


def _beside_in(rest: wp.Function, one: wp.Function) -> wp.Function:
    @wp.func
    def both_in(
        vehicle: Any, pos: Any, vel: Any, swing_vel: Any, held: Any, thrusts: Any, drags: Any,
        rotation: wp.mat33, ang_vel: wp.vec3, lin_vel: wp.vec3, bend: wp.vec3, swing: wp.vec3, dt: float, kept: Any,
    ):  # fmt: skip
        first, kept_first = rest(
            vehicle,
            pos,
            vel,
            swing_vel,
            held,
            thrusts,
            drags,
            rotation,
            ang_vel,
            lin_vel,
            bend,
            swing,
            dt,
            kept,
        )
        second, kept_both = one(
            vehicle, pos, vel, swing_vel, held, thrusts, drags, rotation, ang_vel, lin_vel, bend, swing, dt,
            kept_first,
        )  # fmt: skip
        return together(first, second), kept_both

    return both_in


def _beside_back(rest: wp.Function, one: wp.Function) -> wp.Function:
    @wp.func
    def both_back(kept: Any, turn: wp.vec3, push: wp.vec3, path: Any, found: Any):
        return one(kept, turn, push, path, rest(kept, turn, push, path, found))

    return both_back


def _make_back(k: int, depth: int, carried: wp.Function) -> wp.Function:
    """Return the way back through one joint, and on through what its link carries; ``path`` are accelerations above it."""

    @wp.func
    def joint_back(kept: Any, turn: wp.vec3, push: wp.vec3, path: Any, found: Any):
        after = found
        on = path
        by_turn = wp.vec3(kept.by_turn[k, 0], kept.by_turn[k, 1], kept.by_turn[k, 2])
        by_push = wp.vec3(kept.by_push[k, 0], kept.by_push[k, 1], kept.by_push[k, 2])
        left = kept.left[k] - wp.dot(by_turn, turn) - wp.dot(by_push, push)
        for n in range(wp.static(depth)):
            left -= kept.mass[k, n] * path[n]
        acc = kept.inverse[k] * left
        after[k] = acc
        on[depth] = acc
        return carried(kept, turn, push, on, after)

    return joint_back


def _make_link(
    articulation: Articulation, k: int, types: RotorTypes, joints: JointTypes, factor: Any, carried_mass: float,
    carried: wp.Function,
) -> wp.Function:  # fmt: skip
    """Return the way in through joint k and what its link carries."""
    vector, vehicle_type = joints.vector, types.vehicle
    held_type = joints.held
    joint, reference = articulation.tree.joints[k], float(articulation.reference[k])
    revolute, own_axis, offset = joint.kind == "revolute", wp.vec3(*joint.axis), wp.vec3(*joint.position)
    if not revolute:
        offset = offset + reference * own_axis
    com = wp.vec3(*(articulation.link_com[k] - articulation.origins[k + 1]).tolist())  # from the origin of the link
    mass, inertia = float(articulation.link_mass[k]), wp.mat33(*articulation.link_inertia[k].flatten().tolist())
    has_mass, has_inertia = mass > 0.0, bool(articulation.link_inertia[k].any())
    effort, rotors = make_effort(articulation, k, held_type), make_rotors(articulation, k + 1, types, joints, None)
    columns, depth = make_columns(articulation, k, factor), len(above(articulation, k))
    has_rotors, carries = k + 1 in articulation.rotor_links, bool(articulation.tree.children(k + 1))

    @wp.func
    def link_in(
        vehicle: vehicle_type, pos: vector, vel: vector, swing_vel: vector, held: held_type,
        thrusts: types.vector, drags: types.vector, rotation: wp.mat33, ang_vel: wp.vec3, lin_vel: wp.vec3,
        bend: wp.vec3, swing: wp.vec3, dt: float, kept: factor,
    ):  # fmt: skip
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
            bent = bend + rate * wp.cross(ang_vel, axis)
            swung = swung + rate * wp.cross(move, axis)
        else:
            move = move + rate * axis
            swung = swung + rate * wp.cross(ang_vel, axis)
        whole, after = carried(
            vehicle, pos, vel, swing_vel, held, thrusts, drags, turned, turn, move, bent, swung, dt, kept
        )
        if wp.static(has_mass):
            own = Composite()  # about its centre of mass
            lump = turned * com
            if wp.static(has_inertia):
                about = turned * inertia * wp.transpose(turned)
                own.diagonal = wp.vec3(about[0, 0], about[1, 1], about[2, 2])
                own.beside = wp.vec3(about[1, 2], about[0, 2], about[0, 1])
                own.torque = turned_by(own, bent) + wp.cross(turn, turned_by(own, turn))
            own.force = wp.static(mass) * (swung + wp.cross(bent, lump) + wp.cross(turn, move + wp.cross(turn, lump)))
            own = shifted(own, wp.static(mass), lump)
            if wp.static(carries):
                own = together(whole, own)
            whole = own
        if wp.static(has_rotors):
            none = wp.vec3()
            acting = rotors(vehicle, held, thrusts, drags, turned, none, none, none, Inertia())
            whole.force += acting.force
            whole.torque += acting.torque
        acts, stiff = effort(q, vel[k], held, dt)
        if wp.static(revolute):
            by_turn = turned_by(whole, axis)
            by_push = wp.cross(axis, whole.moment)
            after.mass[k, depth] = wp.dot(axis, by_turn) + stiff
            after.left[k] = acts - wp.dot(axis, whole.torque)
        else:
            by_turn = wp.cross(whole.moment, axis)
            by_push = wp.static(carried_mass) * axis
            after.mass[k, depth] = wp.static(carried_mass) + stiff
            after.left[k] = acts - wp.dot(axis, whole.force)
        by_turn += wp.cross(lever, by_push)
        for i in range(3):
            after.by_turn[k, i] = by_turn[i]
            after.by_push[k, i] = by_push[i]
        return shifted(whole, wp.static(carried_mass), lever), columns(after, axis, lever)

    return link_in
