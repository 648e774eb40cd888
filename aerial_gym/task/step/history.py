"""Delay and history of values as pure functions for kernels.

A line of m values of width w is a buffer (E, m w), oldest first. Letters: E environments.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from aerial_gym.interop.rows.row_trace import LARGEST_ROW


@dataclass(frozen=True, kw_only=True)
class HistoryLine:
    """Delay and history length of a value."""

    longest_delay: int  # Largest delay [steps]
    history: int = 1  # Values shown side by side, oldest first

    @property
    def length(self) -> int:
        """Past values that must be kept, m."""
        return self.longest_delay + self.history - 1

    def frames_of_step(self, past: Tensor, value: Tensor, begun: Tensor | None) -> list[Tensor]:
        """Return the values of this step and the m before, oldest first, each (E, w). The line ``past`` is (E, m w), ``value``
        (E, w). Where an episode has just ``begun``, bool (E,), frames are this value."""
        kept = list(past.split(value.shape[1], dim=-1)) if self.length else []
        if begun is not None:
            kept = [torch.where(begun.unsqueeze(-1), value, old) for old in kept]
        return [*kept, value]

    def buffer_lengths(self, width: int) -> list[int]:
        """Return the number of past values per buffer, split so that each buffer is narrow enough for a kernel."""
        most = max(1, LARGEST_ROW // width)
        return [min(most, self.length - first) for first in range(0, self.length, most)]

    def read_frames(self, frames: list[Tensor], delay: Tensor | None) -> Tensor:
        """Return the value with a delay [steps], (E,), None for the largest, and its history, (E, history w)."""
        last = len(frames) - 1
        columns = []
        for k in reversed(range(self.history)):
            late = frames[last - self.longest_delay - k]
            if delay is not None:
                for steps in range(self.longest_delay):
                    late = torch.where((delay == float(steps)).unsqueeze(-1), frames[last - steps - k], late)
            columns.append(late)
        return torch.cat(columns, dim=-1) if len(columns) > 1 else columns[0]

    def next_line(self, frames: list[Tensor]) -> Tensor:
        """Return the line as the next step finds it, (E, m w)."""
        return torch.cat(frames[1:], dim=-1)
