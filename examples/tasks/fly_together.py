"""Several vehicles without learning: ``python examples/tasks/fly_together.py [ENVIRONMENTS [TASK ...]]``.

Every vehicle flies straight towards its target and sees nothing of the others. Prints the share of vehicles that touched
another one, that crashed otherwise, and that reached the goal of the task [%].
"""

import sys
from collections.abc import Sequence

import torch

from aerial_gym import task_registry

TASKS = (
    "formation_task",
    "tunnel_swap_task",
    "pursuit_task",
    "forest_flight_task",
    "team_payload_task",
    "race_of_four_task",
)


def main(num_envs: int, tasks: Sequence[str]) -> None:
    """Fly the tasks for an episode, print a line for each."""
    for name in tasks:
        with task_registry.make_task(name, num_envs=num_envs, device="cpu", seed=1) as task:
            task.reset()
            ended = torch.zeros(3, task.num_envs, dtype=torch.bool)
            done = torch.zeros(task.num_envs, dtype=torch.bool)
            for _ in range(task.cfg.episode_len_steps):
                away = task.target_position - task.env.rows.bodies["robot_position"]
                action = torch.zeros(task.num_envs, task.num_actions)
                action[:, :3] = torch.nn.functional.normalize(away, dim=-1) * away.norm(dim=-1, keepdim=True).clamp_max(
                    1.0
                )
                _, _, terminated, truncated, info = task.step(action)
                result = torch.stack([info["collisions"], info["crashes"] & ~info["collisions"], info["successes"]])
                ended |= result & ~done
                done |= terminated | truncated
            touched, crashed, arrived = (100.0 * ended.float().mean(dim=1)).tolist()
            print(
                f"{name}: {touched:.0f} % touched another vehicle, {crashed:.0f} % crashed otherwise, {arrived:.0f} % succeeded"
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 16, sys.argv[2:] or TASKS)
