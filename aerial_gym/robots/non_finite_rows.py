"""Rows with NaN or infinite values: their bits, their count and the first ones, written by the launch that resets them.

A row with any bit ends in that step. Letters: E environments, K rows written down.
"""

from dataclasses import dataclass
from enum import IntFlag

import torch
import warp as wp
from torch import Tensor

from aerial_gym.physics import BodyState
from aerial_gym.registry import GlobalTensorDictionary


class NonFinite(IntFlag):
    """Quantities that were NaN or infinite in a step; they are bits of ``gtd["non_finite"]``, int32 (E,)."""

    ACTION = 1  # Action. The physics may clamp it and continue.
    STATE = 2  # Position, attitude, velocities or rotor speeds after the physics
    REWARD = 4  # Reward of the task
    OBSERVATION = 8  # Observation term of the task

    def names(self) -> str:
        """Return the quantities in words."""
        return " and ".join(str(flag.name).lower() for flag in NonFinite if flag in self)


KEPT_ROWS = 8  # Rows K that are written down: the first ones


@wp.func
def count_row(count_out: wp.array[wp.int32]) -> int:
    """Count a row and return the count before it, which stops at 2**30 to avoid overflow."""
    if count_out[0] >= 1073741824:
        return 1073741824
    return wp.atomic_add(count_out, 0, 1)


@dataclass(frozen=True, kw_only=True)
class NonFiniteRows:
    """Table of rows with NaN or infinite values, and the flags that fill it."""

    bits: Tensor  # Bits of ``NonFinite`` of the step that ends, int32 (E,)
    episode_step: Tensor  # Number of that step within the episode, int32 (E,)
    flags: tuple[Tensor, Tensor]  # Reasons for its end, `crashes` and `truncations`, bool (E,), cleared by a reset
    record: Tensor  # Count; environment, episode, step and bits of the first K rows, int32 (1 + 4 K,): one copy

    @property
    def count(self) -> Tensor:
        """Number of such rows, (1,)."""
        return self.record[:1]

    @property
    def rows(self) -> Tensor:
        """The first ones, (K, 4)."""
        return self.record[1:].view(KEPT_ROWS, 4)

    @classmethod
    def from_gtd(cls, gtd: GlobalTensorDictionary) -> "NonFiniteRows":
        """Return an empty table that reads the flags of a simulation."""
        record = torch.zeros(1 + 4 * KEPT_ROWS, dtype=torch.int32, device=gtd.device)
        flags = gtd["crashes"], gtd["truncations"]
        return cls(bits=gtd["non_finite"], episode_step=gtd["sim_steps"], flags=flags, record=record)

    @classmethod
    def placeholder(cls, state: BodyState) -> "NonFiniteRows":
        """Return a table for robots without a simulation, whose rows are all finite."""
        device = state.position.device
        zeros, no = (torch.zeros(state.num_envs, dtype=dtype, device=device) for dtype in (torch.int32, torch.bool))
        record = torch.zeros(1 + 4 * KEPT_ROWS, dtype=torch.int32, device=device)
        return cls(bits=zeros, episode_step=zeros, flags=(no, no), record=record)
