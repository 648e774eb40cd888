"""The frame of a scan that does not repeat from image to image, in every environment.

Letters: E environments.
"""

import torch
from torch import Tensor


class Frames:
    """Which frame of its rays each environment sees: the next one at every image, from the first after a reset."""

    def __init__(self, num_envs: int, count: int, device: torch.device) -> None:
        """Begin before the first of ``count`` frames."""
        self.count = count
        self.number = torch.full((num_envs,), count - 1, dtype=torch.int32, device=device)
        """Frame of the last image, int32, (E,)."""

    def move_on(self, due: Tensor) -> None:
        """Go to the next frame in the environments ``due``, bool (E,)."""
        if self.count > 1:
            self.number.add_(due).remainder_(self.count)

    def reset(self, mask: Tensor) -> None:
        """Begin anew in the environments of ``mask``, bool (E,)."""
        self.number.masked_fill_(mask, self.count - 1)
