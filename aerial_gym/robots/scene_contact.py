"""Contact of the robot with obstacles, at rest or moving: changes its motion after each substep of the physics.

After a substep and its ground contact the swept test stops the robot at obstacles in its path (``crossings``). Then the
obstacles move, and contact acts on overlaps (``touching_pairs``); its shift is swept as well. It is
a ``SubstepHook``: the fused kernel includes it, and the torch backend calls it. Formula and sources: ``physics.contact``.

Robots of spheres alone have a shorter kernel.
Frames: world of each environment, z up; spheres in the body frame. Letters: E environments, A instances, C spheres.
"""

from dataclasses import dataclass
from functools import cache

import torch
import warp as wp
from torch import Tensor

from aerial_gym.assets import Scene
from aerial_gym.assets.cores import has_boxes_or_capsules
from aerial_gym.assets.obstacle_motion import move_instance
from aerial_gym.assets.obstacles import Obstacles
from aerial_gym.assets.scene_arrays import check_tensor, vector_view
from aerial_gym.config.environment import ContactCfg
from aerial_gym.config.robot import CollisionShape
from aerial_gym.errors import ShapeError
from aerial_gym.interop import ReusableLaunch, make_struct
from aerial_gym.math.warp_functions import rotate
from aerial_gym.physics import BodyState
from aerial_gym.physics.contact import displacement_per_velocity_change
from aerial_gym.physics.fused.contact import ContactParameters, contact_parameters, displace, make_velocity_change
from aerial_gym.physics.fused.hook import FusedHook, Substep
from aerial_gym.physics.integrators import MassState
from aerial_gym.robots.contact_pairs import (
    MAX_CONTACTS,
    ContactScene,
    add_core_pairs,
    contact_scene,
    deepest_of_both,
    find_pairs,
    has_fast_approach,
)
from aerial_gym.robots.crossings import make_stop_search

_velocity_change = make_velocity_change(MAX_CONTACTS)

_FIRST_MOTION = ("position", "attitude", "lin_vel", "ang_vel")  # Stored motion of the centre of mass before a substep


@wp.struct
class SceneSurroundings:
    """Obstacles, contact law and the outputs of contact."""

    near: ContactScene
    law: ContactParameters
    crashes: wp.array[wp.bool]  # (E,) set where a touch is a crash
    impulse: wp.array[wp.vec3]  # (E,) world [N s], added to


@wp.struct
class DynamicSurroundings:
    """``SceneSurroundings`` with moving obstacles."""

    around: SceneSurroundings
    obstacles: Obstacles


@cache
def _make_contact_motion(*, moves: bool, cores: bool, meshes: bool) -> wp.Function:
    """Return the contact after a substep; whether obstacles move, the robot has boxes or capsules, and any part is a mesh."""
    find_stop, obstacles_type = make_stop_search(moves=moves, cores=cores, meshes=meshes), Obstacles if moves else int

    @wp.func
    def contact_motion(around: SceneSurroundings, obstacles: obstacles_type, env: int, done: Substep):
        """Return a robot's motion after the swept test against obstacles and the impulses of contact.

        Obstacles move by the substep between these. The motion of a robot without contact is unchanged bit for bit.
        """
        v = done.lin_vel
        w = done.ang_vel
        stop = find_stop(around.near, obstacles, around.law.crash_approach_speed, env, done)
        if wp.static(moves):
            for a in range(obstacles.asset.shape[1]):
                move_instance(obstacles, env, a, done.dt, 1)
        x = stop.position
        q = stop.attitude
        pairs = find_pairs(around.near, done.com, env, x, q)
        if wp.static(cores):
            pairs = add_core_pairs(pairs, around.near, done.com, env, x, q)
        if stop.crosses:
            pairs = deepest_of_both(pairs, stop.pairs)
        turn = rotate(q, done.first_ang_vel)
        if stop.crashes or has_fast_approach(pairs, done.first_lin_vel, turn, around.law.crash_approach_speed):
            around.crashes[env] = True
        if wp.min(pairs.gaps) >= 0.0:
            return x, q, v, w
        delta, delta_turn = _velocity_change(
            around.law, done.dt, done.mass, done.inertia, q, v, rotate(q, w),
            pairs.gaps, pairs.levers, pairs.normals, pairs.surface_vels,
        )  # fmt: skip
        around.impulse[env] = around.impulse[env] + done.mass * delta
        pushed_x, pushed_q, v, w = displace(around.law, done.dt, x, q, v, w, delta, delta_turn)
        if not stop.crosses:
            shifted = done  # the push of one end of a rod may turn its other end through a wall
            shifted.dt = 0.0
            shifted.first_position = x
            shifted.first_attitude = q
            shifted.position = pushed_x
            shifted.attitude = pushed_q
            end = find_stop(around.near, obstacles, wp.inf, env, shifted)
            x = end.position
            q = end.attitude
        return x, q, v, w

    return contact_motion


