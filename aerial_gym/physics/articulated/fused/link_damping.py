"""What the air does to a link in a step, for one environment: ``articulated.link_damping`` in Warp.

The recursion calls it where it comes by the link, with the motion of the link at the start of the step.
"""

import warp as wp

from aerial_gym.physics.articulated.fused.inertia import Inertia
from aerial_gym.physics.articulated.fused.recursion import JointTypes
from aerial_gym.physics.effects import LinkEffect
from aerial_gym.physics.fused.packing import pickers
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


def make_link_damping(model: Model, joints: JointTypes) -> dict[int, wp.Function]:
    """Return what the air does to each link that it damps: (inertia of the link, its axes to those of the base, its centre of
    mass from its origin, angular velocity and velocity of its origin at the start of the step, angular acceleration and
    acceleration of its origin by turning and moving alone, what is held through the step, dt) -> ``Inertia``. Vectors are in
    axes of the base.

    Beside the mass stands ``dt D``. The end of a step has ``-D (u + u' dt)`` with ``u' = R^T (a - weight + w x wind)``, where
    ``a`` is the spatial acceleration of the centre of mass that the recursion finds, weight in it: what is not of ``a`` is a
    force.

    Args:
        model: With the effect on its links.
        joints: For its joints.
    """
    return {link: _make_damping(model, joints, link) for link in damped_links(model)}


def _make_damping(model: Model, joints: JointTypes, link: int) -> wp.Function:
    ((effect, _),) = model.effects[LinkEffect]
    (pick,) = pickers(model)[LinkEffect]
    twin, get, held_type = effect.warp_damping(link), pick.get, joints.held

    @wp.func
    def link_damping(
        own: Inertia, rotation: wp.mat33, com: wp.vec3, ang_vel: wp.vec3, lin_vel: wp.vec3, bend: wp.vec3, swing: wp.vec3,
        held: held_type, dt: float,
    ):  # fmt: skip
        back = wp.transpose(rotation)
        through = back * (lin_vel + wp.cross(ang_vel, com) - held.wind)
        turn = back * ang_vel
        damping = twin(wp.spatial_vector(through, turn), get(held.params))
        along = wp.spatial_top(damping)
        about = wp.spatial_bottom(damping)
        change = held.weight - wp.cross(ang_vel, held.wind) - swing - wp.cross(bend, com)
        force = rotation * wp.cw_mul(along, dt * (back * change) - through)
        torque = -rotation * wp.cw_mul(about, turn + dt * (back * bend))
        push = dt * (rotation * wp.diag(along) * back)
        mixed = wp.skew(com) * push
        after = own
        after.push += push
        after.mixed += mixed
        after.turn += dt * (rotation * wp.diag(about) * back) - mixed * wp.skew(com)
        after.force -= force
        after.torque -= torque + wp.cross(com, force)
        return after

    return link_damping
