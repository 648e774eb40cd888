"""Effects on one link in Warp, traced from their formulas; the recursion calls them at each link.

Letters: E environments, L links.
"""

from typing import Any

import torch
import warp as wp
from torch import Tensor

from aerial_gym.math.warp_functions import rotate, world_up
from aerial_gym.physics.articulated.fused.inertia import Inertia, add_inertia
from aerial_gym.physics.articulated.fused.recursion import JointTypes
from aerial_gym.physics.articulated.link_loads import damping_at_end, fluid_wrench
from aerial_gym.physics.effects import Effect, LinkEffect, LinkFluidEffect, LinkWrenchEffect
from aerial_gym.physics.fused.formulas import make_hub_loads, row_effects
from aerial_gym.physics.fused.packing import effect_values_type
from aerial_gym.physics.fused.torch_trace import trace_to_warp
from aerial_gym.physics.fused.types import rotor_types
from aerial_gym.physics.model import Model


def hub_links(model: Model) -> tuple[int, ...]:
    """Return the indices of links with effects on their rotors."""
    articulation = model.articulation
    assert articulation is not None
    any_at_hubs = any(effect.at_hubs for effect, _ in model.effects)
    return tuple(sorted(set(articulation.rotor_links))) if any_at_hubs else ()


def make_hub_effects(model: Model, joints: JointTypes) -> dict[int, wp.Function]:
    """Return the Warp function of effects at hubs for each link with rotors.

    Arguments: vehicle; constants of the step; static thrusts of all rotors; rotation from link to base; origin of the link from
    that of the base; its angular velocity and the velocity of its origin at the start of the step. Vectors are in axes of the
    base. Result: thrusts including effects on this link, and the further wrench at its origin, axes of the link.
    """
    return {link: _make_hub_effects_of_link(model, joints, link) for link in hub_links(model)}


def _make_hub_effects_of_link(model: Model, joints: JointTypes, link: int) -> wp.Function:
    articulation, types = model.articulation, rotor_types(model.vehicle.num_rotors, not model.vehicle.plain)
    assert articulation is not None
    axis = torch.tensor((0.0, 0.0, 1.0)).expand(model.vehicle.num_rotors, 3)
    constants = {"plant.rotor_axis": axis} if model.vehicle.upright else {}
    loads = make_hub_loads(model, constants, articulation.link_rotors(link), articulation.origins[link])
    vehicle_type, vector, held_type = types.vehicle, types.vector, joints.held

    @wp.func
    def link_hubs(
        vehicle: vehicle_type, held: held_type, thrusts: vector, rotation: wp.mat33, place: wp.vec3, ang_vel: wp.vec3,
        lin_vel: wp.vec3,
    ):  # fmt: skip
        return loads(
            vehicle,
            held.params,
            thrusts,
            held.position + rotate(held.attitude, place),
            held.attitude * wp.quat_from_matrix(rotation),
            rotate(held.attitude, lin_vel - held.wind),
            wp.transpose(rotation) * ang_vel,
            held.rotor_speed,
            held.rotor_acc,
        )

    return link_hubs


cross = torch.linalg.cross
KINDS = LinkEffect, LinkFluidEffect, LinkWrenchEffect  # Kinds of effects on links


def effect_links(model: Model) -> tuple[int, ...]:
    """Return the numbers of the links on which effects act, without fixed links and links without mass."""
    articulation = model.articulation
    assert articulation is not None
    able = [articulation.tree.floating, *(articulation.link_mass > 0.0).tolist()]
    return tuple(link for link, moves in enumerate(able) if moves and _kinds_on_link(model, link))


def _kinds_on_link(model: Model, link: int) -> list[type[Effect]]:
    """Return the kinds of effects that act on a link with positive parameters."""
    motion = torch.tensor([[0.3, -0.5, 0.8, 0.7, -0.2, 0.4]])

    def acts(effect: Effect) -> bool:
        numbers = _effect_numbers(effect, _num_links(model), link, motion, torch.ones(1, len(effect.parameters)))
        return bool(numbers.any())

    return [kind for kind in KINDS if any(acts(effect) for effect, _ in model.effects[kind])]


def _num_links(model: Model) -> int:
    assert model.articulation is not None
    return model.articulation.tree.num_links


