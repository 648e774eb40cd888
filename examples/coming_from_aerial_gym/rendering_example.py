"""Surface normals and faces as a camera sees them in a forest, saved as pictures: a script for the Aerial Gym Simulator."""

from isaacgym import gymapi, gymutil
import os

import numpy as np
import torch
from PIL import Image

from aerial_gym.config.robot_config.base_quad_config import BaseQuadWithFaceIDNormalCameraCfg
from aerial_gym.config.sensor_config.camera_config.base_normal_faceID_camera_config import BaseNormalFaceIDCameraConfig
from aerial_gym.registry.robot_registry import robot_registry
from aerial_gym.robots.base_multirotor import BaseMultirotor
from aerial_gym.sim.sim_builder import SimBuilder
from aerial_gym.utils.helpers import get_args
from aerial_gym.utils.logging import CustomLogger

logger = CustomLogger(__name__)


class SmallNormalCamera(BaseNormalFaceIDCameraConfig):
    height = 54
    width = 96
    normal_in_world_frame = True


class QuadWithSmallNormalCamera(BaseQuadWithFaceIDNormalCameraCfg):
    class sensor_config(BaseQuadWithFaceIDNormalCameraCfg.sensor_config):
        camera_config = SmallNormalCamera


if __name__ == "__main__":
    args = get_args(
        [
            {"name": "--num_steps", "type": int, "default": 100, "help": "steps of the simulation"},
            {"name": "--out", "type": str, "default": "normals", "help": "folder of the pictures"},
        ]
    )
    robot_registry.register("quad_with_small_normal_camera", BaseMultirotor, QuadWithSmallNormalCamera)
    env_manager = SimBuilder().build_env(
        sim_name="base_sim",
        env_name="forest_env",
        robot_name="quad_with_small_normal_camera",
        controller_name="lee_velocity_control",
        args=None,
        device=args.sim_device,
        num_envs=args.num_envs,
        headless=True,
        use_warp=True,
    )
    os.makedirs(args.out, exist_ok=True)
    commands = torch.zeros((env_manager.num_envs, 4), device=args.sim_device)
    commands[:, 0] = 1.0  # forward
    env_manager.reset()
    for step in range(args.num_steps):
        env_manager.step(actions=commands)
        env_manager.render(render_components="sensors")
        env_manager.reset_terminated_and_truncated_envs()
        normals = env_manager.global_tensor_dict["depth_range_pixels"][0, 0].cpu().numpy()  # (H, W, 3), unit or 0
        faces = env_manager.global_tensor_dict["segmentation_pixels"][0, 0].cpu().numpy()  # (H, W), -1 for nothing
        Image.fromarray((127.5 * (normals + 1.0)).astype(np.uint8)).save(f"{args.out}/normals_{step:04d}.png")
        Image.fromarray(((faces % 11 + 1) * 21 % 256).astype(np.uint8)).save(f"{args.out}/faces_{step:04d}.png")
    logger.warning(f"{2 * args.num_steps} pictures in {args.out}")
