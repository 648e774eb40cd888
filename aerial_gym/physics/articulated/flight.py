"""Flight of an articulated vehicle: the wrenches of rotors and effects on its links, and one step.

Each rotor and each effect at hubs (``Effect.at_hubs``) acts on the rotor's link, by that link's pose and motion. Effects on the
whole act on the base, at the centre of mass and with the geometry of the reference pose. Effects on links
(``effects.on_links``) act on each link by its own motion. All have the wind at the vehicle's centre of mass in the reference
pose.
Letters: E environments, R rotors, D joints, L links, C joints with a drive.
"""

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from aerial_gym.errors import CapabilityError
from aerial_gym.math.quaternion import quat_multiply, quat_rotate, quat_rotate_inverse
from aerial_gym.physics.articulated.articulation import Articulation
from aerial_gym.physics.articulated.link_loads import LinkDamping, LinkFluid, motion_in_air
from aerial_gym.physics.articulated.motion import move_links, place_links, rotations_to_base
from aerial_gym.physics.articulated.steppers import implicit_euler
from aerial_gym.physics.articulated.tree import Links, TreeState
from aerial_gym.physics.backend import Capabilities
from aerial_gym.physics.effects import LinkEffect, LinkFluidEffect, LinkWrenchEffect, WrenchEffect
from aerial_gym.physics.ground import Ground
from aerial_gym.physics.model import Model
from aerial_gym.physics.rigid_body import air_velocity, condition_in, force_breakdown
from aerial_gym.physics.rotor_lag import RotorCommand, follow_command, vehicle_lag
from aerial_gym.physics.rotors import rotor_thrust, rotor_torque
from aerial_gym.physics.state import ArticulatedState, BodyState, JointEfforts
from aerial_gym.physics.vehicle import is_shared, share_row


def articulated_step(
    model: Model, state: ArticulatedState, rotor_command: RotorCommand, joint_command: Tensor, dt: float, *,
    crept: Tensor | None = None, stepper: Callable[..., TreeState] = implicit_euler,
    applied: JointEfforts | None = None,
) -> ArticulatedState:  # fmt: skip
    """Return the state after one step of ``steppers.implicit_euler``; the rotors follow their exact solution.

    Args:
        state: Motion of the base, joints and rotors.
        joint_command: Commands of the drives, (E, C).
        crept: Positions of creep dashpots, (E, N, D); None without creep.
        stepper: Integrator of the tree, by default ``implicit_euler``.
        applied: Receives the applied efforts of drives and dry friction.
    """
    articulation = model.articulation
    assert articulation is not None
    if not articulation.tree.floating:
        state = replace(state, lin_vel=torch.zeros_like(state.lin_vel), ang_vel=torch.zeros_like(state.ang_vel))
    rotor_speed = follow_command(vehicle_lag(model.vehicle), state.rotor_speed, rotor_command, dt)
    rotor_acc = (rotor_speed - state.rotor_speed) / dt
    before = TreeState(
        position=state.position,
        attitude=state.attitude,
        lin_vel=state.lin_vel,
        ang_vel=state.ang_vel,
        joint_pos=state.joint_pos,
        joint_vel=state.joint_vel,
    )
    links = articulation.links(model.vehicle)  # recomputed, because a reset draws masses in place
    after = stepper(
        articulation.tree,
        links,
        articulation.laws(crept),
        before,
        dt,
        gravity=model.gravity,
        drive=articulation.drive(joint_command),
        friction=articulation.dry_friction_law,
        wrench=link_wrenches(model, articulation, before, rotor_speed, rotor_acc),
        damping=link_damping(model, articulation, links, before),
        fluid=link_fluid(model, links, before),
        applied=applied,
    )
    return ArticulatedState(**vars(after), rotor_speed=rotor_speed)


