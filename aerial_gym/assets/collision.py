"""The collision test: how far the robot's spheres are from the scene.

Frames: sphere centres in the body frame, poses in the environment's world frame. Letters: E environments, C spheres.
"""

from collections.abc import Sequence

import torch
import warp as wp
from torch import Tensor

from aerial_gym.assets.scene import Scene
from aerial_gym.assets.scene_arrays import SceneArrays, scene_distance
from aerial_gym.assets.views import check_tensor, vector_view
from aerial_gym.config.robot import SphereCfg
from aerial_gym.interop import on_torch_stream


@wp.kernel(enable_backward=False)
def _measure_clearance(
    # scene
    scene: SceneArrays,
    # state
    position: wp.array[wp.vec3],  # (E,) world [m]
    attitude: wp.array[wp.quat],  # (E,) body to world, xyzw
    # params
    sphere: wp.array[wp.vec4],  # (C,) centre in the body frame, radius [m]
    # out
    distance_out: wp.array[float],  # (E,) [m]
    crashes_out: wp.array[wp.bool],  # (E,)
):
    """Write the smallest signed distance between a sphere and an instance (inf if there is none) and whether it is < 0."""
    env = wp.tid()
    nearest = float(wp.inf)
    for c in range(sphere.shape[0]):
        center = wp.vec3(sphere[c][0], sphere[c][1], sphere[c][2])
        radius = sphere[c][3]
        point = position[env] + wp.quat_rotate(attitude[env], center)
        nearest = wp.min(nearest, scene_distance(scene, env, point, nearest + radius) - radius)
    distance_out[env] = nearest
    crashes_out[env] = nearest < 0.0


class CollisionTest:
    """Signed distance of one robot per environment to the scene, with all views made at construction."""

    def __init__(
        self,
        scene: Scene,
        spheres: Sequence[SphereCfg],
        *,
        position: Tensor,
        attitude: Tensor,
        distance_out: Tensor,
        crashes_out: Tensor,
    ) -> None:
        """Take views of the tensors, which must stay where they are.

        Args:
            scene: What must not be touched.
            spheres: The robot's collision shapes; none makes every distance infinite.
            position: Body origin [m], world, (E, 3); may be strided, but for the last axis.
            attitude: Body to world, xyzw, unit, (E, 4); likewise.
            distance_out: Receives the smallest signed distance [m], negative where they overlap, inf where there is
                nothing to touch, float32, (E,).
            crashes_out: Receives ``distance < 0``, bool, (E,).

        Raises:
            ShapeError: If a tensor does not fit the scene.
        """
        envs, device = (scene.num_envs,), scene.device
        check_tensor("distance_out", distance_out, envs, device=device)
        check_tensor("crashes_out", crashes_out, envs, device=device, dtype=torch.bool)
        rows = torch.tensor([(*s.center, s.radius) for s in spheres], dtype=torch.float32, device=device).view(-1, 4)
        self._out = distance_out
        self.has_solids = scene.num_solid > 0
        """Whether there is anything to touch."""
        self._inputs = [
            scene.arrays,
            vector_view("position", position, (*envs, 3), device=device),
            vector_view("attitude", attitude, (*envs, 4), device=device),
            wp.from_torch(rows, dtype=wp.vec4),
        ]
        self._outputs = [wp.from_torch(distance_out), wp.from_torch(crashes_out)]
        self._command = wp.launch(
            _measure_clearance,
            dim=scene.num_envs,
            inputs=self._inputs,
            outputs=self._outputs,
            device=wp.device_from_torch(device),
            record_cmd=True,
        )

    def measure(self) -> None:
        """Write distances and crashes of the present poses; launched on torch's current stream, not waited for."""
        with on_torch_stream(self._out):
            self._command.launch()
