# pyright: reportArgumentType=false, reportCallIssue=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportGeneralTypeIssues=false, reportAttributeAccessIssue=false, reportAssignmentType=false
# (Warp compiles the kernels from their source; Python's type rules do not describe them.)
"""Simulate the rotor lag along logs, in float64 on the CPU, with one thread per flight and rotor.

Letters: F flights, R rotors, N rows of all flights.
"""

from functools import cache
from typing import Any

import torch
import warp as wp
from torch import Tensor

from aerial_gym.errors import ShapeError
from aerial_gym.interop import start_warp
from aerial_gym.physics.fused.rotors import make_limited_lag
from aerial_gym.physics.rotor_lag import FASTEST, SHORTEST


@wp.func
def _lag_step(speed: wp.float64, command: wp.float64, kept: wp.vec2d) -> wp.float64:
    """Return the speed after a first-order step; ``kept``: shares of a rising and a falling difference that remain."""
    return command + (speed - command) * wp.where(command > speed, kept[0], kept[1])


@wp.kernel(enable_backward=False)
def _simulate_lag(
    ends: wp.array[wp.int32],  # (F + 1,) first row of each flight, and N
    first: wp.array2d[wp.float64],  # (F, R) [rad/s]
    earlier: wp.array2d[wp.float64],  # (N, R) [rad/s]
    later: wp.array2d[wp.float64],  # (N, R) [rad/s]
    kept_early: wp.array2d[wp.vec2d],  # (F, R)
    kept_late: wp.array2d[wp.vec2d],  # (F, R)
    # out
    speed_out: wp.array2d[wp.float64],  # (N, R) [rad/s]
):
    """Write the speed at each row; within a row the earlier command acts first, then the later one."""
    flight, rotor = wp.tid()
    speed = first[flight, rotor]
    for row in range(ends[flight], ends[flight + 1]):
        speed_out[row, rotor] = speed
        speed = _lag_step(speed, earlier[row, rotor], kept_early[flight, rotor])
        speed = _lag_step(speed, later[row, rotor], kept_late[flight, rotor])


@cache
def _make_limited_lag_kernel() -> Any:
    limited_lag = make_limited_lag(wp.float64)

    @wp.kernel(module="unique", enable_backward=False)
    def simulate_limited_lag(
        ends: wp.array[wp.int32],  # (F + 1,) first row of each flight, and N
        first: wp.array2d[wp.float64],  # (F, R) [rad/s]
        earlier: wp.array2d[wp.float64],  # (N, R) [rad/s]
        later: wp.array2d[wp.float64],  # (N, R) [rad/s]
        limits: wp.array[wp.vec4d],  # (R,) tau_up, tau_down [s], slew rates up and down [rad/s²]
        spans: wp.array[wp.vec2d],  # (F,) of the earlier and the later command [s]
        # out
        speed_out: wp.array2d[wp.float64],  # (N, R) [rad/s]
    ):
        """Write the speed at each row; within a row the earlier command acts first, then the later one."""
        flight, rotor = wp.tid()
        speed = first[flight, rotor]
        limit = limits[rotor]
        for row in range(ends[flight], ends[flight + 1]):
            speed_out[row, rotor] = speed
            speed = limited_lag(speed, earlier[row, rotor], limit[0], limit[1], limit[2], limit[3], spans[flight][0])
            speed = limited_lag(speed, later[row, rotor], limit[0], limit[1], limit[2], limit[3], spans[flight][1])

    return simulate_limited_lag


def simulate_rotor_lag(
    first: Tensor,
    earlier: Tensor,
    later: Tensor,
    share: Tensor,
    *,
    ends: Tensor,
    step: Tensor,
    tau_up: Tensor,
    tau_down: Tensor,
    slew_rates: tuple[Tensor, Tensor] | None = None,
) -> Tensor:
    """Return the rotor speeds at the rows of all flights in sequence [rad/s], float64, (N, R).

    The law is ``rotors.lag_speed``, with ``slew_rates`` that of ``rotor_lag.slew_limited_lag``.

    Args:
        first: Speeds at the first row of each flight [rad/s], (F, R).
        earlier: Commands at the start of each row [rad/s], (N, R); ``later`` in the rest of it.
        share: Part of a row in which the earlier commands hold, 0 to 1, (F,).
        ends: First row of each flight, and N, int32, (F + 1,).
        step: Time between two rows of each flight [s], (F,).
        tau_up: Time constant of a rising speed [s], (R,); 0 follows at once.
        slew_rates: Largest rates up and down [rad/s²], each (R,); None: no rotor has a limit or is reversible.
    """
    rows = (int(ends[-1]), first.shape[1])
    if tuple(earlier.shape) != rows or tuple(later.shape) != rows:
        raise ShapeError(f"commands have shapes {tuple(earlier.shape)} and {tuple(later.shape)}, expected {rows}")
    start_warp()
    speed, tables = torch.empty_like(later), [wp.from_torch(t.contiguous()) for t in (first, earlier, later)]
    if slew_rates is None:
        kept = torch.exp(-step[:, None, None] / torch.stack((tau_up, tau_down), dim=-1))  # (F, R, 2) over a whole row
        part = share[:, None, None]
        kernel, numbers = _simulate_lag, [kept**part, kept ** (1.0 - part)]
    else:
        lags = [*(tau.clamp_min(SHORTEST) for tau in (tau_up, tau_down)), *(s.clamp_max(FASTEST) for s in slew_rates)]
        spans = torch.stack((share * step, (1.0 - share) * step), dim=-1)
        kernel, numbers = _make_limited_lag_kernel(), [torch.stack(lags, dim=-1), spans]
    rows_of = [wp.from_torch(n.contiguous(), dtype=wp.vec4d if n.shape[-1] == 4 else wp.vec2d) for n in numbers]
    inputs, outputs = [wp.from_torch(ends), *tables, *rows_of], [wp.from_torch(speed)]
    wp.launch(kernel, dim=first.shape, inputs=inputs, outputs=outputs, device="cpu")
    return speed
