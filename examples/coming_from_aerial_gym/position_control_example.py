"""Quadrotors fly to set points that change from time to time: a script as users of the Aerial Gym Simulator write it."""

import isaacgym  # there it must come before torch
import torch

from aerial_gym.sim.sim_builder import SimBuilder
from aerial_gym.utils.helpers import get_args
from aerial_gym.utils.logging import CustomLogger

logger = CustomLogger(__name__)

if __name__ == "__main__":
    args = get_args([{"name": "--num_steps", "type": int, "default": 2000, "help": "steps of the simulation"}])
    logger.print_example_message()
    torch.manual_seed(7)
    env_manager = SimBuilder().build_env(
        sim_name="base_sim",
        env_name="empty_env",
        robot_name="base_quadrotor",
        controller_name="lee_position_control",
        args=None,
        device=args.sim_device,
        num_envs=args.num_envs,
        headless=args.headless,
        use_warp=args.use_warp,
    )
    tensors = env_manager.global_tensor_dict
    commands = torch.zeros((env_manager.num_envs, 4), device=args.sim_device)  # x, y, z [m], yaw [rad]
    env_manager.reset()
    for step in range(args.num_steps):
        if step % 500 == 0:
            commands[:, 0:3] = torch.rand((env_manager.num_envs, 3), device=args.sim_device) - 0.5
            commands[:, 3] = torch.pi * (torch.rand(env_manager.num_envs, device=args.sim_device) - 0.5)
        env_manager.step(actions=commands)
    position_error = (tensors["robot_position"] - commands[:, 0:3]).norm(dim=1)
    yaw_error = tensors["robot_euler_angles"][:, 2] - commands[:, 3]
    logger.warning(f"{args.num_steps} steps, largest distance to the set point {position_error.max().item():.3f} m")
