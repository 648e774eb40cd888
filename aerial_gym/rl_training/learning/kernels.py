"""Triton kernels for policies and critics that are two hidden layers each: a pass forward, and the gradient of a minibatch.

Small networks are bound by launches and by reading activations again: here each of them passes a tile of samples through all
layers, forward and backward, in registers. The first network of the weights is the policy, the second the critic.

Letters: N samples, O entries of a network's input, H width of the hidden layers, U entries of an action, P weights, B blocks.
"""

import triton  # pyright: ignore[reportMissingImports]
import triton.language as tl  # pyright: ignore[reportMissingImports]

ELU, RELU, TANH = 0, 1, 2  # Activations


@triton.jit
def write_zero(out):
    """Write 0; compiled alone, to start Triton."""
    tl.store(out, 0.0)


@triton.jit
def _activate(x, kind: tl.constexpr):
    if kind == 0:
        y = tl.where(x > 0.0, x, tl.exp(tl.minimum(x, 0.0)) - 1.0)
    elif kind == 1:
        y = tl.maximum(x, 0.0)
    else:
        y = 2.0 / (1.0 + tl.exp(-2.0 * x)) - 1.0
    return y


@triton.jit
def _activation_slope(y, kind: tl.constexpr):
    """Return the derivative of the activation at its output ``y``."""
    if kind == 0:
        d = tl.where(y > 0.0, 1.0, y + 1.0)
    elif kind == 1:
        d = tl.where(y > 0.0, 1.0, 0.0)
    else:
        d = 1.0 - y * y
    return d


@triton.jit
def _network_pass(
    x,
    weights,  # (P,)
    first,
    first_bias,
    second,
    second_bias,
    head,
    head_bias,
    num_out,
    num_in,
    wide_in: tl.constexpr,
    hidden: tl.constexpr,
    wide_out: tl.constexpr,
    kind: tl.constexpr,
    precision: tl.constexpr,
):
    """Return both hidden layers and the head's output, and the weights of second layer and head as they were read."""
    i, h, u = tl.arange(0, wide_in), tl.arange(0, hidden), tl.arange(0, wide_out)
    w1 = tl.load(weights + first + h[None, :] * num_in + i[:, None], mask=(i < num_in)[:, None], other=0.0)
    w2 = tl.load(weights + second + h[:, None] * hidden + h[None, :])
    w3 = tl.load(weights + head + u[:, None] * hidden + h[None, :], mask=(u < num_out)[:, None], other=0.0)
    b1, b2 = tl.load(weights + first_bias + h), tl.load(weights + second_bias + h)
    b3 = tl.load(weights + head_bias + u, mask=u < num_out, other=0.0)
    h1 = _activate(tl.dot(x, w1, input_precision=precision) + b1[None, :], kind)
    h2 = _activate(tl.dot(h1, tl.trans(w2), input_precision=precision) + b2[None, :], kind)
    out = tl.dot(h2, tl.trans(w3), input_precision=precision) + b3[None, :]
    return h1, h2, out, w2, w3


@triton.jit
def forward(
    weights,  # (P,)
    observation,  # (N, O)
    noise,  # (N, U); read where actions are drawn
    num_samples,
    first,
    first_bias,
    second,
    second_bias,
    head,
    head_bias,
    log_std,
    # out
    out,  # (N, U)
    action_out,  # (N, U) drawn
    command_out,  # (N, U) clamped to -1..1
    num_in: tl.constexpr,
    wide_in: tl.constexpr,
    hidden: tl.constexpr,
    num_out: tl.constexpr,
    wide_out: tl.constexpr,
    kind: tl.constexpr,
    draws: tl.constexpr,
    tile: tl.constexpr,
    precision: tl.constexpr,
):
    """Write the network's output of every observation; with ``draws`` also actions around it."""
    rows, i, u = tl.program_id(0) * tile + tl.arange(0, tile), tl.arange(0, wide_in), tl.arange(0, wide_out)
    inside = rows < num_samples
    x = tl.load(
        observation + rows[:, None] * num_in + i[None, :], mask=inside[:, None] & (i < num_in)[None, :], other=0.0
    )
    _, _, result, _, _ = _network_pass(
        x, weights, first, first_bias, second, second_bias, head, head_bias, num_out,
        num_in, wide_in, hidden, wide_out, kind, precision,
    )  # fmt: skip
    place, mask = rows[:, None] * num_out + u[None, :], inside[:, None] & (u < num_out)[None, :]
    tl.store(out + place, result, mask=mask)
    if draws:
        std = tl.exp(tl.load(weights + log_std + u, mask=u < num_out, other=0.0))
        drawn = result + std[None, :] * tl.load(noise + place, mask=mask, other=0.0)
        tl.store(action_out + place, drawn, mask=mask)
        tl.store(command_out + place, tl.minimum(tl.maximum(drawn, -1.0), 1.0), mask=mask)


