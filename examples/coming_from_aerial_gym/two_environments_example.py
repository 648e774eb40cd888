"""Two simulations of other sizes, robots and worlds in one process; there the second changes the first one's configuration."""

import isaacgym
import torch

from aerial_gym.sim.sim_builder import SimBuilder
from aerial_gym.utils.helpers import get_args
from aerial_gym.utils.logging import CustomLogger

logger = CustomLogger(__name__)

if __name__ == "__main__":
    args = get_args([{"name": "--num_steps", "type": int, "default": 600, "help": "steps of each simulation"}])
    torch.manual_seed(11)
    common = {"controller_name": "lee_position_control", "args": None, "device": args.sim_device, "headless": True}
    open_air = SimBuilder().build_env(
        sim_name="base_sim",
        env_name="empty_env",
        robot_name="base_quadrotor",
        num_envs=args.num_envs,
        use_warp=False,
        **common,
    )
    hall = SimBuilder().build_env(
        sim_name="base_sim_headless",
        env_name="env_with_obstacles",
        robot_name="base_quadrotor_with_imu",
        num_envs=2 * args.num_envs,
        use_warp=True,
        **common,
    )
    open_air.reset()
    hall.reset()
    goals = {env: torch.zeros((env.num_envs, 4), device=args.sim_device) for env in (open_air, hall)}
    start = hall.global_tensor_dict["robot_position"].clone()
    goals[hall][:, 0:3] = start  # hover where the episode began
    for _ in range(args.num_steps):
        for env, goal in goals.items():
            env.step(actions=goal)
    distance = open_air.global_tensor_dict["robot_position"].norm(dim=1)
    drift = (hall.global_tensor_dict["robot_position"] - start).norm(dim=1)
    acceleration = hall.global_tensor_dict["imu_measurement"][:, 2]
    logger.warning(
        f"{open_air.num_envs} robots {distance.max().item():.3f} m from the origin, {hall.num_envs} robots "
        f"{drift.max().item():.3f} m from their starts between {hall.IGE_env.num_assets_per_env} obstacles"
    )
