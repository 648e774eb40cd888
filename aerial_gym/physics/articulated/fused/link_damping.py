"""What damps a link in a step, for one environment: ``articulated.link_damping`` in Warp, of the start of the step."""

import warp as wp

from aerial_gym.physics.articulated.fused.inertia import Inertia, beside
from aerial_gym.physics.articulated.fused.recursion import JointTypes
from aerial_gym.physics.effects import LinkEffect
from aerial_gym.physics.fused.packing import pickers
from aerial_gym.physics.model import Model


def make_damping(model: Model, joints: JointTypes, link: int) -> wp.Function | None:
    """Return what damps a link, as ``on_links.make_on_links`` has it; None where nothing does.

    Beside the mass stands ``dt D``. The end of a step has ``-D (u + u' dt)`` with ``u' = R^T (a - weight + w x wind)``, where
    ``a`` is the spatial acceleration of the centre of mass that the recursion finds, weight in it: what is not of ``a`` is a
    force.
    """
    twins = [effect.warp_damping(link) for effect, _ in model.effects[LinkEffect]]
    if twins in ([], [None]):
        return None
    ((twin,), (pick,), held_type) = twins, pickers(model)[LinkEffect], joints.held
    get = pick.get

    @wp.func
    def link_damping(
        own: Inertia, rotation: wp.mat33, com: wp.vec3, ang_vel_0: wp.vec3, lin_vel_0: wp.vec3, ang_vel: wp.vec3,
        lin_vel: wp.vec3, bend: wp.vec3, swing: wp.vec3, held: held_type, dt: float,
    ) -> Inertia:  # fmt: skip
        back = wp.transpose(rotation)
        through = back * (lin_vel_0 + wp.cross(ang_vel_0, com) - held.wind)
        turn = back * ang_vel_0
        damping = twin(wp.spatial_vector(through, turn), get(held.params))
        along = wp.spatial_top(damping)
        about = wp.spatial_bottom(damping)
        change = held.weight - wp.cross(ang_vel_0, held.wind) - swing - wp.cross(bend, com)
        force = rotation * wp.cw_mul(along, dt * (back * change) - through)
        torque = -rotation * wp.cw_mul(about, turn + dt * (back * bend))
        push = dt * (rotation * wp.diag(along) * back)
        return beside(own, push, dt * (rotation * wp.diag(about) * back), com, force, torque)

    return link_damping
