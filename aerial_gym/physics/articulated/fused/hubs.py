"""Effects at hubs on the links of rotors: the Warp version of ``articulated.flight``.

These effects treat a link with its rotors as a separate vehicle with its centre of mass at the link's origin. They use its
pose and motion at the start of the step, link axes, and the wind at the vehicle's centre of mass. The recursion calls the
function at each link.
Letters: R rotors, S rotors of a link.
"""

import torch
import warp as wp

from aerial_gym.math.warp_functions import rotate
from aerial_gym.physics.articulated.fused.recursion import JointTypes
from aerial_gym.physics.fused.formulas import make_hub_loads
from aerial_gym.physics.fused.types import rotor_types
from aerial_gym.physics.model import Model


def hub_links(model: Model) -> tuple[int, ...]:
    """Return the indices of links with effects on their rotors."""
    articulation = model.articulation
    assert articulation is not None
    any_at_hubs = any(effect.at_hubs for effect, _ in model.effects)
    return tuple(sorted(set(articulation.rotor_links))) if any_at_hubs else ()


def make_hubs(model: Model, joints: JointTypes) -> dict[int, wp.Function]:
    """Return the Warp function of effects at hubs for each link with rotors.

    Arguments: vehicle; constants of the step; static thrusts of all rotors; rotation from link to base; origin of the link from
    that of the base; its angular velocity and the velocity of its origin at the start of the step. Vectors are in axes of the
    base. Result: thrusts including effects on this link, and the further wrench at its origin, axes of the link.
    """
    return {link: _make_link_hubs(model, joints, link) for link in hub_links(model)}


def _make_link_hubs(model: Model, joints: JointTypes, link: int) -> wp.Function:
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
