"""What effects on links do to each link, for one environment; the recursion calls it where it comes by the link."""

from functools import reduce
from typing import Any

import warp as wp

from aerial_gym.physics.articulated.fused.inertia import Inertia
from aerial_gym.physics.articulated.fused.link_damping import make_damping
from aerial_gym.physics.articulated.fused.link_fluid import make_fluid
from aerial_gym.physics.articulated.fused.link_wrenches import make_wrenches
from aerial_gym.physics.articulated.fused.recursion import JointTypes
from aerial_gym.physics.effects import LinkEffect, LinkFluidEffect, LinkWrenchEffect
from aerial_gym.physics.model import Model


def touched_links(model: Model) -> tuple[int, ...]:
    """Return the numbers of the links that effects on links act on; one that stands still, or has no mass, is none."""
    articulation = model.articulation
    assert articulation is not None
    able = [articulation.tree.floating, *(articulation.link_mass > 0.0).tolist()]
    twins = [effect.warp_damping for effect, _ in model.effects[LinkEffect]]
    twins += [effect.warp_wrench for effect, _ in model.effects[LinkWrenchEffect]]
    twins += [effect.warp_added for effect, _ in model.effects[LinkFluidEffect]]
    return tuple(link for link, moves in enumerate(able) if moves and any(twin(link) is not None for twin in twins))


def make_on_links(model: Model, joints: JointTypes) -> dict[int, wp.Function]:
    """Return what effects do to each link that they act on: (inertia of the link, its axes to those of the base, its centre of
    mass from its origin, angular velocity and velocity of its origin at the start of the step, the same at the rates at which
    turning and swinging are taken, angular acceleration and acceleration of its origin by these alone, what is held through the
    step, dt) -> ``Inertia``. Vectors are in axes of the base.
    """
    return {link: reduce(_then, _acting_on(model, joints, link)) for link in touched_links(model)}


def _acting_on(model: Model, joints: JointTypes, link: int) -> list[wp.Function]:
    found = (make(model, joints, link) for make in (make_damping, make_fluid))
    return [*(each for each in found if each is not None), *make_wrenches(model, joints, link)]


def _then(first: wp.Function, second: wp.Function) -> wp.Function:
    @wp.func
    def both(
        own: Inertia, rotation: wp.mat33, com: wp.vec3, ang_vel_0: wp.vec3, lin_vel_0: wp.vec3, ang_vel: wp.vec3,
        lin_vel: wp.vec3, bend: wp.vec3, swing: wp.vec3, held: Any, dt: float,
    ):  # fmt: skip
        after = first(own, rotation, com, ang_vel_0, lin_vel_0, ang_vel, lin_vel, bend, swing, held, dt)
        return second(after, rotation, com, ang_vel_0, lin_vel_0, ang_vel, lin_vel, bend, swing, held, dt)

    return both