def _effect_numbers(effect: Effect, num_links: int, link: int, motion: Tensor, params: Tensor) -> Tensor:
    """Return the six numbers of an effect on a link, (E, 6), for the motion (E, 6) or world z (E, 3) that its kind takes."""
    each = motion.unsqueeze(1).expand(-1, num_links, -1)
    if isinstance(effect, LinkEffect):
        return effect.damping(each, params)[:, link]
    if isinstance(effect, LinkWrenchEffect):
        return effect.wrench(each[..., :3], params)[:, link]
    assert isinstance(effect, LinkFluidEffect)
    return effect.added_mass(num_links, params)[:, link]


def make_link_formula(model: Model, link: int) -> wp.Function:
    """Return the masses and the wrench that all effects add at the centre of mass of a link, axes of the link.

    Arguments: velocity through the air and angular velocity at the start of the step; both at the rates of the velocity terms;
    their rates without acceleration in still air; wind; world z; parameters; dt.
    """

    def formula(
        start: Tensor, now: Tensor, change: Tensor, wind: Tensor, up: Tensor, values: Tensor, dt: Tensor
    ) -> tuple[Tensor, Tensor]:
        effects, mass, wrench = row_effects(model, values), torch.zeros_like(now), torch.zeros_like(now)

        def numbers(kind: type[Effect], motion: Tensor) -> list[Tensor]:
            return [_effect_numbers(effect, _num_links(model), link, motion, own) for effect, own in effects[kind]]

        def change_in_wind(velocity: Tensor) -> Tensor:
            swing, bend = change.split(3, dim=1)
            return torch.cat((swing + cross(velocity[:, 3:], wind), bend), dim=1)

        for damping in numbers(LinkEffect, start):
            more, push = damping_at_end(damping, start, change_in_wind(start), dt)
            mass, wrench = mass + more, wrench + push
        for added in numbers(LinkFluidEffect, now):
            mass, wrench = mass + added, wrench + fluid_wrench(added, now, change_in_wind(now))
        for push in numbers(LinkWrenchEffect, up):
            wrench = wrench + push
        return mass, wrench

    six = wp.spatial_vector
    arguments = {"start": six, "now": six, "change": six, "wind": wp.vec3, "up": wp.vec3}
    arguments |= {"values": effect_values_type(model), "dt": float}
    return trace_to_warp("link_formula", arguments, formula, [six, six], constants={}, shared=["dt"])


def make_link_effects(model: Model, joints: JointTypes) -> dict[int, wp.Function]:
    """Return the Warp function of all effects on each link, by number of the link. Vectors are in axes of the base.

    Arguments: inertia of the link; rotation from its axes to those of the base; its centre of mass from its origin; angular
    velocity and velocity of its origin at the start of the step; both at the rates of the velocity terms; angular acceleration
    and acceleration of its origin by these terms alone; quantities constant over the step; dt. Result: the new ``Inertia``.
    """
    return {link: _make_effects_on_link(model, joints, link) for link in effect_links(model)}


def _make_effects_on_link(model: Model, joints: JointTypes, link: int) -> Any:
    """Return the function of one link.

    The recursion's accelerations are spatial and contain the weight: ``a - w x v`` is their value at the centre without it.
    """
    formula, held_type = make_link_formula(model, link), joints.held
    adds_mass = set(_kinds_on_link(model, link)) != {LinkWrenchEffect}

    @wp.func
    def on_link(
        own: Inertia, rotation: wp.mat33, com: wp.vec3, ang_vel_0: wp.vec3, lin_vel_0: wp.vec3, ang_vel: wp.vec3,
        lin_vel: wp.vec3, bend: wp.vec3, swing: wp.vec3, held: held_type, dt: float,
    ) -> Inertia:  # fmt: skip
        back = wp.transpose(rotation)
        wind = back * held.wind
        start = wp.spatial_vector(back * (lin_vel_0 + wp.cross(ang_vel_0, com)) - wind, back * ang_vel_0)
        now = wp.spatial_vector(back * (lin_vel + wp.cross(ang_vel, com)) - wind, back * ang_vel)
        change = wp.spatial_vector(back * (swing + wp.cross(bend, com) - held.weight), back * bend)
        mass, wrench = formula(start, now, change, wind, back * world_up(held.attitude), held.params, dt)
        force = rotation * wp.spatial_top(wrench)
        torque = rotation * wp.spatial_bottom(wrench)
        after = own
        if wp.static(adds_mass):
            push = rotation * wp.diag(wp.spatial_top(mass)) * back
            after = add_inertia(own, push, rotation * wp.diag(wp.spatial_bottom(mass)) * back, com)
        after.force -= force
        after.torque -= torque + wp.cross(com, force)
        return after

    return on_link
