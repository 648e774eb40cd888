"""Learn to hover with skrl.

usage: python examples/other_libraries/with_skrl.py [--num-envs 1024] [--iterations 100] [--device auto] [--out runs/skrl]
"""

from pathlib import Path

import tyro
from skrl.utils.runner.torch import Runner

from aerial_gym import task_registry
from aerial_gym.rl_training import save_policy
from aerial_gym.rl_training.adapters.skrl import SkrlEnv

HORIZON = 32


def main(num_envs: int = 1024, iterations: int = 100, device: str = "auto", out: Path = Path("runs/skrl")) -> None:
    """Train, and leave checkpoints and TensorBoard files in ``out``."""
    layers = [{"name": "net", "input": "OBSERVATIONS", "layers": [64, 64], "activations": "elu"}]
    settings = {
        "seed": 0,
        "models": {
            "separate": True,
            "policy": {"class": "GaussianMixin", "network": layers, "output": "ACTIONS", "initial_log_std": -0.2},
            "value": {"class": "DeterministicMixin", "network": layers, "output": "ONE"},
        },
        "memory": {"class": "RandomMemory", "memory_size": -1},
        "agent": {
            "class": "PPO",
            "rollouts": HORIZON,
            "learning_epochs": 4,
            "mini_batches": 8,
            "learning_rate": 1e-3,
            "gae_lambda": 0.98,
            "grad_norm_clip": 1.0,
            "value_loss_scale": 1.0,
            "time_limit_bootstrap": True,
            "rewards_shaper_scale": 0.1,
            "experiment": {
                "directory": str(out.parent),
                "experiment_name": out.name,
                "write_interval": HORIZON,
                "checkpoint_interval": HORIZON * iterations,
            },
        },
        "trainer": {
            "class": "SequentialTrainer",
            "timesteps": HORIZON * iterations,
            "close_environment_at_exit": False,
        },
    }
    with task_registry.make_task("position_setpoint_task", num_envs=num_envs, device=device, seed=0) as task:
        runner = Runner(SkrlEnv(task), settings)
        runner.run("train")
        save_policy(runner.agent, out, task="position_setpoint_task")
        print("mean distance [m]", float((task.env.gtd["robot_position"] - task.target_position).norm(dim=1).mean()))


if __name__ == "__main__":
    tyro.cli(main)
