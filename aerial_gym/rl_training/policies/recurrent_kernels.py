"""Triton kernels of a gated recurrent unit: all steps of a sequence in one launch, and back through them in another.

A step of a small unit is bound by launches: here each block takes a tile of environments through all steps, with the weights
in registers. Letters: T steps, E environments, M numbers of memory.
"""

import triton  # pyright: ignore[reportMissingImports]
import triton.language as tl  # pyright: ignore[reportMissingImports]


@triton.jit
def _logistic(x):
    return 1.0 / (1.0 + tl.exp(-x))


@triton.jit
def forward(
    entering,  # (T, E, 3 M) products of weights and features, with their bias: reset, update, new
    memory,  # (E, M)
    begins,  # (T, E)
    weight,  # (3 M, M)
    bias,  # (3 M,)
    num_steps,
    num_envs,
    # out
    after_out,  # (T, E, M)
    before_out,  # (T, E, M) hidden state before each step; 0 at the start of an episode
    gates_out,  # (T, E, 4 M) reset, update, new, and the memory's contribution to new
    size: tl.constexpr,
    tile: tl.constexpr,
    keeps: tl.constexpr,
    precision: tl.constexpr,
):
    """Write the hidden state after each step; with ``keeps`` also the values for the backward pass."""
    e, m = tl.program_id(0) * tile + tl.arange(0, tile), tl.arange(0, size)
    inside = (e < num_envs)[:, None]
    across = weight + m[None, :] * size + m[:, None]
    w_reset, w_update, w_new = tl.load(across), tl.load(across + size * size), tl.load(across + 2 * size * size)
    b_reset, b_update, b_new = tl.load(bias + m), tl.load(bias + size + m), tl.load(bias + 2 * size + m)
    h = tl.load(memory + e[:, None] * size + m[None, :], mask=inside, other=0.0)
    for t in range(num_steps):
        row = t * num_envs + e
        first = tl.load(begins + row, mask=e < num_envs, other=0)
        h = tl.where((first != 0)[:, None], 0.0, h)
        place, given = row[:, None] * size + m[None, :], entering + row[:, None] * 3 * size + m[None, :]
        in_reset = tl.load(given, mask=inside, other=0.0)
        in_update = tl.load(given + size, mask=inside, other=0.0)
        in_new = tl.load(given + 2 * size, mask=inside, other=0.0)
        reset = _logistic(in_reset + tl.dot(h, w_reset, input_precision=precision) + b_reset[None, :])
        update = _logistic(in_update + tl.dot(h, w_update, input_precision=precision) + b_update[None, :])
        held = tl.dot(h, w_new, input_precision=precision) + b_new[None, :]
        new = 2.0 * _logistic(2.0 * (in_new + reset * held)) - 1.0
        if keeps:
            tl.store(before_out + place, h, mask=inside)
            gates = gates_out + row[:, None] * 4 * size + m[None, :]
            tl.store(gates, reset, mask=inside)
            tl.store(gates + size, update, mask=inside)
            tl.store(gates + 2 * size, new, mask=inside)
            tl.store(gates + 3 * size, held, mask=inside)
        h = new + update * (h - new)
        tl.store(after_out + place, h, mask=inside)


@triton.jit
def backward(
    gradient,  # (T, E, M)
    begins,  # (T, E)
    weight,  # (3 M, M)
    before,  # (T, E, M)
    gates,  # (T, E, 4 M)
    num_steps,
    num_envs,
    # out
    entering_out,  # (T, E, 3 M)
    held_out,  # (T, E, 3 M) with respect to products of weights and memory
    memory_out,  # (E, M)
    size: tl.constexpr,
    tile: tl.constexpr,
    precision: tl.constexpr,
):
    """Write the gradients with respect to input gates, recurrent gates and initial state."""
    e, m = tl.program_id(0) * tile + tl.arange(0, tile), tl.arange(0, size)
    inside = (e < num_envs)[:, None]
    along = weight + m[:, None] * size + m[None, :]
    w_reset, w_update, w_new = tl.load(along), tl.load(along + size * size), tl.load(along + 2 * size * size)
    later = tl.zeros((tile, size), tl.float32)
    for step in range(num_steps):
        row = (num_steps - 1 - step) * num_envs + e
        place, kept = row[:, None] * size + m[None, :], gates + row[:, None] * 4 * size + m[None, :]
        reset = tl.load(kept, mask=inside, other=0.0)
        update = tl.load(kept + size, mask=inside, other=0.0)
        new = tl.load(kept + 2 * size, mask=inside, other=0.0)
        held = tl.load(kept + 3 * size, mask=inside, other=0.0)
        h = tl.load(before + place, mask=inside, other=0.0)
        d = tl.load(gradient + place, mask=inside, other=0.0) + later
        d_new = d * (1.0 - update) * (1.0 - new * new)
        d_update = d * (h - new) * update * (1.0 - update)
        d_reset = d_new * held * reset * (1.0 - reset)
        d_held = d_new * reset
        later = d * update + tl.dot(d_reset, w_reset, input_precision=precision)
        later += tl.dot(d_update, w_update, input_precision=precision)
        later += tl.dot(d_held, w_new, input_precision=precision)
        first = tl.load(begins + row, mask=e < num_envs, other=0)
        later = tl.where((first != 0)[:, None], 0.0, later)
        out = row[:, None] * 3 * size + m[None, :]
        tl.store(entering_out + out, d_reset, mask=inside)
        tl.store(entering_out + out + size, d_update, mask=inside)
        tl.store(entering_out + out + 2 * size, d_new, mask=inside)
        tl.store(held_out + out, d_reset, mask=inside)
        tl.store(held_out + out + size, d_update, mask=inside)
        tl.store(held_out + out + 2 * size, d_held, mask=inside)
    tl.store(memory_out + e[:, None] * size + m[None, :], later, mask=inside)