@cache
def _make_hook(*, moves: bool, cores: bool, meshes: bool) -> tuple[type, wp.Function]:
    """Return the struct and the function of a hook."""
    contact_motion = _make_contact_motion(moves=moves, cores=cores, meshes=meshes)

    @wp.func
    def contact_with_fixed(around: SceneSurroundings, env: int, k: int, done: Substep):  # noqa: ARG001 (all hooks have the same)
        x, q, v, w = contact_motion(around, 0, env, done)
        return x, q, v, w

    @wp.func
    def contact_with_moving(data: DynamicSurroundings, env: int, k: int, done: Substep):  # noqa: ARG001
        x, q, v, w = contact_motion(data.around, data.obstacles, env, done)
        return x, q, v, w

    return (DynamicSurroundings, contact_with_moving) if moves else (SceneSurroundings, contact_with_fixed)


@cache
def _make_contact_kernel(*, moves: bool, cores: bool, meshes: bool) -> wp.Kernel:
    """Return the kernel of one substep, for backends that are no kernel themselves."""
    data_type, contact_motion = _make_hook(moves=moves, cores=cores, meshes=meshes)

    @wp.kernel(module="unique", enable_backward=False)
    def change_motion(
        data: data_type,  # read and written
        # params
        mass: wp.array[float],  # (E,) [kg]
        inertia: wp.array[wp.mat33],  # (E,) about the centre of mass, body [kg m²]
        com: wp.array[wp.vec3],  # (E,) from the body origin, body [m]
        # state
        first_position: wp.array[wp.vec3],  # (E,) of the centre of mass at the start of the substep, world [m]
        first_attitude: wp.array[wp.quat],  # (E,) body to world, xyzw, likewise
        first_lin_vel: wp.array[wp.vec3],  # (E,) of the centre of mass at the start of the substep, world [m/s]
        first_ang_vel: wp.array[wp.vec3],  # (E,) likewise, body [rad/s]
        dt: float,  # [s]
        # out
        position_out: wp.array[wp.vec3],  # (E,) body origin, world [m]; read, and written where something touches
        attitude_out: wp.array[wp.quat],  # (E,) body to world, xyzw
        lin_vel_out: wp.array[wp.vec3],  # (E,) world [m/s]
        ang_vel_out: wp.array[wp.vec3],  # (E,) body [rad/s]
    ):
        """Change the motion of the robots that overlap obstacles."""
        env = wp.tid()
        q = attitude_out[env]
        w = ang_vel_out[env]
        c = com[env]
        done = Substep()
        done.dt = dt
        done.mass = mass[env]
        done.inertia = inertia[env]
        done.com = c
        done.first_position = first_position[env]
        done.first_attitude = first_attitude[env]
        done.first_lin_vel = first_lin_vel[env]
        done.first_ang_vel = first_ang_vel[env]
        done.position = position_out[env] + rotate(q, c)
        done.attitude = q
        done.lin_vel = lin_vel_out[env] + rotate(q, wp.cross(w, c))
        done.ang_vel = w
        next_x, next_q, next_v, next_w = contact_motion(data, env, 0, done)
        pushed = wp.length(next_v - done.lin_vel) + wp.length(next_w - w)
        if pushed + wp.length(next_x - done.position) == 0.0:
            return  # bit for bit as it was
        position_out[env] = next_x - rotate(next_q, c)
        attitude_out[env] = next_q
        lin_vel_out[env] = next_v - rotate(next_q, wp.cross(next_w, c))
        ang_vel_out[env] = next_w

    return change_motion