@triton.jit
def gradient(
    weights,  # (P,)
    order,  # (E',) environments of the minibatch
    seen0,  # (T, E, O) by the policy
    seen1,  # (T, E, O) by the critic
    action,  # (T, E, U)
    mean,  # (T, E, U) before learning
    old_log_std,  # (U,)
    log_prob,  # (T, E)
    advantage,  # (T, E)
    value,  # (T, E) before learning
    target,  # (T, E)
    num_chosen,  # E'
    num_envs,  # E
    num_samples,  # T E'
    first0,
    first_bias0,
    second0,
    second_bias0,
    head0,
    head_bias0,
    log_std,
    first1,
    first_bias1,
    second1,
    second_bias1,
    head1,
    head_bias1,
    clip_range,
    value_coef,
    bound_coef,
    entropy_coef,
    bound,
    width,  # P + 3
    # out
    partial_out,  # (B, P + 3): gradient; sums of divergence, policy loss and value loss
    num_in0: tl.constexpr,
    num_in1: tl.constexpr,
    wide_in: tl.constexpr,
    hidden: tl.constexpr,
    num_actions: tl.constexpr,
    wide_out: tl.constexpr,
    kind: tl.constexpr,
    clip_value: tl.constexpr,
    tile: tl.constexpr,
    precision: tl.constexpr,
    backward_precision: tl.constexpr,
):
    """Write the gradient of the loss of ``Ppo`` over the samples of this block; the second axis of the grid is the network."""
    block, critic = tl.program_id(0), tl.program_id(1)
    first, first_bias = tl.where(critic == 0, first0, first1), tl.where(critic == 0, first_bias0, first_bias1)
    second, second_bias = tl.where(critic == 0, second0, second1), tl.where(critic == 0, second_bias0, second_bias1)
    head, head_bias = tl.where(critic == 0, head0, head1), tl.where(critic == 0, head_bias0, head_bias1)
    num_out = tl.where(critic == 0, num_actions, 1)
    num_in = num_in0 if num_in0 == num_in1 else tl.where(critic == 0, num_in0, num_in1)
    i, h, u = tl.arange(0, wide_in), tl.arange(0, hidden), tl.arange(0, wide_out)
    scale = 1.0 / num_samples
    ls = tl.load(weights + log_std + u, mask=u < num_actions, other=0.0)
    old_ls = tl.load(old_log_std + u, mask=u < num_actions, other=0.0)
    inverse_std = tl.exp(-ls)
    constant = tl.sum(tl.where(u < num_actions, ls + 0.9189385332046727, 0.0))  # log sqrt(2 pi)
    spread = tl.where(u < num_actions, ls - old_ls + 0.5 * tl.exp(2.0 * (old_ls - ls)) - 0.5, 0.0)
    spread_sum = tl.sum(spread)
    g1 = tl.zeros((hidden, wide_in), tl.float32)
    g2 = tl.zeros((hidden, hidden), tl.float32)
    g3 = tl.zeros((wide_out, hidden), tl.float32)
    gb1, gb2 = tl.zeros((hidden,), tl.float32), tl.zeros((hidden,), tl.float32)
    gb3, gls = tl.zeros((wide_out,), tl.float32), tl.zeros((wide_out,), tl.float32)
    divergence_sum, loss_sum = 0.0, 0.0
    for start in range(block * tile, num_samples, tl.num_programs(0) * tile):
        sample = start + tl.arange(0, tile)
        inside = sample < num_samples
        env = tl.load(order + sample % num_chosen, mask=inside, other=0)
        row = (sample // num_chosen) * num_envs + env
        seen, at = inside[:, None] & (i < num_in)[None, :], row[:, None] * num_in + i[None, :]
        x = tl.load(seen0 + at, mask=seen, other=0.0) if critic == 0 else tl.load(seen1 + at, mask=seen, other=0.0)
        h1, h2, out, w2, w3 = _network_pass(
            x, weights, first, first_bias, second, second_bias, head, head_bias, num_out,
            num_in, wide_in, hidden, wide_out, kind, precision,
        )  # fmt: skip
        if critic == 0:
            acts = inside[:, None] & (u < num_actions)[None, :]
            place = row[:, None] * num_actions + u[None, :]
            normal = tl.where(acts, (tl.load(action + place, mask=acts, other=0.0) - out) * inverse_std[None, :], 0.0)
            new_log_prob = -0.5 * tl.sum(normal * normal, axis=1) - constant
            gain = tl.load(advantage + row, mask=inside, other=0.0)
            ratio = tl.exp(new_log_prob - tl.load(log_prob + row, mask=inside, other=0.0))
            free, held = ratio * gain, tl.minimum(tl.maximum(ratio, 1.0 - clip_range), 1.0 + clip_range) * gain
            push = tl.where(inside & (free <= held), -scale * free, 0.0)
            over = tl.where(acts, tl.maximum(tl.abs(out) - bound, 0.0) * tl.where(out > 0.0, 1.0, -1.0), 0.0)
            d_out = push[:, None] * normal * inverse_std[None, :] + 2.0 * bound_coef * scale * over
            d_std = tl.where(acts, push[:, None] * (normal * normal - 1.0) - entropy_coef * scale, 0.0)
            gls += tl.sum(d_std, axis=0)
            apart = (tl.load(mean + place, mask=acts, other=0.0) - out) * inverse_std[None, :]
            apart = tl.where(acts, apart, 0.0)
            divergence_sum += tl.sum(tl.where(inside, 0.5 * tl.sum(apart * apart, axis=1) + spread_sum, 0.0))
            loss_sum += tl.sum(tl.where(inside, -tl.minimum(free, held), 0.0))
        else:
            judged = tl.sum(tl.where((u == 0)[None, :], out, 0.0), axis=1)
            goal = tl.load(target + row, mask=inside, other=0.0)
            error = judged - goal
            if clip_value:
                old = tl.load(value + row, mask=inside, other=0.0)
                change = judged - old
                limited = old + tl.minimum(tl.maximum(change, -clip_range), clip_range) - goal
                stuck = (limited * limited > error * error) & (tl.abs(change) > clip_range)
                loss_sum += tl.sum(tl.where(inside, 0.5 * tl.maximum(error * error, limited * limited), 0.0))
                error = tl.where(stuck, 0.0, error)
            else:
                loss_sum += tl.sum(tl.where(inside, 0.5 * error * error, 0.0))
            push = tl.where(inside, value_coef * scale * error, 0.0)
            d_out = tl.where((u == 0)[None, :], push[:, None], 0.0)
        gb3 += tl.sum(d_out, axis=0)
        g3 += tl.dot(tl.trans(d_out), h2, input_precision=backward_precision)
        d2 = tl.dot(d_out, w3, input_precision=backward_precision) * _activation_slope(h2, kind)
        gb2 += tl.sum(d2, axis=0)
        g2 += tl.dot(tl.trans(d2), h1, input_precision=backward_precision)
        d1 = tl.dot(d2, w2, input_precision=backward_precision) * _activation_slope(h1, kind)
        gb1 += tl.sum(d1, axis=0)
        g1 += tl.dot(tl.trans(d1), x, input_precision=backward_precision)
    into = partial_out + block * width
    tl.store(into + first + h[:, None] * num_in + i[None, :], g1, mask=(i < num_in)[None, :])
    tl.store(into + first_bias + h, gb1)
    tl.store(into + second + h[:, None] * hidden + h[None, :], g2)
    tl.store(into + second_bias + h, gb2)
    tl.store(into + head + u[:, None] * hidden + h[None, :], g3, mask=(u < num_out)[:, None])
    tl.store(into + head_bias + u, gb3, mask=u < num_out)
    if critic == 0:
        tl.store(into + log_std + u, gls, mask=u < num_actions)
        tl.store(into + width - 3, divergence_sum)
        tl.store(into + width - 2, loss_sum)
    else:
        tl.store(into + width - 1, loss_sum)
