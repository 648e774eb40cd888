"""Learn to hover with Stable-Baselines3.

usage: python examples/other_libraries/with_stable_baselines3.py [--num-envs 256] [--iterations 100] [--device auto]
    [--out runs/sb3]
"""

from pathlib import Path

import tyro
from stable_baselines3 import PPO

from aerial_gym import task_registry
from aerial_gym.rl_training import save_policy
from aerial_gym.rl_training.adapters.stable_baselines3 import Sb3Env

HORIZON = 32


def main(num_envs: int = 256, iterations: int = 100, device: str = "auto", out: Path = Path("runs/sb3")) -> None:
    """Train, and leave the policy in ``out``/model.zip; networks of this size learn fastest on the CPU."""
    with task_registry.make_task("position_setpoint_task", num_envs=num_envs, device=device, seed=0) as task:
        learner = PPO(
            "MlpPolicy",
            Sb3Env(task),
            n_steps=HORIZON,
            batch_size=num_envs * HORIZON // 8,
            n_epochs=4,
            learning_rate=1e-3,
            gae_lambda=0.98,
            device="cpu",
            seed=0,
            verbose=1,
        )
        learner.learn(num_envs * HORIZON * iterations)
        learner.save(out / "model")
        save_policy(learner, out, task="position_setpoint_task")
        print("mean distance [m]", float((task.env.gtd["robot_position"] - task.target_position).norm(dim=1).mean()))


if __name__ == "__main__":
    tyro.cli(main)
