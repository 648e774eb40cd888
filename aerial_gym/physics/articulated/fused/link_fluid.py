"""Fluid that a link sets in motion, for one environment: ``articulated.link_fluid`` in Warp, at the rates that turning has."""

import warp as wp

from aerial_gym.physics.articulated.fused.inertia import Inertia, beside
from aerial_gym.physics.articulated.fused.recursion import JointTypes
from aerial_gym.physics.effects import LinkFluidEffect
from aerial_gym.physics.fused.packing import pickers
from aerial_gym.physics.model import Model


def make_fluid(model: Model, joints: JointTypes, link: int) -> wp.Function | None:
    """Return what the fluid does to a link, as ``on_links.make_on_links`` has it; None where it does nothing.

    Beside the mass stand ``R A R^T`` and ``R B R^T``. With the spatial acceleration ``a`` of the centre of mass that the
    recursion finds, weight in it, the fluid takes ``A (a - weight + w x wind) + w x (A u)``: what is not of ``a`` is a force.
    """
    twins = [effect.warp_added(link) for effect, _ in model.effects[LinkFluidEffect]]
    if twins in ([], [None]):
        return None
    ((twin,), (pick,), held_type) = twins, pickers(model)[LinkFluidEffect], joints.held
    get = pick.get

    @wp.func
    def link_fluid(
        own: Inertia, rotation: wp.mat33, com: wp.vec3, ang_vel_0: wp.vec3, lin_vel_0: wp.vec3, ang_vel: wp.vec3,
        lin_vel: wp.vec3, bend: wp.vec3, swing: wp.vec3, held: held_type, dt: float,
    ) -> Inertia:  # fmt: skip
        back = wp.transpose(rotation)
        added = twin(get(held.params))
        along = wp.spatial_top(added)
        about = wp.spatial_bottom(added)
        through = back * (lin_vel + wp.cross(ang_vel, com) - held.wind)
        turn = back * ang_vel
        momentum = wp.cw_mul(along, through)
        change = held.weight - wp.cross(ang_vel, held.wind) - swing - wp.cross(bend, com)
        force = rotation * (wp.cw_mul(along, back * change) - wp.cross(turn, momentum))
        spin = wp.cw_mul(about, turn)
        torque = -rotation * (wp.cw_mul(about, back * bend) + wp.cross(turn, spin) + wp.cross(through, momentum))
        return beside(own, rotation * wp.diag(along) * back, rotation * wp.diag(about) * back, com, force, torque)

    return link_fluid
