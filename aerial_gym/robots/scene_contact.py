"""Contact of the robot with obstacles, at rest or moving: changes its motion after each physics step.

The ground plane of an environment is solved inside the physics step, before. Formula and sources: ``physics.contact``.
Frames: world of each environment, z up; spheres in the body frame. Letters: E environments, A instances, C spheres.
"""

from dataclasses import dataclass

import torch
import warp as wp
from torch import Tensor

from aerial_gym.assets import Scene
from aerial_gym.assets.geometry import outward_normal, signed_distance
from aerial_gym.assets.scene_arrays import SceneArrays, part_attitude, part_is_present, part_position
from aerial_gym.assets.views import check_tensor, vector_view
from aerial_gym.config.contact import ContactCfg
from aerial_gym.interop import on_torch_stream
from aerial_gym.physics import BodyState
from aerial_gym.physics.contact import POSITION_SHARE
from aerial_gym.physics.fused.contact import (
    ContactParameters,
    contact_parameters,
    displaced,
    make_velocity_change,
    point_velocity,
    rows_of,
)
from aerial_gym.physics.fused.functions import rotate
from aerial_gym.physics.fused.types import vector_of

MAX_CONTACTS = 8
"""Pairs of sphere and part that push in one step; of more, the deepest."""

_gaps_type, _rows_type = vector_of(MAX_CONTACTS), rows_of(MAX_CONTACTS)
_velocity_change = make_velocity_change(MAX_CONTACTS)


@wp.struct
class TouchingPairs:
    """Pairs of sphere and part that overlap, as ``make_velocity_change`` takes them."""

    gaps: _gaps_type  # [m], 0 where there is none
    levers: _rows_type  # [m] world
    normals: _rows_type  # world
    surface_vels: _rows_type  # [m/s] world


@wp.struct
class SceneMotion:
    """How obstacles move."""

    lin_vel: wp.array2d[wp.vec3]  # (E, A) of the instance's origin, world [m/s]
    ang_vel: wp.array2d[wp.vec3]  # (E, A) world [rad/s]


@wp.struct
class RobotBody:
    """What is pushed."""

    mass: wp.array[float]  # (E,) [kg]
    inertia: wp.array[wp.mat33]  # (E,) about the centre of mass, body [kg m²]
    com: wp.array[wp.vec3]  # (E,) from the body origin, body [m]
    sphere: wp.array[wp.vec4]  # (C,) centre in the body frame, radius [m]


@wp.func
def _shallowest(pairs: TouchingPairs) -> int:
    """Return the entry of the smallest overlap, an empty one if there is any."""
    found = wp.int32(0)
    for i in range(1, MAX_CONTACTS):
        if pairs.gaps[i] > pairs.gaps[found]:
            found = i
    return found


@wp.func
def _find_pairs(
    scene: SceneArrays, motion: SceneMotion, body: RobotBody, env: int, center_of_mass: wp.vec3, attitude: wp.quat
) -> TouchingPairs:
    """Return the pairs that overlap, the deepest ``MAX_CONTACTS`` if there are more; instances alone, not the ground."""
    pairs = TouchingPairs()
    for part in range(scene.num_solid):
        a = scene.part_instance[env, part]
        if a >= 0 and part_is_present(scene, env, part):
            shape = scene.shapes[scene.part_shape[env, part]]
            turn = part_attitude(scene, env, part)
            origin = part_position(scene, env, part)
            for c in range(body.sphere.shape[0]):
                radius = body.sphere[c][3]
                offset = rotate(
                    attitude, wp.vec3(body.sphere[c][0], body.sphere[c][1], body.sphere[c][2]) - body.com[env]
                )
                away = center_of_mass + offset - origin
                if wp.length(away) - scene.radius[env, part] < radius:
                    local = wp.quat_rotate_inv(turn, away)
                    gap = signed_distance(shape, local) - radius
                    i = _shallowest(pairs)
                    if gap < pairs.gaps[i]:
                        normal = wp.quat_rotate(turn, outward_normal(shape, local))
                        lever = offset - radius * normal
                        arm = center_of_mass + lever - scene.position[env, a]
                        pairs.gaps[i] = gap
                        pairs.levers[i] = lever
                        pairs.normals[i] = normal
                        pairs.surface_vels[i] = motion.lin_vel[env, a] + wp.cross(motion.ang_vel[env, a], arm)
    return pairs