def link_wrenches(
    model: Model, articulation: Articulation, state: TreeState, rotor_speed: Tensor, rotor_acc: Tensor
) -> Tensor:
    """Return force [N] on each link at its origin and torque [N m], axes of the link, (E, L, 6).

    Args:
        rotor_speed: States of the rotors, (E, R).
        rotor_acc: Their angular accelerations [rad/s²], (E, R).
    """
    vehicle = model.vehicle
    thrust, more = rotor_thrust(vehicle, rotor_speed), None
    at_hubs = model.effects.select(lambda effect: effect.at_hubs)
    if any(at_hubs):
        blown = replace(model, effects=at_hubs)
        thrust, more = _hub_wrenches(blown, articulation, state, _wind(model, state), rotor_speed, rotor_acc)
    force = thrust.unsqueeze(-1) * vehicle.rotor_axis
    drag = (vehicle.rotor_spin * rotor_torque(vehicle, rotor_speed)).unsqueeze(-1) * vehicle.rotor_axis
    hub = vehicle.rotor_position - articulation.origins[list(articulation.rotor_links)]
    each = torch.cat((force, torch.linalg.cross(hub.expand_as(force), force) - drag), dim=-1)
    on_links = each.new_zeros(len(each), articulation.tree.num_links, 6) if more is None else more
    on_links = on_links.index_add(1, torch.tensor(articulation.rotor_links, device=each.device), each)
    whole = replace(model, effects=model.effects.select(lambda effect: not effect.at_hubs))
    if whole.effects[WrenchEffect]:
        body = _body(state, rotor_speed)
        for _, wrench in force_breakdown(whole, condition_in(whole, body, rotor_acc)).wrenches:
            push, twist = wrench[:, :3], wrench[:, 3:] + torch.linalg.cross(vehicle.com, wrench[:, :3])
            on_base = torch.cat((push, twist), dim=-1).unsqueeze(1)
            on_links = on_links + torch.nn.functional.pad(on_base, (0, 0, 0, articulation.num_joints))
    if model.effects[LinkWrenchEffect]:
        on_links = on_links + _link_effect_wrenches(model, articulation, state)
    return on_links


def _link_effect_wrenches(model: Model, articulation: Articulation, state: TreeState) -> Tensor:
    """Return the wrenches of effects on links, (E, L, 6), with arguments and axes of ``link_wrenches``."""
    links = articulation.links(model.vehicle)
    places = place_links(articulation.tree, links, state.joint_pos)
    up = torch.zeros_like(state.position)
    up[:, 2] = 1.0
    own = (places.rotation.mT @ quat_rotate_inverse(state.attitude, up)[:, None, :, None]).squeeze(-1)
    first, *rest = (effect.wrench(own, params) for effect, params in model.effects[LinkWrenchEffect])
    force, torque = sum(rest, first).split(3, dim=-1)
    wrench = torch.cat((force, torque + torch.linalg.cross(links.com.expand_as(force), force)), dim=-1)
    return torch.where(links.mass.unsqueeze(-1) > 0.0, wrench, 0.0)