@dataclass(frozen=True, kw_only=True)
class ContactBody:
    """Tensors of the robot in contact; they keep their memory."""

    mass: Tensor  # [kg], (E,)
    inertia: Tensor  # About the centre of mass [kg m²], body, (E, 3, 3)
    com: Tensor  # Centre of mass from the body origin [m], body, (E, 3)
    spheres: Tensor  # Contact points: centres in the body frame and radii [m], (C, 4)
    shapes: tuple[CollisionShape, ...] = ()  # Shapes with these contact points; none for spheres alone
    in_fluid: bool = False  # Whether it has added mass


class SceneContact:
    """Contact of one robot per environment with the obstacles, with all views made at construction; a ``SubstepHook``."""

    max_substeps: int | None = None  # Any number

    def __init__(
        self, scene: Scene, cfg: ContactCfg, robot: ContactBody, state: BodyState, *, integrator: str, dt: float,
        crashes_out: Tensor, impulse_out: Tensor, moving: "Obstacles | None" = None,
    ) -> None:  # fmt: skip
        """Take views of the tensors, which must stay where they are.

        Args:
            state: Its motion, written in place where it touches something.
            crashes_out: Set, bool, (E,), where it touches at the speed of a crash; never cleared here.
            impulse_out: Receives the sum of the impulses [N s], world, (E, 3); never cleared here.
            moving: The instances of the scene as they move; None if nothing moves.
        """
        envs, device = (scene.num_envs,), scene.device
        check_tensor("crashes_out", crashes_out, envs, device=device, dtype=torch.bool)
        self._scene, self._robot, self._state, self._dt = scene, robot, state, dt
        self._first = [torch.zeros_like(getattr(state, name)) for name in _FIRST_MOTION]
        self._data = around = make_struct(
            SceneSurroundings,
            near=contact_scene(scene, robot.spheres, robot.shapes),
            law=contact_parameters(cfg, displacement_per_velocity_change(integrator, in_fluid=robot.in_fluid)),
            crashes=crashes_out,
            impulse=vector_view("impulse_out", impulse_out, (*envs, 3), device=device),
        )
        if moving is not None:
            self._data = make_struct(DynamicSurroundings, around=around, obstacles=moving)
        self._kinds = {
            "moves": moving is not None,
            "cores": has_boxes_or_capsules(robot.shapes),
            "meshes": scene.has_meshes,
        }
        self._kept_alive = (crashes_out, impulse_out, moving)
        self._command: ReusableLaunch | None = None

    def fused(self) -> FusedHook:
        """Return this hook as Warp code for a fused kernel."""
        struct, function = _make_hook(**self._kinds)
        return FusedHook(struct, self._data, function)

    def begin(self, state: BodyState) -> None:
        """Do nothing, as contact needs only the motion before its own substep."""

    def after_substep(self, k: int, before: MassState, state: BodyState) -> None:
        """Move the obstacles and apply contact to robots; launched on torch's current stream, not waited for."""
        if state is not self._state:
            raise ShapeError("SceneContact: pushes the robots of another state. Make one for this state")
        for kept, name in zip(self._first, _FIRST_MOTION, strict=True):
            kept.copy_(getattr(before, name))
        if self._command is None:
            self._command = self._record_launch()
        self._command.launch(self._state.lin_vel)

    def _record_launch(self) -> ReusableLaunch:
        scene, robot, state = self._scene, self._robot, self._state
        for name, size in (("mass", ()), ("inertia", (3, 3)), ("com", (3,))):
            check_tensor(name, getattr(robot, name), (scene.num_envs, *size), device=scene.device)
        return ReusableLaunch(
            _make_contact_kernel(**self._kinds),
            dim=scene.num_envs,
            inputs=[self._data, robot.mass, robot.inertia, robot.com, *self._first, self._dt],
            outputs=[state.position, state.attitude, state.lin_vel, state.ang_vel],
            device=scene.device,
        )
