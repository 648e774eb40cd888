"""The loop of a learning algorithm around a registered task, in the manner of the Aerial Gym Simulator."""

import isaacgym
import torch

from aerial_gym.registry.task_registry import task_registry
from aerial_gym.utils.helpers import get_args
from aerial_gym.utils.logging import CustomLogger

logger = CustomLogger(__name__)

if __name__ == "__main__":
    args = get_args([{"name": "--num_steps", "type": int, "default": 1000, "help": "steps of the task"}])
    rl_task_env = task_registry.make_task(
        "position_setpoint_task", seed=5, num_envs=args.num_envs, headless=args.headless
    )
    rl_task_env.reset()
    num_actions = rl_task_env.sim_env.robot_manager.robot.controller_config.num_actions
    actions = torch.zeros((rl_task_env.sim_env.num_envs, num_actions), device=rl_task_env.device)
    episodes, total = 0, torch.zeros(args.num_envs, device=rl_task_env.device)
    with torch.no_grad():
        for _ in range(args.num_steps):
            obs, reward, terminated, truncated, info = rl_task_env.step(actions=actions)
            actions[:, 1] = 0.1 * torch.tanh(obs["observations"][:, 1])  # a policy would stand here
            total += reward
            episodes += (terminated | truncated).sum().item()
    logger.warning(
        f"{args.num_steps} steps, {episodes} episodes, mean reward {total.mean().item() / args.num_steps:.2f}"
    )