def _hub_wrenches(
    model: Model, articulation: Articulation, state: TreeState, wind: Tensor, rotor_speed: Tensor, rotor_acc: Tensor
) -> tuple[Tensor, Tensor]:
    """Return all thrusts [N], (E, R), and further wrenches of effects at hubs on each link, as ``link_wrenches``, (E, L, 6).

    These effects treat a link with its rotors as a separate vehicle, with its centre of mass at the link's origin.

    Args:
        wind: Velocity of the air [m/s], world, (E, 3).
    """
    tree, turn = articulation.tree, state.attitude
    places = place_links(tree, articulation.links(model.vehicle), state.joint_pos)
    motion = move_links(tree, places, quat_rotate_inverse(turn, state.lin_vel - wind), state.ang_vel, state.joint_vel)
    attitudes = rotations_to_base(tree, state.joint_pos)
    thrust, on_links = [turn.new_zeros(len(turn))] * len(articulation.rotor_links), []
    for link in range(tree.num_links):
        rotors = list(articulation.link_rotors(link))
        if not rotors:
            on_links.append(turn.new_zeros(len(turn), 6))
            continue
        some = model.vehicle.of_rotors(rotors)
        origin, hubs = articulation.origins[link], some.rotor_position
        hubs = share_row(hubs[0] - origin, len(turn)) if is_shared(hubs) else hubs - origin
        vehicle = replace(some, com=share_row(torch.zeros_like(origin), len(turn)), rotor_position=hubs)
        there = BodyState(
            position=state.position + quat_rotate(turn, places.origin[:, link]),
            attitude=quat_multiply(turn, attitudes[:, link]),
            lin_vel=quat_rotate(turn, motion.lin_vel[:, link]),
            ang_vel=(places.rotation[:, link].mT @ motion.ang_vel[:, link].unsqueeze(-1)).squeeze(-1),
            rotor_speed=rotor_speed[:, rotors],
        )
        own = replace(model, vehicle=vehicle)
        acting = force_breakdown(own, condition_in(own, there, rotor_acc[:, rotors]))
        for rotor, column in zip(rotors, acting.whole_thrust.unbind(1), strict=True):
            thrust[rotor] = column
        on_links.append(sum((wrench for _, wrench in acting.wrenches), turn.new_zeros(len(turn), 6)))
    return torch.stack(thrust, dim=1), torch.stack(on_links, dim=1)


def _body(state: TreeState, rotor_speed: Tensor) -> BodyState:
    """Return the motion of the base as a rigid vehicle."""
    return BodyState(
        position=state.position,
        attitude=state.attitude,
        lin_vel=state.lin_vel,
        ang_vel=state.ang_vel,
        rotor_speed=rotor_speed,
    )


def _wind(model: Model, state: TreeState) -> Tensor:
    """Return the velocity of the air at the vehicle's centre of mass in the reference pose [m/s], world, (E, 3)."""
    turn, com = state.attitude, model.vehicle.com
    still = torch.zeros_like(state.lin_vel)
    return -quat_rotate(turn, air_velocity(model, state.position + quat_rotate(turn, com), turn, still))


def link_damping(model: Model, articulation: Articulation, links: Links, state: TreeState) -> LinkDamping | None:
    """Return the damping of the links at the start of a step; None without damping."""
    if not model.effects[LinkEffect]:
        return None
    ((effect, params),) = model.effects[LinkEffect]
    turn = state.attitude
    velocity, turned_wind = motion_in_air(
        articulation.tree,
        links,
        state.joint_pos,
        state.joint_vel,
        quat_rotate_inverse(turn, state.lin_vel),
        state.ang_vel,
        quat_rotate_inverse(turn, _wind(model, state)),
    )
    damping = torch.where(links.mass.unsqueeze(-1) > 0.0, effect.damping(velocity, params), 0.0)
    return LinkDamping(velocity=velocity, damping=damping, turned_wind=turned_wind)


def link_fluid(model: Model, links: Links, state: TreeState) -> LinkFluid | None:
    """Return the added mass of the links; None without any. Arguments as for ``link_damping``."""
    if not model.effects[LinkFluidEffect]:
        return None
    ((effect, params),) = model.effects[LinkFluidEffect]
    heavy = links.mass.unsqueeze(-1) > 0.0
    added = torch.where(heavy, effect.added_mass(links.mass.shape[1], params), 0.0)
    return LinkFluid(added=added, wind=_wind(model, state))


def check_integrator_and_ground(integrator: str, ground: Ground | None, able: Capabilities) -> None:
    """Raise ``CapabilityError`` for an integrator or ground that a backend does not support with joints."""
    if integrator != "euler":
        raise CapabilityError(
            f"joints: no integrator {integrator!r}. Efforts in joints are stiff; only 'euler' takes them at the end of a step"
        )
    if ground is not None and ground.cfg is not None and not able.contact_of_links:
        raise CapabilityError(
            "joints: ground ends an episode here, but cannot push back on a vehicle that bends. Leave contact out of the "
            "environment, or use backend 'mujoco'"
        )
