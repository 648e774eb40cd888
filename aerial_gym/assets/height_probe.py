"""Height of the surface below each robot: one vertical ray against all solid parts.

Frames: world of each environment, z up. Letters: B vehicles of all environments.
"""

import warp as wp
from torch import Tensor

from aerial_gym.assets.part_rays import ray_distance_to_part
from aerial_gym.assets.scene import Scene
from aerial_gym.assets.scene_arrays import SceneArrays, check_tensor, part_is_present, vector_view
from aerial_gym.interop import ReusableLaunch

FARTHEST = wp.constant(1.0e4)  # Length of the ray [m]; surfaces beyond it are ignored


@wp.kernel(enable_backward=False)
def _measure_height(
    # scene
    scene: SceneArrays,
    # state
    position: wp.array[wp.vec3],  # (B,) world [m]
    # params
    vehicles: int,  # in an environment
    # out
    height_out: wp.array[float],  # (B,) world [m]
):
    """Write the height of the first surface below each position, or of the ray's end without one."""
    own = wp.tid()
    env = own // vehicles
    start = position[own]
    way = float(FARTHEST)
    for part in range(scene.num_solid):
        if part_is_present(scene, env, part):
            way = ray_distance_to_part(scene, env, part, start, wp.vec3(0.0, 0.0, -1.0), way)
    height_out[own] = start[2] - way


class HeightProbe:
    """Vertical rays down from the body origins; all views are made at construction."""

    def __init__(self, scene: Scene, *, position: Tensor, height_out: Tensor) -> None:
        """Take views of the tensors, which must stay where they are.

        Args:
            height_out: Receives the height of the first surface below [m], world, ``FARTHEST`` below where there is none,
                float32, (B, 1).
        """
        count, vehicles = len(position), len(position) // scene.num_envs
        check_tensor("height_out", height_out, (count, 1), device=scene.device)
        height_out.fill_(-float(FARTHEST))
        self._kept_alive, self._out = scene, height_out
        self._launch = ReusableLaunch(
            _measure_height,
            dim=count,
            inputs=[scene.arrays, vector_view("position", position, (count, 3), device=scene.device), vehicles],
            outputs=[height_out.view(-1)],
            device=scene.device,
        )

    def measure_heights(self) -> None:
        """Launch the measurement of heights on torch's current stream."""
        self._launch.launch(self._out)
