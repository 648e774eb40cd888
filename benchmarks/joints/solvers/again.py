"""A kernel that solves for the accelerations of a tree again and again, and does nothing else, with either way to solve.

Loads, stores and number of solves are those of the caller, whatever solves: what two such kernels differ in is the solve.
Letters: E environments, D joints, R rotors.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
import warp as wp
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.interop import RecordedLaunch
from aerial_gym.physics import build_model, vehicle_from_config
from aerial_gym.physics.articulated.articulation import Articulation, articulation_of
from aerial_gym.physics.articulated.fused.inertia import plus
from aerial_gym.physics.articulated.fused.kernel import make_base
from aerial_gym.physics.articulated.fused.recursion import joint_types, make_recursion
from aerial_gym.physics.fused.functions import solve_motion
from aerial_gym.physics.fused.packing import arrange, numbers_of, shared_structs, types_of
from aerial_gym.physics.fused.types import RotorTypes, vector_of
from aerial_gym.physics.model import Model
from aerial_gym.physics.warp_backend import BLOCK_DIM
from benchmarks.joints.solvers.factor import make_factor

MAKERS: dict[str, Callable[..., tuple[wp.Function, wp.Function]]] = {"recursion": make_recursion, "factor": make_factor}
"""Of the ways in and back through a tree."""


@dataclass(frozen=True)
class Motion:
    """What solves begin with, and the accelerations that the last one found; float32."""

    lin_vel: Tensor
    """Of the base [m/s], its axes, (E, 3)."""

    ang_vel: Tensor
    """Of the base [rad/s], its axes, (E, 3)."""

    weight: Tensor
    """Acceleration that holds against weight [m/s²], axes of the base, (E, 3)."""

    joint_pos: Tensor
    """[rad] or [m], (E, D)."""

    joint_vel: Tensor
    """Rates, (E, D)."""

    thrust: Tensor
    """Of the rotors [N], (E, R)."""

    drag: Tensor
    """Drag torques of the rotors [N m], (E, R)."""

    lin_acc: Tensor
    """Receives that of the base [m/s²], weight not taken off it, axes of the base, (E, 3)."""

    ang_acc: Tensor
    """Receives that of the base [rad/s²], (E, 3)."""

    joint_acc: Tensor
    """Receives those of the joints, (E, D)."""


def model_of(robot: RobotCfg, num_envs: int, device: torch.device) -> Model:
    """Return the model of a robot with joints, with gravity and without effects."""
    vehicle = vehicle_from_config(robot, num_envs=num_envs, device=device)
    return build_model(vehicle, articulation=articulation_of(robot, like=vehicle.mass))


def bends_of(model: Model) -> Articulation:
    """Return how a model bends."""
    assert model.articulation is not None
    return model.articulation


def random_motion(model: Model, seed: int = 0) -> Motion:
    """Return motions with joints up to 0.3 rad off their reference pose, drawn; accelerations are NaN.

    Joints turn at some 2 rad/s, the base at 1 rad/s; each rotor carries its share of the weight.
    """
    bends, vehicle = bends_of(model), model.vehicle
    generator = torch.Generator().manual_seed(seed)
    num_envs, num_joints, num_rotors = vehicle.num_envs, bends.num_joints, vehicle.num_rotors

    def drawn(width: int, scale: float) -> Tensor:
        return (scale * torch.randn(num_envs, width, generator=generator)).to(vehicle.mass)

    def free(width: int) -> Tensor:
        return vehicle.mass.new_full((num_envs, width), torch.nan)

    moves, away = float(bends.tree.floating), 0.6 * torch.rand(num_envs, num_joints, generator=generator) - 0.3
    thrust = (vehicle.mass[:1] * model.gravity / num_rotors).expand(num_envs, num_rotors).reshape(num_envs, num_rotors)
    return Motion(
        lin_vel=moves * drawn(3, 1.0),
        ang_vel=moves * drawn(3, 1.0),
        weight=model.gravity * torch.nn.functional.normalize(drawn(3, 1.0), dim=-1),
        joint_pos=bends.reference + away.to(vehicle.mass),
        joint_vel=drawn(num_joints, 2.0),
        thrust=thrust.contiguous(),
        drag=0.01 * thrust,
        lin_acc=free(3),
        ang_acc=free(3),
        joint_acc=free(num_joints),
    )


def make_solve_kernel(
    articulation: Articulation, types: RotorTypes, make: Callable[..., tuple[wp.Function, wp.Function]]
) -> wp.Kernel:
    """Return the kernel: (shared vehicle, the fields of ``Motion``, dt, repeats).

    Each solve begins with the velocities at the end of the one before, and joints where these take them.

    Args:
        articulation: The tree, its laws in joints and where its rotors are.
        types: For these rotors.
        make: Of ``MAKERS``.
    """
    joints = joint_types(articulation.num_joints, None, types.vector)
    rotor_vector, vector, vehicle_type, held_type = types.vector, joints.vector, types.vehicle, joints.held
    floating = articulation.tree.floating
    way_in, way_back = make(articulation, types, joints, {}, {})
    base = make_base(articulation, vehicle_type)

    @wp.func
    def find(
        vehicle: vehicle_type, weight: wp.vec3, pos: vector, vel: vector, thrusts: rotor_vector, drags: rotor_vector,
        w: wp.vec3, v: wp.vec3, dt: float,
    ):  # fmt: skip
        carried, kept = way_in(vehicle, pos, vel, vel, held_type(), thrusts, drags, w, w, v, dt)
        turn = wp.vec3()
        rise = weight
        if wp.static(floating):
            whole = plus(carried, base(vehicle, w, v))
            push, twist = solve_motion(whole.push, whole.mixed, whole.turn, whole.force, whole.torque)
            turn = -twist
            rise = -push
        return way_back(kept, turn, rise), turn, rise

    @wp.kernel(module="unique", enable_backward=False)
    def solve_again(
        # params
        vehicle: vehicle_type,
        # state
        lin_vel: wp.array[wp.vec3],  # (E,) base axes [m/s]
        ang_vel: wp.array[wp.vec3],  # (E,) [rad/s]
        weight: wp.array[wp.vec3],  # (E,) [m/s²]
        joint_pos: wp.array[vector],  # (E,) [rad]
        joint_vel: wp.array[vector],  # (E,) [rad/s]
        thrust: wp.array[rotor_vector],  # (E,) [N]
        drag: wp.array[rotor_vector],  # (E,) [N m]
        dt: float,  # [s]
        repeats: int,
        # out
        lin_acc_out: wp.array[wp.vec3],  # (E,) base axes [m/s²]
        ang_acc_out: wp.array[wp.vec3],  # (E,) [rad/s²]
        joint_acc_out: wp.array[vector],  # (E,) [rad/s²]
    ):
        """Write the accelerations that the last solve found."""
        env = wp.tid()
        v = lin_vel[env]
        w = ang_vel[env]
        held = weight[env]
        pos = joint_pos[env]
        vel = joint_vel[env]
        thrusts = thrust[env]
        drags = drag[env]
        turn = wp.vec3()
        rise = wp.vec3()
        acc = vector()
        for _k in range(repeats):
            acc, turn, rise = find(vehicle, held, pos, vel, thrusts, drags, w, v, dt)
            if wp.static(floating):
                v += dt * (rise - held + wp.cross(w, v))
                w += dt * turn
            vel += dt * acc
            pos += dt * vel
        lin_acc_out[env] = rise
        ang_acc_out[env] = turn
        joint_acc_out[env] = acc

    return solve_again


def solve_kernel(model: Model, way: str) -> wp.Kernel:
    """Return the kernel of one way of ``MAKERS``, which is not compiled yet."""
    return make_solve_kernel(bends_of(model), types_of(model), MAKERS[way])


def solve_launch(model: Model, kernel: wp.Kernel, motion: Motion, *, dt: float, repeats: int) -> RecordedLaunch:
    """Return a launch of a kernel of ``solve_kernel``.

    Args:
        model: That of the kernel; all environments share its vehicle.
        kernel: What solves.
        motion: Read, and its accelerations written.
        dt: Step that joints' laws are taken over [s].
        repeats: Solves in a launch.
    """
    law = make_controller(CONTROLLERS.get("no_control"), model.vehicle, model.gravity, dt=dt).fused()
    assert law is not None
    numbers = numbers_of(model, law, dt)
    vehicle = shared_structs(arrange(numbers, all_packed=False), numbers, law, types_of(model))[0]
    of_base = ("lin_vel", "ang_vel", "weight", "lin_acc", "ang_acc")
    kinds = {name: wp.vec3 if name in of_base else vector_of(rows.shape[1]) for name, rows in vars(motion).items()}
    arrays = [wp.from_torch(rows, dtype=kinds[name]) for name, rows in vars(motion).items()]
    return RecordedLaunch(
        kernel,
        dim=model.vehicle.num_envs,
        inputs=[vehicle, *arrays[:7], dt, repeats],
        outputs=arrays[7:],
        device=wp.device_from_torch(model.vehicle.mass.device),
        block_dim=BLOCK_DIM,
    )
