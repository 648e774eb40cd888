"""A vehicle that bends, in the air: what its rotors and effects do to its links, and one step of it.

Each rotor pushes the link that it sits on. Effects on the whole act on the base, at the centre of mass and with the geometry of
the reference pose; effects on links (``LinkEffect``) on each link where it is, by its own motion.
Letters: E environments, R rotors, D joints, L links, C joints with a drive.
"""

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from aerial_gym.errors import CapabilityError
from aerial_gym.math.quaternion import quat_rotate, quat_rotate_inverse
from aerial_gym.physics.articulated.articulation import Articulation
from aerial_gym.physics.articulated.link_damping import LinkDamping, motion_in_air
from aerial_gym.physics.articulated.steppers import implicit_euler
from aerial_gym.physics.articulated.tree import Links, TreeState
from aerial_gym.physics.backend import Capabilities
from aerial_gym.physics.effects import LinkEffect, RotorEffect, WrenchEffect
from aerial_gym.physics.ground import Ground
from aerial_gym.physics.model import Model
from aerial_gym.physics.rigid_body import acting_in, air_velocity, condition_in
from aerial_gym.physics.rotor_lag import RotorCommand, follow_command
from aerial_gym.physics.rotors import rotor_thrust, rotor_torque
from aerial_gym.physics.state import BodyState, JointedState


def jointed_step(
    model: Model,
    state: JointedState,
    rotor_command: RotorCommand,
    joint_command: Tensor,
    dt: float,
    *,
    crept: Tensor | None = None,
    stepper: Callable[..., TreeState] = implicit_euler,
) -> JointedState:
    """Return the state after one step of ``steppers.implicit_euler``; the rotors follow their exact solution.

    Args:
        model: With its articulation.
        state: Motion of the base, joints and rotors.
        rotor_command: What the rotors follow.
        joint_command: Of the drives, (E, C).
        dt: Length of the step [s].
        crept: Where dashpots of joints that creep stand, (E, N, D); None where none does.
        stepper: What moves the tree, in place of ``implicit_euler``.
    """
    articulation = model.articulation
    assert articulation is not None
    if not articulation.tree.floating:
        state = replace(state, lin_vel=torch.zeros_like(state.lin_vel), ang_vel=torch.zeros_like(state.ang_vel))
    rotor_speed = follow_command(model.vehicle, state.rotor_speed, rotor_command, dt)
    rotor_acc = (rotor_speed - state.rotor_speed) / dt
    body = BodyState(
        position=state.position,
        attitude=state.attitude,
        lin_vel=state.lin_vel,
        ang_vel=state.ang_vel,
        rotor_speed=rotor_speed,
    )
    before = TreeState(
        position=state.position,
        attitude=state.attitude,
        lin_vel=state.lin_vel,
        ang_vel=state.ang_vel,
        joint_pos=state.joint_pos,
        joint_vel=state.joint_vel,
    )
    links = articulation.links(model.vehicle)  # anew: a reset draws masses in place
    after = stepper(
        articulation.tree,
        links,
        articulation.laws(crept),
        before,
        dt,
        gravity=model.gravity,
        drive=articulation.drive(joint_command),
        friction=articulation.resistance,
        wrench=link_wrenches(model, articulation, body, rotor_acc),
        damping=link_damping(model, articulation, links, before),
    )
    return JointedState(**vars(after), rotor_speed=rotor_speed)


def link_wrenches(model: Model, articulation: Articulation, body: BodyState, rotor_acc: Tensor) -> Tensor:
    """Return force [N] on each link at its origin and torque [N m], axes of the link, (E, L, 6).

    Args:
        model: Vehicle and effects.
        articulation: Its own.
        body: Motion of the base, and states of the rotors.
        rotor_acc: Angular accelerations of the rotors [rad/s²], (E, R).
    """
    vehicle = model.vehicle
    thrust, others = rotor_thrust(vehicle, body.rotor_speed), []
    if model.effects[RotorEffect] or model.effects[WrenchEffect]:
        acting = acting_in(model, condition_in(model, body, rotor_acc))
        thrust, others = acting.whole_thrust, acting.wrenches
    force = thrust.unsqueeze(-1) * vehicle.rotor_axis
    drag = (vehicle.rotor_spin * rotor_torque(vehicle, body.rotor_speed)).unsqueeze(-1) * vehicle.rotor_axis
    hub = vehicle.rotor_position - articulation.origins[list(articulation.rotor_links)]
    each = torch.cat((force, torch.linalg.cross(hub.expand_as(force), force) - drag), dim=-1)
    on_links = each.new_zeros(len(each), articulation.tree.num_links, 6)
    on_links = on_links.index_add(1, torch.tensor(articulation.rotor_links, device=each.device), each)
    for _, wrench in others:
        push, twist = wrench[:, :3], wrench[:, 3:] + torch.linalg.cross(vehicle.com, wrench[:, :3])
        whole = torch.cat((push, twist), dim=-1).unsqueeze(1)
        on_links = on_links + torch.nn.functional.pad(whole, (0, 0, 0, articulation.num_joints))
    return on_links


def link_damping(model: Model, articulation: Articulation, links: Links, state: TreeState) -> LinkDamping | None:
    """Return what damps the links at the start of a step; None where nothing does.

    Args:
        model: Vehicle and effects. Their wind is that at the vehicle's centre of mass in the reference pose, for all links.
        articulation: Its own.
        links: What they weigh.
        state: Their motion.
    """
    if not model.effects[LinkEffect]:
        return None
    ((effect, params),) = model.effects[LinkEffect]
    turn, com = state.attitude, model.vehicle.com
    wind = -air_velocity(model, state.position + quat_rotate(turn, com), turn, torch.zeros_like(state.lin_vel))
    velocity, turned_wind = motion_in_air(
        articulation.tree,
        links,
        state.joint_pos,
        state.joint_vel,
        quat_rotate_inverse(turn, state.lin_vel),
        state.ang_vel,
        wind,
    )
    damping = torch.where(links.mass.unsqueeze(-1) > 0.0, effect.damping(velocity, params), 0.0)
    return LinkDamping(velocity=velocity, damping=damping, turned_wind=turned_wind)


def check_jointed(integrator: str, ground: Ground | None, able: Capabilities) -> None:
    """Raise ``CapabilityError`` for what a vehicle that bends cannot have on a backend."""
    if integrator != "euler":
        raise CapabilityError(
            f"joints: no integrator {integrator!r}. Efforts in joints are stiff; only 'euler' takes them at the end of a step"
        )
    if ground is not None and ground.cfg is not None and not able.contact_of_links:
        raise CapabilityError(
            "joints: ground ends an episode here, but cannot push back on a vehicle that bends. Leave contact out of the "
            "environment, or use backend 'mujoco'"
        )
