"""Commands of each controller for a requested acceleration: ``command``. Frames: world z up. Letters: E environments."""

import torch
from torch import Tensor

from aerial_gym.control import LeeController
from aerial_gym.control.lee import acceleration_wrench, limit_inclination
from aerial_gym.math.quaternion import quat_rotate_inverse, quat_without_tilt, yaw_from_quat
from aerial_gym.physics.state import BodyState


def command(controller: str, law: LeeController, state: BodyState, wanted: Tensor) -> Tensor:
    """Return the commands (E, 4) that accelerate a vehicle by ``wanted`` and turn its nose to world x.

    Args:
        controller: Registered name of what takes the command.
        law: Whose gains and allocation are used: those of the vehicle.
        state: Motion of the vehicle.
        wanted: Acceleration [m/s²], world, (E, 3).
    """
    gains, yaw, level = law.gains, yaw_from_quat(state.attitude), quat_without_tilt(state.attitude)
    quickness = gains.attitude / gains.rate  # [1/s]: of the closed attitude loop
    turn = -quickness[:, 2:] * yaw.unsqueeze(-1)
    force = torch.cat((wanted[:, :2], wanted[:, 2:] + gains.gravity), dim=-1) / gains.gravity  # in weights
    force = limit_inclination(force, torch.full_like(yaw, 0.1), gains.max_slope)
    x, y, z = quat_rotate_inverse(state.attitude, force).split(1, dim=-1)  # body
    match controller:
        case "no_control":
            return law.allocation.allot(acceleration_wrench(state, wanted, 0.0 * yaw, None, gains)).thrust
        case "lee_rates_control":  # about the axis that is square to thrust and force, by the angle between them
            side = torch.hypot(x, y)
            axis = torch.cat((-y, x), dim=-1) / side.clamp_min(1e-9)
            return torch.cat((z - 1.0, quickness[:, :2] * torch.atan2(side, z) * axis, turn), dim=-1)
        case "lee_attitude_control":
            ahead, left, up = quat_rotate_inverse(level, force).split(1, dim=-1)
            roll, pitch = torch.atan2(-left, torch.hypot(ahead, up)), torch.atan2(ahead, up)
            return torch.cat((z - 1.0, roll, pitch, turn), dim=-1)
        case "lee_velocity_control":
            return torch.cat((quat_rotate_inverse(level, state.lin_vel + wanted / gains.velocity), turn), dim=-1)
        case "lee_acceleration_control":
            return torch.cat((wanted, turn), dim=-1)
        case _:
            raise NotImplementedError(f"command for {controller}: write one")
