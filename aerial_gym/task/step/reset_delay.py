"""Resets one step after the end of an episode, as Gymnasium's mode NEXT_STEP wants them.

The step in between belongs to no episode: it has no reward, no end, and no place in the tallies.
Letters: E environments.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from aerial_gym.math.random import Randomness
from aerial_gym.task.step.judge import FLAGS, Judge

WAITING = "waiting"  # Buffer of environments whose reset is due in the next step


@dataclass(frozen=True)
class ResetDelay:
    """Judges steps, and delays the resets of ended environments by one."""

    judge: Judge
    random: Randomness
    waiting: Tensor  # Whether the episode ended in the last step, bool (E,)

    def __call__(self) -> dict[str, Tensor]:
        """Return the judgement of a step; its ``due`` says which environments must be reset now, bool (E,)."""
        buffers, due = self.judge.buffers, self.waiting.clone()
        before = {name: tensor.clone() for name, tensor in buffers.items()}
        judged = self.judge()
        ended = judged["ended"] & ~due
        for name, tensor in buffers.items():
            rows = due.view(-1, *[1] * (tensor.ndim - 1))
            tensor.copy_(torch.where(rows, before[name], tensor))
        self.random.episode.copy_(before["episodes"])  # the reset counts the next one
        self.waiting.copy_(ended)
        flags = {name: judged[name] & ~due for name in FLAGS}
        return judged | flags | {"ended": ended, "due": due, "reward": torch.where(due, 0.0, judged["reward"])}
