"""Gradients through launches of the fused kernel: Warp's tape as a torch function.

A launch advances one substep here, into new tensors, because the tape needs every intermediate state.
Letters: E environments, N numbers per environment.
"""

from collections.abc import Sequence
from typing import Any

import torch
import warp as wp
from torch import Tensor

from aerial_gym.interop import on_torch_stream
from aerial_gym.physics.fused.hook import NoHook
from aerial_gym.physics.fused.memory import NoMemory


class Rollout:
    """A differentiable call of the kernel over several substeps."""

    def __init__(
        self, kernel: wp.Kernel, shared: Sequence[Any], ground: tuple[Any, ...], gravity: float, dt: float,
        substeps: int, kinds: Sequence[type],
    ) -> None:  # fmt: skip
        """Store the kernel, its structs, ground and scalars, and the Warp types of state and action."""
        self.kernel, self.shared, self.substeps = kernel, list(shared), substeps
        *plane, self.contact, self.impulse = ground
        self.scalars = (*plane, gravity, dt)
        self.kinds = tuple(kinds)

    def __call__(self, state: Sequence[Tensor], command: Tensor, packed: Tensor) -> tuple[Tensor, ...]:
        """Return the tensors of the state after the substeps."""
        return _Rollout.apply(self, packed, command, *state)


class _Rollout(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, rollout: Rollout, packed: Tensor, command: Tensor, *state: Tensor) -> tuple[Tensor, ...]:
        def view(tensor: Tensor, kind: type) -> wp.array:
            return wp.from_torch(tensor.detach().contiguous(), dtype=kind, requires_grad=True)

        *state_kinds, action_kind = rollout.kinds
        now = [view(tensor, kind) for tensor, kind in zip(state, state_kinds, strict=True)]
        no_memory, no_hook = NoMemory(), NoHook()
        action, params = view(command, action_kind), view(packed, wp.float32)
        ctx.inputs, ctx.tape = [params, action, *now], wp.Tape()
        with on_torch_stream(command), ctx.tape:
            for _ in range(rollout.substeps):
                after = [wp.empty_like(array, requires_grad=True) for array in now]
                wp.launch(
                    rollout.kernel,
                    dim=command.shape[0],
                    inputs=[*now, action, *rollout.shared, params, *rollout.scalars, 1, 0, no_memory, no_hook],
                    outputs=[*after, rollout.contact, rollout.impulse],
                    device=now[0].device,
                )
                now = after
        ctx.outputs = now
        return tuple(wp.to_torch(array).clone() for array in now)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        with on_torch_stream(grads[0]):
            seeds = {
                array: wp.from_torch(grad.contiguous(), dtype=array.dtype)
                for array, grad in zip(ctx.outputs, grads, strict=True)
            }
            ctx.tape.backward(grads=seeds)
            input_grads = tuple(wp.to_torch(array.grad).clone() for array in ctx.inputs)
            ctx.tape.zero()
        return (None, *input_grads)