@wp.kernel(enable_backward=False)
def _push(
    # scene
    scene: SceneArrays,
    motion: SceneMotion,
    # params
    body: RobotBody,
    law: ContactParameters,
    # state
    first_lin_vel: wp.array[wp.vec3],  # (E,) of the body origin at the start of the physics step, world [m/s]
    first_ang_vel: wp.array[wp.vec3],  # (E,) likewise, body [rad/s]
    dt: float,  # [s]
    # out
    position_out: wp.array[wp.vec3],  # (E,) body origin, world [m]; read, and written where something touches
    attitude_out: wp.array[wp.quat],  # (E,) body to world, xyzw
    lin_vel_out: wp.array[wp.vec3],  # (E,) world [m/s]
    ang_vel_out: wp.array[wp.vec3],  # (E,) body [rad/s]
    crashes_out: wp.array[wp.bool],  # (E,) set where this is a crash
    impulse_out: wp.array[wp.vec3],  # (E,) world [N s], added to
):
    """Change the motion of the robots that overlap obstacles; leave the others alone."""
    env = wp.tid()
    q = attitude_out[env]
    w = ang_vel_out[env]
    com = body.com[env]
    x = position_out[env] + rotate(q, com)
    pairs = _find_pairs(scene, motion, body, env, x, q)
    if wp.min(pairs.gaps) >= 0.0:
        return
    v = lin_vel_out[env] + rotate(q, wp.cross(w, com))
    turn = rotate(q, first_ang_vel[env])
    first_v = first_lin_vel[env] + wp.cross(turn, rotate(q, com))
    for i in range(MAX_CONTACTS):
        approach = wp.dot(pairs.normals[i], pairs.surface_vels[i] - point_velocity(first_v, turn, pairs.levers[i]))
        if pairs.gaps[i] < 0.0 and approach >= law.least_approach:
            crashes_out[env] = True
    delta, delta_turn = _velocity_change(
        law, dt, body.mass[env], body.inertia[env], q, v, rotate(q, w),
        pairs.gaps, pairs.levers, pairs.normals, pairs.surface_vels,
    )  # fmt: skip
    x, q, v, w = displaced(law, dt, x, q, v, w, delta, delta_turn)
    position_out[env] = x - rotate(q, com)
    attitude_out[env] = q
    lin_vel_out[env] = v - rotate(q, wp.cross(w, com))
    ang_vel_out[env] = w
    impulse_out[env] = impulse_out[env] + body.mass[env] * delta


@dataclass(frozen=True, kw_only=True)
class PushedRobot:
    """The tensors of the robot that is pushed; they must stay where they are."""

    mass: Tensor
    """[kg], (E,)."""

    inertia: Tensor
    """About the centre of mass [kg m²], body, (E, 3, 3)."""

    com: Tensor
    """Centre of mass from the body origin [m], body, (E, 3)."""

    spheres: Tensor
    """Centres in the body frame and radii [m], (C, 4)."""


class SceneContact:
    """Contact of one robot per environment with the obstacles, with all views made at construction."""

    def __init__(
        self,
        scene: Scene,
        cfg: ContactCfg,
        robot: PushedRobot,
        state: BodyState,
        *,
        integrator: str,
        dt: float,
        crashes_out: Tensor,
        impulse_out: Tensor,
    ) -> None:
        """Take views of the tensors, which must stay where they are.

        Args:
            scene: What can be touched.
            cfg: How it pushes back.
            robot: What is pushed.
            state: Its motion, written in place where it touches something.
            integrator: Stepper of the physics, an entry of ``contact.POSITION_SHARE``.
            dt: Length of a physics step [s].
            crashes_out: Set, bool, (E,), where it touches at the speed of a crash; never cleared here.
            impulse_out: Receives the sum of the impulses [N s], world, (E, 3); never cleared here.

        Raises:
            ShapeError: If a tensor does not fit the scene.
        """
        envs, device = (scene.num_envs,), scene.device
        check_tensor("crashes_out", crashes_out, envs, device=device, dtype=torch.bool)
        self._state, self._kept_alive = state, (scene, robot, crashes_out, impulse_out)
        self._first = (torch.zeros_like(state.lin_vel), torch.zeros_like(state.ang_vel))
        motion, body = SceneMotion(), RobotBody()
        size = (scene.num_envs, scene.num_instances, 3)
        motion.lin_vel = vector_view("lin_vel", scene.asset_state[..., 7:10], size, device=device)
        motion.ang_vel = vector_view("ang_vel", scene.asset_state[..., 10:13], size, device=device)
        check_tensor("mass", robot.mass, envs, device=device)
        check_tensor("inertia", robot.inertia, (*envs, 3, 3), device=device)
        body.mass, body.inertia = wp.from_torch(robot.mass), wp.from_torch(robot.inertia, dtype=wp.mat33)
        body.com = vector_view("com", robot.com, (*envs, 3), device=device)
        body.sphere = wp.from_torch(robot.spheres, dtype=wp.vec4)

        def view(name: str, tensor: Tensor) -> wp.array:
            return vector_view(name, tensor, (*envs, tensor.shape[-1]), device=device)

        law = contact_parameters(cfg, POSITION_SHARE[integrator])
        first = [view(name, tensor) for name, tensor in zip(("lin_vel", "ang_vel"), self._first, strict=True)]
        moved = [view(name, getattr(state, name)) for name in ("position", "attitude", "lin_vel", "ang_vel")]
        self._command = wp.launch(
            _push,
            dim=scene.num_envs,
            inputs=[scene.arrays, motion, body, law, *first, dt],
            outputs=[*moved, wp.from_torch(crashes_out), view("impulse_out", impulse_out)],
            device=wp.device_from_torch(device),
            record_cmd=True,
        )

    def remember(self) -> None:
        """Keep the velocities of this instant, the start of a physics step: they say how fast things approach."""
        self._first[0].copy_(self._state.lin_vel)
        self._first[1].copy_(self._state.ang_vel)

    def push(self) -> None:
        """Push the robots that overlap obstacles at the end of a physics step.

        Launched on torch's current stream, not waited for.
        """
        with on_torch_stream(self._state.lin_vel):
            self._command.launch()
