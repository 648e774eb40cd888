"""What the air does to links at the start of a step, for one environment: ``articulated.link_damping`` in Warp.

Links are walked once from the base outwards; those that nothing damps, and that carry none that is damped, cost nothing.
Letters: L links.
"""

import warp as wp

from aerial_gym.physics.articulated.articulation import Articulation
from aerial_gym.physics.articulated.fused.recursion import JointTypes, com_of, shape_of
from aerial_gym.physics.effects import LinkEffect
from aerial_gym.physics.fused.packing import pickers, values_type
from aerial_gym.physics.fused.types import RotorTypes
from aerial_gym.physics.model import Model


def damped_links(model: Model) -> tuple[int, ...]:
    """Return the numbers of the links that the air damps; one that stands still, or has no mass, is none."""
    articulation = model.articulation
    assert articulation is not None
    able = [articulation.tree.floating, *(articulation.link_mass > 0.0).tolist()]
    return tuple(
        link
        for effect, _ in model.effects[LinkEffect]
        for link, moves in enumerate(able)
        if moves and effect.warp_damping(link) is not None
    )


def make_link_damping(model: Model, types: RotorTypes, joints: JointTypes, base: wp.Function) -> wp.Function:
    """Return a function to what damps each link: (vehicle, values of all effects, position of joints, their rate, angular
    velocity and velocity of the base, wind, acceleration that weight takes, dt) -> ``Held.air``.

    Vectors are in axes of the base. A row is of a damped link, in its axes: force [N] at the centre of mass and torque [N m]
    where the link accelerates as its weight is held, and D along and about each axis.

    Args:
        model: With the effect on its links.
        types: For its rotors.
        joints: For its joints.
        base: As the kernel has it, (vehicle, angular velocity, velocity) -> ``Inertia``.
    """
    articulation = model.articulation
    assert articulation is not None
    air_type, vector, vehicle_type, params_type = joints.air, joints.vector, types.vehicle, values_type(model)
    walk = _beyond(model, articulation, joints, 0)
    base_row, any_base = _make_row(model, joints, 0), 0 in joints.damped

    @wp.func
    def link_damping(
        vehicle: vehicle_type, params: params_type, pos: vector, vel: vector, ang_vel: wp.vec3, lin_vel: wp.vec3,
        wind: wp.vec3, weight: wp.vec3, dt: float,
    ):  # fmt: skip
        found = air_type()
        rotation = wp.identity(n=3, dtype=float)
        if wp.static(any_base):
            com = com_of(base(vehicle, ang_vel, lin_vel))
            found = base_row(params, rotation, com, ang_vel, lin_vel, wind, weight, dt, found)
        return walk(params, pos, vel, rotation, ang_vel, lin_vel, wind, weight, dt, found)

    return link_damping


def _beyond(model: Model, articulation: Articulation, joints: JointTypes, link: int) -> wp.Function:
    """Return the walk through all links that hang on one."""
    air_type, vector, params_type = joints.air, joints.vector, values_type(model)

    @wp.func
    def nothing(
        params: params_type, pos: vector, vel: vector, rotation: wp.mat33, ang_vel: wp.vec3, lin_vel: wp.vec3,
        wind: wp.vec3, weight: wp.vec3, dt: float, found: air_type,
    ):  # fmt: skip
        return found

    def beside(rest: wp.Function, one: wp.Function) -> wp.Function:
        @wp.func
        def both(
            params: params_type, pos: vector, vel: vector, rotation: wp.mat33, ang_vel: wp.vec3, lin_vel: wp.vec3,
            wind: wp.vec3, weight: wp.vec3, dt: float, found: air_type,
        ):  # fmt: skip
            first = rest(params, pos, vel, rotation, ang_vel, lin_vel, wind, weight, dt, found)
            return one(params, pos, vel, rotation, ang_vel, lin_vel, wind, weight, dt, first)

        return both

    total, tree = nothing, articulation.tree
    for k, joint in enumerate(tree.joints):
        if joint.parent == link and any(tree.moves[other][k] for other in joints.damped):
            total = beside(total, _make_link(model, articulation, joints, k))
    return total


def _make_link(model: Model, articulation: Articulation, joints: JointTypes, k: int) -> wp.Function:
    """Return the walk through joint k, its link and what hangs on it; where a link is and moves is as in ``recursion``."""
    air_type, vector, params_type, shape = joints.air, joints.vector, values_type(model), shape_of(articulation, k)
    revolute, own_axis, offset, reference, com = shape.revolute, shape.axis, shape.offset, shape.reference, shape.com
    row, acts, beyond = (
        _make_row(model, joints, k + 1),
        k + 1 in joints.damped,
        _beyond(model, articulation, joints, k + 1),
    )

    @wp.func
    def link(
        params: params_type, pos: vector, vel: vector, rotation: wp.mat33, ang_vel: wp.vec3, lin_vel: wp.vec3,
        wind: wp.vec3, weight: wp.vec3, dt: float, found: air_type,
    ):  # fmt: skip
        after = found
        axis = rotation * own_axis
        lever = rotation * offset
        turned = rotation
        if wp.static(revolute):
            turned = rotation * wp.quat_to_matrix(wp.quat_from_axis_angle(own_axis, pos[k] - wp.static(reference)))
        else:
            lever = lever + axis * (pos[k] - wp.static(reference))
        turn = ang_vel
        move = lin_vel + wp.cross(ang_vel, lever)
        if wp.static(revolute):
            turn = ang_vel + vel[k] * axis
        else:
            move = move + vel[k] * axis
        if wp.static(acts):
            after = row(params, turned, turned * com, turn, move, wind, weight, dt, after)
        return beyond(params, pos, vel, turned, turn, move, wind, weight, dt, after)

    return link


def _make_row(model: Model, joints: JointTypes, link: int) -> wp.Function | None:
    """Return what writes the row of a link; None where nothing damps it.

    The end of a step has ``-D (u + u' dt)`` with ``u' = R^T (a - weight + w x wind)``, where ``a`` is the spatial acceleration
    of the centre of mass that the recursion finds, weight in it: what is not of ``a`` stands in the row.
    """
    if link not in joints.damped:
        return None
    ((effect, _),) = model.effects[LinkEffect]
    (pick,) = pickers(model)[LinkEffect]
    twin, get, params_type, air_type = effect.warp_damping(link), pick.get, values_type(model), joints.air
    place = joints.damped.index(link)

    @wp.func
    def row(
        params: params_type, rotation: wp.mat33, com: wp.vec3, ang_vel: wp.vec3, lin_vel: wp.vec3,
        wind: wp.vec3, weight: wp.vec3, dt: float, found: air_type,
    ):  # fmt: skip
        after = found
        back = wp.transpose(rotation)
        through = back * (lin_vel + wp.cross(ang_vel, com) - wind)
        turn = back * ang_vel
        damping = twin(wp.spatial_vector(through, turn), get(params))
        along = wp.spatial_top(damping)
        about = wp.spatial_bottom(damping)
        force = wp.cw_mul(along, dt * (back * (weight - wp.cross(ang_vel, wind))) - through)
        for i in range(3):
            after[place, i] = force[i]
            after[place, 3 + i] = -about[i] * turn[i]
            after[place, 6 + i] = along[i]
            after[place, 9 + i] = about[i]
        return after

    return row
