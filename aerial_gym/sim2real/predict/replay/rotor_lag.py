# pyright: reportArgumentType=false, reportCallIssue=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportGeneralTypeIssues=false, reportAttributeAccessIssue=false, reportAssignmentType=false, reportInvalidTypeForm=false
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
from aerial_gym.interop import launch_on_cpu, start_warp
from aerial_gym.physics.fused.torch_trace import trace_to_warp
from aerial_gym.physics.rotor_lag import DecayLag, SlewLimitedLag


@cache
def _make_lag_kernel(limited: bool) -> Any:
    """Return the kernel. A rotor has two decays, or with slew limits the numbers of ``SlewLimitedLag`` and the span."""
    numbers_type = wp.types.vector(length=5 if limited else 2, dtype=wp.float64)

    def follow(state: Tensor, command: Tensor, numbers: Tensor) -> Tensor:
        if limited:
            *limits, span = numbers.unbind(1)
            return SlewLimitedLag(*limits).follow(state, command, span)
        return DecayLag(*numbers.unbind(1)).follow(state, command, 1.0)

    arguments = {"state": wp.float64, "command": wp.float64, "numbers": numbers_type}
    lag_step = trace_to_warp("lag_step", arguments, follow, [wp.float64], constants={})

    @wp.kernel(module="unique", enable_backward=False)
    def simulate_lag(
        ends: wp.array[wp.int32],  # (F + 1,) first row of each flight, and N
        first: wp.array2d[wp.float64],  # (F, R) [rad/s]
        earlier: wp.array2d[wp.float64],  # (N, R) [rad/s]
        later: wp.array2d[wp.float64],  # (N, R) [rad/s]
        early: wp.array2d[numbers_type],  # (F, R)
        late: wp.array2d[numbers_type],  # (F, R)
        # out
        speed_out: wp.array2d[wp.float64],  # (N, R) [rad/s]
    ):
        """Write the speed at each row; within a row the earlier command acts first, then the later one."""
        flight, rotor = wp.tid()
        speed = first[flight, rotor]
        for row in range(ends[flight], ends[flight + 1]):
            speed_out[row, rotor] = speed
            speed = lag_step(speed, earlier[row, rotor], early[flight, rotor])
            speed = lag_step(speed, later[row, rotor], late[flight, rotor])

    return simulate_lag


def simulate_rotor_lag(
    first: Tensor, earlier: Tensor, later: Tensor, share: Tensor, *, ends: Tensor, step: Tensor, tau_up: Tensor,
    tau_down: Tensor, slew_rates: tuple[Tensor, Tensor] | None = None,
) -> Tensor:  # fmt: skip
    """Return the rotor speeds at the rows of all flights in sequence [rad/s], float64, (N, R).

    The lag is ``rotor_lag.DecayLag``, or ``SlewLimitedLag`` with slew rates.

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
    parts = share[:, None, None], 1.0 - share[:, None, None]  # of a row, (F, 1, 1)
    lags = torch.stack((tau_up, tau_down), dim=-1)
    if slew_rates is None:
        kept = torch.exp(-step[:, None, None] / lags)  # (F, R, 2) over a whole row
        numbers = [kept**part for part in parts]
    else:
        limits = torch.cat((lags, torch.stack(slew_rates, dim=-1)), dim=-1).expand(len(step), -1, -1)
        spans = [(part * step[:, None, None]).expand(-1, rows[1], -1) for part in parts]
        numbers = [torch.cat((limits, span), dim=-1) for span in spans]
    rows_of = [
        wp.from_torch(n.contiguous(), dtype=wp.types.vector(length=n.shape[-1], dtype=wp.float64)) for n in numbers
    ]
    inputs, outputs = [wp.from_torch(ends), *tables, *rows_of], [wp.from_torch(speed)]
    limited = slew_rates is not None
    launch_on_cpu(lambda: _make_lag_kernel(limited), dim=first.shape, inputs=inputs, outputs=outputs)
    return speed
