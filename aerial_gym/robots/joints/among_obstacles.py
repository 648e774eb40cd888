"""Obstacles around a robot that bends, where an engine finds the contacts itself: they move, and fast touches are crashes.

A ``SubstepHook``: after each substep the obstacles move by it, and every link is looked at as ``scene_contact`` looks at a
rigid body. What approaches is taken at the speeds of that instant: a touch is found at the end of a substep, and pushes from
the next on.
Frames: world, z up; shapes in the frames of their links. Letters: E environments, L links.
"""

from typing import NoReturn

import torch
import warp as wp
from torch import Tensor

from aerial_gym.assets import Scene
from aerial_gym.assets.body_shapes import BodyShape, body_shapes
from aerial_gym.assets.cores import contact_points
from aerial_gym.assets.motion import moving_on
from aerial_gym.assets.obstacles import Obstacles
from aerial_gym.assets.scene_arrays import SceneArrays
from aerial_gym.config.contact import ContactCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import CapabilityError
from aerial_gym.interop import RecordedLaunch, on_torch_stream
from aerial_gym.physics.integrators import MassState
from aerial_gym.physics.state import BodyState, JointedState
from aerial_gym.robots.joints.link_tensors import LinkTensors
from aerial_gym.robots.joints.links import LinkPlaces
from aerial_gym.robots.touching_pairs import SceneMotion, add_cores, come_fast, find_pairs, scene_motion


@wp.kernel(enable_backward=False)
def _notice(
    # scene
    scene: SceneArrays,
    motion: SceneMotion,
    # params
    sphere: wp.array[wp.vec4],  # (C,) contact points of the link: centre in its frame, radius [m]
    body: wp.array[BodyShape],  # its shapes
    least_approach: float,  # [m/s]
    # state
    position: wp.array[wp.vec3],  # (E,) of the link's frame, world [m]
    attitude: wp.array[wp.quat],  # (E,) link to world, xyzw
    lin_vel: wp.array[wp.vec3],  # (E,) world [m/s]
    ang_vel: wp.array[wp.vec3],  # (E,) world [rad/s]
    # out
    crashes_out: wp.array[wp.bool],  # (E,) set where the link touches something fast
):
    """Say of one link of each environment whether it touches an obstacle at the speed of a crash."""
    e = wp.tid()
    x = position[e]
    q = attitude[e]
    pairs = find_pairs(scene, motion, sphere, wp.vec3(), e, x, q)
    pairs = add_cores(pairs, scene, motion, body, wp.vec3(), e, x, q)
    if come_fast(pairs, lin_vel[e], ang_vel[e], least_approach):
        crashes_out[e] = True


class LinksAmongObstacles:
    """Moves obstacles and notices crashes; a ``SubstepHook``."""

    max_substeps: int | None = None
    """Any number."""

    def __init__(
        self,
        scene: Scene,
        cfg: ContactCfg,
        robot: RobotCfg,
        state: BodyState,
        links: LinkTensors,
        *,
        dt: float,
        crashes_out: Tensor,
        moving: "Obstacles | None" = None,
    ) -> None:
        """Take views of the tensors, which must stay where they are.

        Args:
            cfg: Says which touch is a crash.
            links: Receives where its links are after each substep.
            dt: Length of a substep [s].
            crashes_out: Set, bool, (E,), where it touches at the speed of a crash; never cleared here.
            moving: The instances of the scene as they move; None if nothing moves.
        """
        assert robot.joints is not None
        assert isinstance(state, JointedState)
        self._places, self._stream = LinkPlaces(robot.joints, state, links, None), crashes_out
        self._move = None if moving is None else moving_on(moving, dt)
        self._kept_alive = (scene, links, moving)
        self._looks: list[RecordedLaunch] = []
        for number, name in enumerate(links.names):
            shapes = robot.collision.on(name)
            if not shapes:
                continue
            own, points = links.state[:, number], contact_points(shapes, device=scene.device)
            seen = [scene.arrays, scene_motion(scene), points, body_shapes(shapes, device=scene.device)]
            inputs = [*seen, cfg.least_approach, *own.split((3, 4, 3, 3), dim=-1)]
            look = {"dim": scene.num_envs, "inputs": inputs, "outputs": [crashes_out], "device": scene.device}
            self._looks.append(RecordedLaunch(_notice, **look))

    def begin(self, state: BodyState) -> None:
        """Do nothing: each look needs the present links alone."""

    @torch.no_grad()
    def after_substep(self, k: int, before: MassState, state: BodyState) -> None:
        """Move the obstacles, and look at all links; launched on torch's current stream, not waited for."""
        del k, before, state
        self._places.refresh()
        with on_torch_stream(self._stream):
            if self._move is not None:
                self._move.launch()
            for look in self._looks:
                look.launch()

    def fused(self) -> NoReturn:
        """Raise ``CapabilityError``: fused kernels find no contacts of links."""
        raise CapabilityError("obstacles do not push links in a fused kernel. Use backend 'mujoco'")
