"""A control law: climb rate with an integral, and body rates."""

import torch
from torch import Tensor

from aerial_gym.config.controller import ControlCfg, ControllerCfg
from aerial_gym.control import StatefulController, make_timing
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.lee import thrust_wrench
from aerial_gym.math.quaternion import world_up
from aerial_gym.physics import BodyState, Vehicle


class ClimbRate(StatefulController):
    """Climb rate [m/s] by thrust, with an integral, and body rates [rad/s]."""

    action_names = ("climb rate [m/s]", "p [rad/s]", "q [rad/s]", "r [rad/s]")
    trim = "vz p q r"  # the axes that the law controls

    def __init__(self, cfg: ControllerCfg, vehicle: Vehicle, gravity: float, *, dt: float, control: ControlCfg) -> None:
        """Compute the allocation of the declared vehicle."""
        self.allocation = Allocation(vehicle, gravity)
        self.mass, self.inertia, self.gravity = vehicle.mass, vehicle.inertia, gravity
        self.set_needs(make_timing(cfg, dt), num_rotors=vehicle.num_rotors, outer=1)

    def outer(self, state: BodyState, action: Tensor, memory: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Return thrust [N] and body rates [rad/s], (E, 4), and the integral of the error [m], (E, 1)."""
        error = action[:, :1] - state.lin_vel[:, 2:]
        integral = (memory + error * self.timing.outer_period).clamp(-2.0, 2.0)
        upward = self.gravity + 4.0 * error + 4.0 * integral
        thrust = self.mass.unsqueeze(-1) * upward / world_up(state.attitude)[:, 2:].clamp_min(0.5)
        return torch.cat((thrust, action[:, 1:]), dim=-1), integral

    def inner(self, state: BodyState, setpoint: Tensor, memory: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Return rotor speeds [rad/s], (E, R)."""
        wanted = 20.0 * (setpoint[:, 1:] - state.ang_vel)  # [rad/s²]
        torque = (self.inertia * wanted.unsqueeze(1)).sum(-1)
        return self.allocation.speed_for_wrench(thrust_wrench(setpoint[:, 0], torque)), memory
