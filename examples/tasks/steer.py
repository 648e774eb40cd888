"""Choice of a direction between obstacles from the cells of an image. Letters: E environments, R x C cells, N = R C."""

from collections.abc import Callable

import torch
from torch import Tensor
from torch.nn.functional import max_pool2d, pad

from aerial_gym import task_registry
from aerial_gym.rl_training import evaluate
from aerial_gym.rl_training.policies.policy import Pilot
from aerial_gym.task import Task

PRICE, NEAR = (
    2.0,
    1.0,
)  # of what is close, and the distance [m] at which it is 1 / e: the best of a few on seed 1 of navigation


def choose(looks: Tensor, nearest: Tensor, goal: Tensor, *, turns: bool) -> tuple[Tensor, Tensor]:
    """Return the chosen cell, (E,), and the free distance in its direction [m], (E,).

    It is the one nearest to the direction of the goal, less ``PRICE exp(-d / NEAR)``, d the least distance in it and around it.

    Args:
        looks: Unit vectors to the cells, (E or 1, N, 3), in the frame of ``goal``.
        nearest: Smallest distance in each cell [m], (E, R, C).
        goal: Unit vector to the goal, (E, 3).
        turns: Whether the last column lies beside the first; else nothing is known to be free beyond the edges.
    """
    wide = torch.cat((nearest[..., -1:], nearest, nearest[..., :1]), dim=-1) if turns else pad(nearest, (1, 1))
    tall = pad(wide, (0, 0, 1, 1), value=float("inf"))
    free = -max_pool2d(-tall.unsqueeze(1), 3, stride=1).flatten(1)
    score = (looks * goal.unsqueeze(1)).sum(-1) - PRICE * torch.exp(-free / NEAR)
    best = score.argmax(-1)
    return best, free.gather(1, best.unsqueeze(-1)).squeeze(-1)


def fly(name: str, pilot: Callable[[Task], Pilot], *, starts: int, robot: str | None = None) -> None:
    """Fly a task among the fewest and the most obstacles of its curriculum, and print how it ends."""
    limits = task_registry.get(name).curriculum
    assert limits is not None
    for level in (limits.min_level, limits.max_level):
        with task_registry.make_task(name, num_envs=starts, robot=robot, device="cpu", seed=2, level=level) as task:
            result = evaluate(pilot(task), task)
        told = f"{result.success_rate:.1%} arrive, {result.crash_rate:.1%} crash"
        print(f"{name}, {level} obstacles: {told}, of {starts} flights of {result.episode_s:.0f} s")
