# pyright: reportArgumentType=false, reportCallIssue=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportGeneralTypeIssues=false, reportAttributeAccessIssue=false, reportAssignmentType=false
# pyright: reportInvalidTypeForm=false, reportReturnType=false
# (Warp compiles the kernels from their source; Python's type rules do not describe them.)
"""Simulate the rotor lag along logs, in float64 on the CPU, with one thread per flight and rotor.

Letters: F flights, R rotors, N rows of all flights.
"""

from functools import cache

import torch
import warp as wp
from torch import Tensor

from aerial_gym.errors import ShapeError
from aerial_gym.interop import start_warp
from aerial_gym.physics.fused.rotors import make_stage_rates
from aerial_gym.physics.rotor_lag import FASTEST, SHORTEST


@cache
def _make_lag_kernel(*, limited: bool) -> wp.Kernel:
    """Return the kernel of the first-order lag, or of that with slew rates."""
    numbers = wp.types.vector(length=5 if limited else 2, dtype=wp.float64)
    if limited:
        limited_lag = make_stage_rates(wp.float64)

        @wp.func
        def lag_step(speed: wp.float64, command: wp.float64, law: numbers):
            return limited_lag(speed, command, law[0], law[1], law[2], law[3], law[4])
    else:

        @wp.func
        def lag_step(speed: wp.float64, command: wp.float64, law: numbers):
            return command + (speed - command) * wp.where(command > speed, law[0], law[1])

    @wp.kernel(module="unique", enable_backward=False)
    def simulate_lag(
        ends: wp.array[wp.int32],  # (F + 1,) first row of each flight, and N
        first: wp.array2d[wp.float64],  # (F, R) [rad/s]
        earlier: wp.array2d[wp.float64],  # (N, R) [rad/s]
        later: wp.array2d[wp.float64],  # (N, R) [rad/s]
        law_early: wp.array2d[numbers],  # (F, R) numbers of the law during the earlier command
        law_late: wp.array2d[numbers],  # (F, R)
        # out
        speed_out: wp.array2d[wp.float64],  # (N, R) [rad/s]
    ):
        """Write the speed at each row; within a row the earlier command acts first, then the later one."""
        flight, rotor = wp.tid()
        speed = first[flight, rotor]
        for row in range(ends[flight], ends[flight + 1]):
            speed_out[row, rotor] = speed
            speed = lag_step(speed, earlier[row, rotor], law_early[flight, rotor])
            speed = lag_step(speed, later[row, rotor], law_late[flight, rotor])

    return simulate_lag


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
    part = share[:, None, None]
    if slew_rates is None:  # numbers: shares of a rising and a falling difference that remain
        kept = torch.exp(-step[:, None, None] / torch.stack((tau_up, tau_down), dim=-1))  # (F, R, 2) over a whole row
        laws = [kept**part, kept ** (1.0 - part)]
    else:  # time constants up and down [s], slew rates up and down [rad/s²], time [s]
        lags = [*(tau.clamp_min(SHORTEST) for tau in (tau_up, tau_down)), *(s.clamp_max(FASTEST) for s in slew_rates)]
        limits = torch.stack(lags, dim=-1).expand(*first.shape, 4)
        spans = (step[:, None, None] * time for time in (part, 1.0 - part))
        laws = [torch.cat((limits, span.expand(*first.shape, 1)), dim=-1) for span in spans]
    numbers = wp.types.vector(length=laws[0].shape[-1], dtype=wp.float64)
    speed, tables = torch.empty_like(later), [wp.from_torch(t.contiguous()) for t in (first, earlier, later)]
    inputs = [wp.from_torch(ends), *tables, *(wp.from_torch(law.contiguous(), dtype=numbers) for law in laws)]
    kernel, outputs = _make_lag_kernel(limited=slew_rates is not None), [wp.from_torch(speed)]
    wp.launch(kernel, dim=first.shape, inputs=inputs, outputs=outputs, device="cpu")
    return speed
