"""Ends and rewards that the vehicles of an environment share, in environments with ``reset_together``.

A crash or time-out of one vehicle is that of all; a success is one of all vehicles at the same time, unless its termination
says otherwise. Letters: E environments, V vehicles of each, B = E V rows, K terminations, T terms of the reward.
"""

from collections.abc import Callable, Mapping, Sequence

import torch
from torch import Tensor

from aerial_gym.task.kernels.vehicles import make_combination_launch
from aerial_gym.task.step.row_kernels import StepKernel
from aerial_gym.task.values import Values

OWN_ENDS, OWN_REWARDS = "own_ends", "own_rewards"  # Buffers of each vehicle by itself
ENDS, REWARDS = "common_ends", "common_rewards"  # Buffers of what each vehicle shares with the others

Evaluation = Callable[[Mapping[str, Tensor]], tuple[list[Tensor], list[Tensor]]]


class CommonEnds:
    """Computes the conditions of each vehicle, and combines them over those of its environment."""

    def __init__(
        self, evaluate: Evaluation, values: Values, *, reads: Mapping[str, Tensor], needs_all: Sequence[bool],
        num_rewards: int, shares_reward: bool, num_vehicles: int,
    ) -> None:  # fmt: skip
        """Declare the buffers.

        Args:
            evaluate: Returns the conditions, K + 2 of bool (B,), and the weighted terms of the reward, T of (B,).
            reads: Its inputs, by name.
            needs_all: Of each condition whether it must be true for all vehicles.
            shares_reward: Whether the vehicles get the mean of their terms.
        """
        rows, count = values.own, len(needs_all)
        self._evaluate, self._like = evaluate, next(iter(reads.values()))
        for name, width, dtype, meaning in (
            (OWN_ENDS, count, torch.bool, "conditions of ends of each vehicle by itself"),
            (OWN_REWARDS, num_rewards, torch.float32, "weighted reward terms of each vehicle by itself"),
            (ENDS, count, torch.bool, "conditions of ends, combined over the vehicles of an environment"),
            (
                REWARDS,
                num_rewards,
                torch.float32,
                "weighted reward terms, the mean over the vehicles of an environment",
            ),
        ):
            values.declare(name, (width,), dtype=dtype, meaning=meaning)
        self.reads = {ENDS: rows[ENDS]} | ({REWARDS: rows[REWARDS]} if shares_reward else {})
        """What a judgement reads of the combined values."""
        own = {name: rows[name] for name in (OWN_ENDS, OWN_REWARDS)}
        self.rows = StepKernel(self._own_outcome, "the ends of single vehicles", reads=reads, writes=own)
        self._launch = make_combination_launch(
            (rows[OWN_ENDS], rows[OWN_REWARDS]), needs_all, num_vehicles=num_vehicles, out=(rows[ENDS], rows[REWARDS])
        )

    def __call__(self) -> None:
        """Write the combined values of this step; launched, not waited for."""
        self.rows()
        self._launch.launch(self._like)

    def _own_outcome(self, given: Mapping[str, Tensor]) -> dict[str, Tensor]:
        ends, rewards = self._evaluate(given)
        return {OWN_ENDS: torch.stack(ends, dim=-1), OWN_REWARDS: torch.stack(rewards, dim=-1)}
