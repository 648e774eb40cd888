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
from aerial_gym.physics.fused.formulas import make_loads
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
    articulation, general = model.articulation, not model.vehicle.plain
    assert articulation is not None
    rotors = articulation.link_rotors(link)
    whole, part = rotor_types(model.vehicle.num_rotors, general), rotor_types(len(rotors), general)
    axis = {"plant.rotor_axis": torch.tensor((0.0, 0.0, 1.0)).expand(len(rotors), 3)} if model.vehicle.upright else {}
    loads = make_loads(model, axis, num_rotors=len(rotors), acts=lambda effect: effect.at_hubs)
    vehicle_type, part_type, vector, held_type = whole.vehicle, part.vehicle, whole.vector, joints.held
    part_vector, start = part.vector, wp.vec3(*articulation.origins[link].tolist())

    @wp.func
    def no_rotor(vehicle: vehicle_type, some: part_type) -> part_type:
        return some

    @wp.func
    def no_number(each: vector, some: part_vector) -> part_vector:
        return some

    @wp.func
    def no_change(each: vector, some: part_vector) -> vector:
        return each

    def with_rotor(rest: wp.Function, i: int, rotor: int) -> wp.Function:
        @wp.func
        def one_rotor(vehicle: vehicle_type, some: part_type) -> part_type:
            after = rest(vehicle, some)
            for k in range(3):
                after.thrust_map[i, k] = vehicle.thrust_map[rotor, k]
                after.torque_map[i, k] = vehicle.torque_map[rotor, k]
                if wp.static(general):
                    after.reverse_thrust_map[i, k] = vehicle.reverse_thrust_map[rotor, k]
                    after.reverse_torque_map[i, k] = vehicle.reverse_torque_map[rotor, k]
                after.rotor_axis[i, k] = vehicle.rotor_axis[rotor, k]
                after.rotor_reaction[i, k] = vehicle.rotor_reaction[rotor, k]
                after.rotor_lever[i, k] = vehicle.rotor_lever[rotor, k] + vehicle.com[k] - start[k]
            after.rotor_radius[i] = vehicle.rotor_radius[rotor]
            return after

        return one_rotor

    def with_number(rest: wp.Function, i: int, rotor: int) -> wp.Function:
        @wp.func
        def one_number(each: vector, some: part_vector) -> part_vector:
            after = rest(each, some)
            after[i] = each[rotor]
            return after

        return one_number

    def with_change(rest: wp.Function, i: int, rotor: int) -> wp.Function:
        @wp.func
        def one_change(each: vector, some: part_vector) -> vector:
            after = rest(each, some)
            after[rotor] = some[i]
            return after

        return one_change

    rotors_of, numbers_of, changed = no_rotor, no_number, no_change
    for i, rotor in enumerate(rotors):
        rotors_of = with_rotor(rotors_of, i, rotor)
        numbers_of = with_number(numbers_of, i, rotor)
        changed = with_change(changed, i, rotor)

    @wp.func
    def link_hubs(
        vehicle: vehicle_type, held: held_type, thrusts: vector, rotation: wp.mat33, place: wp.vec3, ang_vel: wp.vec3,
        lin_vel: wp.vec3,
    ):  # fmt: skip
        some = rotors_of(vehicle, part_type())
        some.ground_height = vehicle.ground_height
        some.other_position = vehicle.other_position
        own, _drags, more = loads(
            some,
            held.params,
            held.position + rotate(held.attitude, place),
            held.attitude * wp.quat_from_matrix(rotation),
            rotate(held.attitude, lin_vel - held.wind),
            wp.transpose(rotation) * ang_vel,
            numbers_of(held.rotor_speed, part_vector()),
            numbers_of(held.rotor_acc, part_vector()),
        )
        return changed(thrusts, own), more

    return link_hubs
