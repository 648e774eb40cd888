"""Adam on one tensor of all weights, with rate and step count on the device, in few launches.

Letters: P weights.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import Tensor, nn

BETAS, EPSILON = (0.9, 0.999), 1e-8  # Kingma, Ba (2015), Adam: a method for stochastic optimization, algorithm 1

PIECE = 4096
"""Weights that one block of a GPU moves: one tensor of 100,000 would be work for two of its multiprocessors."""


class FlatAdam:
    """Adam with a limit on the gradient norm."""

    def __init__(self, network: nn.Module, *, max_norm: float, betas: tuple[float, float] = BETAS) -> None:
        """Move all weights of ``network`` into one tensor, of which they become views."""
        self._parameters = [p for p in network.parameters() if p.requires_grad]
        self._max_norm, self._betas = max_norm, betas
        self.weights = torch.cat([p.detach().reshape(-1) for p in self._parameters])  # (P,)
        self._bind_weights(self.weights)
        self._mean, self._square = torch.zeros_like(self.weights), torch.zeros_like(self.weights)
        self._steps = torch.zeros((), device=self.weights.device)

    def _bind_weights(self, flat: Tensor) -> None:
        start = 0
        for parameter in self._parameters:
            parameter.data = flat[start : start + parameter.numel()].view_as(parameter)
            start += parameter.numel()

    def weight_offset(self, parameter: Tensor) -> int:
        """Return the offset of a network parameter among all weights."""
        return (parameter.data_ptr() - self.weights.data_ptr()) // self.weights.element_size()

    def gradient(self, loss: Tensor) -> Tensor:
        """Return the gradient of ``loss`` with respect to all weights, (P,)."""
        return torch.cat([g.reshape(-1) for g in torch.autograd.grad(loss, self._parameters)])

    @torch.no_grad()
    def step(self, gradient: Tensor, rate: Tensor) -> None:
        """Update the weights by ``gradient``, (P,), with a rate on the device, ()."""
        # The kernel divides the gradient by grad_scale.
        excess = (torch.linalg.vector_norm(gradient) / self._max_norm).clamp_min(1.0)
        self._steps.add_(1.0)
        weights, gradients, means, squares = (
            list(flat.split(PIECE)) for flat in (self.weights, gradient, self._mean, self._square)
        )
        torch._fused_adam_(  # pyright: ignore[reportPrivateImportUsage]
            weights,
            gradients,
            means,
            squares,
            [],
            [self._steps] * len(weights),
            lr=rate,
            beta1=self._betas[0],
            beta2=self._betas[1],
            weight_decay=0.0,
            eps=EPSILON,
            amsgrad=False,
            maximize=False,
            grad_scale=excess,
            found_inf=None,
        )

    def state_tensors(self) -> dict[str, Tensor]:
        """Return the tensors of a saved state besides the weights; they keep their memory."""
        return {"mean": self._mean, "square": self._square, "steps": self._steps}


@contextmanager
def low_precision() -> Iterator[None]:
    """Multiply float32 matrices on a GPU with 10 bits of mantissa: exact enough for gradients of a network of noisy samples.

    Not for passes forward, as the probability ratio compares two of them, nor for gradients that go back through physics.
    """
    before = torch.backends.cuda.matmul.allow_tf32
    torch.backends.cuda.matmul.allow_tf32 = True
    try:
        yield
    finally:
        torch.backends.cuda.matmul.allow_tf32 = before
