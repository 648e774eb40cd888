"""Damping, fluid and wrenches of effects on one link in Warp; the recursion calls them at each link.

Damping is ``articulated.link_damping``, fluid is ``articulated.link_fluid``.
"""

from functools import reduce
from typing import Any

import warp as wp

from aerial_gym.math.warp_functions import world_up
from aerial_gym.physics.articulated.fused.inertia import Inertia, add_resistance
from aerial_gym.physics.articulated.fused.recursion import JointTypes
from aerial_gym.physics.effects import Effect, LinkEffect, LinkFluidEffect, LinkWrenchEffect
from aerial_gym.physics.fused.formulas import LINK_KINDS, acts_on_link, make_link_formula
from aerial_gym.physics.model import Model


def effect_links(model: Model) -> tuple[int, ...]:
    """Return the numbers of the links on which effects act, without fixed links and links without mass."""
    articulation = model.articulation
    assert articulation is not None
    able = [articulation.tree.floating, *(articulation.link_mass > 0.0).tolist()]
    return tuple(link for link, moves in enumerate(able) if moves and any(_kinds_on_link(model, link)))


def _kinds_on_link(model: Model, link: int) -> list[type[Effect]]:
    """Return the kinds of effects that act on a link."""
    return [kind for kind in LINK_KINDS if any(acts_on_link(effect, model, link) for effect, _ in model.effects[kind])]


def make_on_links(model: Model, joints: JointTypes) -> dict[int, wp.Function]:
    """Return the Warp function of all effects on each link, by number of the link. Vectors are in axes of the base.

    Arguments: inertia of the link; rotation from its axes to those of the base; its centre of mass from its origin; angular
    velocity and velocity of its origin at the start of the step; both at the rates of the turning terms; angular acceleration
    and acceleration of its origin by these terms alone; quantities constant over the step; dt. Result: the new ``Inertia``.
    """
    return {link: reduce(_chain, _link_functions(model, joints, link)) for link in effect_links(model)}


def _link_functions(model: Model, joints: JointTypes, link: int) -> list[wp.Function]:
    functions = (make(model, joints, link) for make in (make_damping, make_fluid, make_wrench))
    return [each for each in functions if each is not None]


def _chain(first: wp.Function, second: wp.Function) -> wp.Function:
    @wp.func
    def both(
        own: Inertia, rotation: wp.mat33, com: wp.vec3, ang_vel_0: wp.vec3, lin_vel_0: wp.vec3, ang_vel: wp.vec3,
        lin_vel: wp.vec3, bend: wp.vec3, swing: wp.vec3, held: Any, dt: float,
    ):  # fmt: skip
        after = first(own, rotation, com, ang_vel_0, lin_vel_0, ang_vel, lin_vel, bend, swing, held, dt)
        return second(after, rotation, com, ang_vel_0, lin_vel_0, ang_vel, lin_vel, bend, swing, held, dt)

    return both


def make_damping(model: Model, joints: JointTypes, link: int) -> wp.Function | None:
    """Return the damping of a link, a function as in ``make_on_links``, or None without one.

    The damping force at the end of a step is ``-D (u + u' dt)`` with ``u' = R^T (a - weight + w x wind)``. Here ``a`` is the
    spatial acceleration of the centre of mass from the recursion, weight included. The term in ``a`` adds ``dt D`` to the
    mass; the rest is a force.
    """
    if LinkEffect not in _kinds_on_link(model, link):
        return None
    damping_of, held_type = make_link_formula(model, LinkEffect, link), joints.held

    @wp.func
    def link_damping(
        own: Inertia, rotation: wp.mat33, com: wp.vec3, ang_vel_0: wp.vec3, lin_vel_0: wp.vec3, ang_vel: wp.vec3,
        lin_vel: wp.vec3, bend: wp.vec3, swing: wp.vec3, held: held_type, dt: float,
    ) -> Inertia:  # fmt: skip
        back = wp.transpose(rotation)
        through = back * (lin_vel_0 + wp.cross(ang_vel_0, com) - held.wind)
        turn = back * ang_vel_0
        damping = damping_of(wp.spatial_vector(through, turn), held.params)
        along = wp.spatial_top(damping)
        about = wp.spatial_bottom(damping)
        change = held.weight - wp.cross(ang_vel_0, held.wind) - swing - wp.cross(bend, com)
        force = rotation * wp.cw_mul(along, dt * (back * change) - through)
        torque = -rotation * wp.cw_mul(about, turn + dt * (back * bend))
        push = dt * (rotation * wp.diag(along) * back)
        return add_resistance(own, push, dt * (rotation * wp.diag(about) * back), com, force, torque)

    return link_damping


def make_fluid(model: Model, joints: JointTypes, link: int) -> wp.Function | None:
    """Return the added mass of a link, a function as in ``make_on_links``, or None without one.

    ``R A R^T`` adds to the mass and ``R B R^T`` to the inertia. The fluid takes the force
    ``A (a - weight + w x wind) + w x (A u)``, with the spatial acceleration ``a`` of the centre of mass from the recursion,
    weight included. The terms without ``a`` are a force.
    """
    if LinkFluidEffect not in _kinds_on_link(model, link):
        return None
    added_of, held_type = make_link_formula(model, LinkFluidEffect, link), joints.held

    @wp.func
    def link_fluid(
        own: Inertia, rotation: wp.mat33, com: wp.vec3, ang_vel_0: wp.vec3, lin_vel_0: wp.vec3, ang_vel: wp.vec3,
        lin_vel: wp.vec3, bend: wp.vec3, swing: wp.vec3, held: held_type, dt: float,
    ) -> Inertia:  # fmt: skip
        back = wp.transpose(rotation)
        added = added_of(wp.spatial_vector(), held.params)
        along = wp.spatial_top(added)
        about = wp.spatial_bottom(added)
        through = back * (lin_vel + wp.cross(ang_vel, com) - held.wind)
        turn = back * ang_vel
        momentum = wp.cw_mul(along, through)
        change = held.weight - wp.cross(ang_vel, held.wind) - swing - wp.cross(bend, com)
        force = rotation * (wp.cw_mul(along, back * change) - wp.cross(turn, momentum))
        spin = wp.cw_mul(about, turn)
        torque = -rotation * (wp.cw_mul(about, back * bend) + wp.cross(turn, spin) + wp.cross(through, momentum))
        return add_resistance(
            own, rotation * wp.diag(along) * back, rotation * wp.diag(about) * back, com, force, torque
        )

    return link_fluid


def make_wrench(model: Model, joints: JointTypes, link: int) -> wp.Function | None:
    """Return the wrench of the effects on a link, a function as in ``make_on_links``, or None without one."""
    if LinkWrenchEffect not in _kinds_on_link(model, link):
        return None
    wrench_of, held_type = make_link_formula(model, LinkWrenchEffect, link), joints.held

    @wp.func
    def link_wrench(
        own: Inertia, rotation: wp.mat33, com: wp.vec3, ang_vel_0: wp.vec3, lin_vel_0: wp.vec3, ang_vel: wp.vec3,
        lin_vel: wp.vec3, bend: wp.vec3, swing: wp.vec3, held: held_type, dt: float,
    ) -> Inertia:  # fmt: skip
        up = wp.transpose(rotation) * world_up(held.attitude)
        wrench = wrench_of(wp.spatial_vector(up, wp.vec3()), held.params)
        force = rotation * wp.spatial_top(wrench)
        after = own
        after.force -= force
        after.torque -= rotation * wp.spatial_bottom(wrench) + wp.cross(com, force)
        return after

    return link_wrench
