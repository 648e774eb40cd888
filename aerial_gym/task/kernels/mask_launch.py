"""A launch that writes the rows of a mask only."""

import warp as wp
from torch import Tensor

from aerial_gym.interop import ReusableLaunch, start_warp
from aerial_gym.interop.streams import BLOCK_DIM
from aerial_gym.math.random import Randomness, take_mask


class MaskLaunch:
    """A kernel over environments whose first input is the mask; all views are made at construction."""

    def __init__(
        self,
        kernel: wp.Kernel,
        dim: int | tuple[int, ...],
        inputs: list[object],
        outputs: list[object],
        random: Randomness,
    ) -> None:
        start_warp()
        self._mask = random.mask
        block = {"block_dim": BLOCK_DIM} if isinstance(dim, int) else {}
        inputs = [self._mask, *inputs]
        self._launch = ReusableLaunch(
            kernel, dim=dim, inputs=inputs, outputs=outputs, device=self._mask.device, **block
        )

    def draw(self, mask: Tensor) -> None:
        """Draw for the environments in ``mask``, bool (E,); launched on torch's current stream, not waited for."""
        take_mask(self._mask, mask)
        self._launch.launch(self._mask)
