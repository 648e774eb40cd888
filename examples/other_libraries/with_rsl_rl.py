"""Learn to hover with rsl_rl (the package rsl-rl-lib).

usage: python examples/other_libraries/with_rsl_rl.py [--num-envs 1024] [--iterations 100] [--device auto] [--out runs/rsl_rl]
"""

from pathlib import Path

import torch
import tyro
from rsl_rl.runners import OnPolicyRunner

from aerial_gym import task_registry
from aerial_gym.rl_training import save_policy
from aerial_gym.rl_training.adapters.rsl_rl import RslRlEnv


def main(num_envs: int = 1024, iterations: int = 100, device: str = "auto", out: Path = Path("runs/rsl_rl")) -> None:
    """Train, and leave checkpoints and TensorBoard files in ``out``."""
    torch.manual_seed(0)
    network = {"class_name": "MLPModel", "hidden_dims": [64, 64], "activation": "elu"}
    noise = {"class_name": "GaussianDistribution", "init_std": 0.8}
    settings = {
        "num_steps_per_env": 32,
        "save_interval": iterations,
        "logger": "tensorboard",
        "obs_groups": {"actor": ["observations"], "critic": ["observations"]},
        "actor": network | {"distribution_cfg": noise},
        "critic": network,
        "algorithm": {
            "class_name": "PPO",
            "num_learning_epochs": 4,
            "num_mini_batches": 8,
            "learning_rate": 1e-3,
            "schedule": "adaptive",
            "desired_kl": 0.016,
            "gamma": 0.99,
            "lam": 0.98,
            "max_grad_norm": 1.0,
        },
    }
    with task_registry.make_task("position_setpoint_task", num_envs=num_envs, device=device, seed=0) as task:
        runner = OnPolicyRunner(RslRlEnv(task), settings, str(out), device=str(task.device))
        runner.learn(iterations)
        save_policy(runner, out, task="position_setpoint_task")
        print("mean distance [m]", float((task.env.gtd["robot_position"] - task.target_position).norm(dim=1).mean()))


if __name__ == "__main__":
    tyro.cli(main)
