# pyright: reportArgumentType=false, reportCallIssue=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportGeneralTypeIssues=false, reportAttributeAccessIssue=false, reportAssignmentType=false
# (Warp compiles the kernels from their source; Python's type rules do not describe them.)
"""The rotor lag run through the rows of logs, in float64 on the CPU: rows one after another, flights and rotors side by side.

Letters: F flights, R rotors, N rows of all flights.
"""

import torch
import warp as wp
from torch import Tensor

from aerial_gym.errors import ShapeError
from aerial_gym.interop import start_warp


@wp.func
def _approach(speed: wp.float64, command: wp.float64, kept: wp.vec2d) -> wp.float64:
    """Return the speed after a span that leaves a share of a rising and of a falling difference, ``kept``."""
    return command + (speed - command) * wp.where(command > speed, kept[0], kept[1])


@wp.kernel(enable_backward=False)
def _follow(
    ends: wp.array[wp.int32],  # (F + 1,) first row of each flight, and N
    first: wp.array2d[wp.float64],  # (F, R) [rad/s]
    earlier: wp.array2d[wp.float64],  # (N, R) [rad/s]
    later: wp.array2d[wp.float64],  # (N, R) [rad/s]
    kept_early: wp.array2d[wp.vec2d],  # (F, R)
    kept_late: wp.array2d[wp.vec2d],  # (F, R)
    # out
    speed_out: wp.array2d[wp.float64],  # (N, R) [rad/s]
):
    """Write the speed at each row: every row holds its earlier command first, then the later one."""
    flight, rotor = wp.tid()
    speed = first[flight, rotor]
    for row in range(ends[flight], ends[flight + 1]):
        speed_out[row, rotor] = speed
        speed = _approach(speed, earlier[row, rotor], kept_early[flight, rotor])
        speed = _approach(speed, later[row, rotor], kept_late[flight, rotor])


def follow_commands(
    first: Tensor,
    earlier: Tensor,
    later: Tensor,
    share: Tensor,
    *,
    ends: Tensor,
    step: Tensor,
    tau_up: Tensor,
    tau_down: Tensor,
) -> Tensor:
    """Return the speeds at the rows of some flights, one after another [rad/s], float64, (N, R): ``rotors.lag_speed``.

    Args:
        first: Speeds at the first row of each flight [rad/s], float64, (F, R).
        earlier: Commands at the beginning of each row [rad/s], float64, (N, R).
        later: Commands in the rest of it [rad/s], float64, (N, R).
        share: Part of a row for which the earlier ones hold, 0 to 1, (F,).
        ends: First row of each flight, and N, int32, (F + 1,).
        step: Between two rows of a flight [s], (F,).
        tau_up: Lag of a rising speed [s], (R,). Zero follows at once.
        tau_down: Lag of a falling speed [s], (R,).

    Raises:
        ShapeError: If the tables of commands do not fit each other and the flights.
    """
    rows = (int(ends[-1]), first.shape[1])
    if tuple(earlier.shape) != rows or tuple(later.shape) != rows:
        raise ShapeError(f"commands have shapes {tuple(earlier.shape)} and {tuple(later.shape)}, expected {rows}")
    kept = torch.exp(-step[:, None, None] / torch.stack((tau_up, tau_down), dim=-1))  # (F, R, 2) over a whole row
    part = share[:, None, None]
    speed = torch.empty_like(later)
    start_warp()
    wp.launch(
        _follow,
        dim=first.shape,
        inputs=[
            wp.from_torch(ends),
            *(wp.from_torch(table.contiguous()) for table in (first, earlier, later)),
            *(wp.from_torch((kept**power).contiguous(), dtype=wp.vec2d) for power in (part, 1.0 - part)),
        ],
        outputs=[wp.from_torch(speed)],
        device="cpu",
    )
    return speed
