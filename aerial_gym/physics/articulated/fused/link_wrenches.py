"""What pushes and turns a link by how it is turned, for one environment: ``LinkWrenchEffect`` in Warp."""

import warp as wp

from aerial_gym.physics.articulated.fused.inertia import Inertia
from aerial_gym.physics.articulated.fused.recursion import JointTypes
from aerial_gym.physics.effects import LinkWrenchEffect
from aerial_gym.physics.fused.functions import world_up
from aerial_gym.physics.fused.packing import pickers
from aerial_gym.physics.model import Model


def make_wrenches(model: Model, joints: JointTypes, link: int) -> list[wp.Function]:
    """Return what each such effect does to a link, as ``on_links.make_on_links`` has it."""
    each = zip(model.effects[LinkWrenchEffect], pickers(model)[LinkWrenchEffect], strict=True)
    twins = [(effect.warp_wrench(link), pick.get) for (effect, _), pick in each]
    return [_make_wrench(joints, twin, get) for twin, get in twins if twin is not None]


def _make_wrench(joints: JointTypes, twin: wp.Function, get: wp.Function) -> wp.Function:
    held_type = joints.held

    @wp.func
    def link_wrench(
        own: Inertia, rotation: wp.mat33, com: wp.vec3, ang_vel_0: wp.vec3, lin_vel_0: wp.vec3, ang_vel: wp.vec3,
        lin_vel: wp.vec3, bend: wp.vec3, swing: wp.vec3, held: held_type, dt: float,
    ) -> Inertia:  # fmt: skip
        wrench = twin(wp.transpose(rotation) * world_up(held.attitude), get(held.params))
        force = rotation * wp.spatial_top(wrench)
        after = own
        after.force -= force
        after.torque -= rotation * wp.spatial_bottom(wrench) + wp.cross(com, force)
        return after

    return link_wrench
