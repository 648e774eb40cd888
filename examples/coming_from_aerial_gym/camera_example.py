"""A stream of depth and segmentation images, saved as a moving picture: a script for the Aerial Gym Simulator."""

import isaacgym
import torch
from PIL import Image

from aerial_gym.config.robot_config.base_quad_config import BaseQuadWithCameraCfg
from aerial_gym.config.sensor_config.camera_config.base_depth_camera_config import BaseDepthCameraConfig
from aerial_gym.registry.robot_registry import robot_registry
from aerial_gym.robots import BaseMultirotor
from aerial_gym.sim.sim_builder import SimBuilder
from aerial_gym.utils.helpers import get_args
from aerial_gym.utils.logging import CustomLogger

logger = CustomLogger(__name__)


class SmallDepthCamera(BaseDepthCameraConfig):
    height = 54
    width = 96
    max_range = 8.0
    segmentation_camera = True
    normalize_range = True


class CameraQuadCfg(BaseQuadWithCameraCfg):
    class sensor_config(BaseQuadWithCameraCfg.sensor_config):
        enable_camera = True
        camera_config = SmallDepthCamera


if __name__ == "__main__":
    args = get_args(
        [
            {"name": "--num_steps", "type": int, "default": 100, "help": "steps of the simulation"},
            {"name": "--out", "type": str, "default": "stream.gif", "help": "moving picture of the first robot"},
        ]
    )
    torch.manual_seed(3)
    robot_registry.register("quad_with_small_depth_camera", BaseMultirotor, CameraQuadCfg)
    env_manager = SimBuilder().build_env(
        sim_name="base_sim",
        env_name="env_with_obstacles",
        robot_name="quad_with_small_depth_camera",
        controller_name="lee_velocity_control",
        args=None,
        device=args.sim_device,
        num_envs=args.num_envs,
        headless=True,
        use_warp=True,
    )
    env_manager.reset()
    tensors = env_manager.get_obs()
    commands = torch.zeros((env_manager.num_envs, 4), device=args.sim_device)
    frames, seen = [], set()
    for step in range(args.num_steps):
        commands[:, 0] = 1.0
        commands[:, 3] = 0.5 if step % 40 < 20 else -0.5
        env_manager.step(actions=commands)
        env_manager.render(render_components="sensors")
        env_manager.reset_terminated_and_truncated_envs()
        depth = tensors["depth_range_pixels"][0, 0].clamp(0.0, 1.0)  # divided by the range; too near is -1
        labels = tensors["segmentation_pixels"][0, 0]  # -2 for nothing
        seen.update(labels.unique().tolist())
        picture = torch.cat((255.0 * depth, (labels + 2).clamp(max=255).float()), dim=0)
        frames.append(Image.fromarray(picture.byte().cpu().numpy()))
    frames[0].save(args.out, save_all=True, append_images=frames[1:], duration=100, loop=0)
    logger.warning(f"{len(frames)} frames in {args.out}; labels {sorted(seen)}")
