"""PX4's cascade for recorded setpoints: a whole attitude in place of angles, and the velocity of a moving position.

Frames: world z up, body x forward, y left, z up; quaternions xyzw. Letters: E environments.
"""

import torch
from torch import Tensor

from aerial_gym.control.px4.cascade import attitude_from_thrust
from aerial_gym.control.px4.controller import Px4Controller
from aerial_gym.physics.state import BodyState


class Px4SetpointController(Px4Controller):
    """``Px4Controller`` for the setpoints between its levels, as PX4 logs them.

    Its action holds, for the laws ``rates``, ``attitude`` and ``position``:

        normalised thrust [-], body rates [rad/s]
        normalised thrust [-], quaternion
        position [m], yaw [rad], velocity of the position [m/s]
    """

    def outer(self, state: BodyState, action: Tensor, memory: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Return normalised thrust and body-rate setpoint [rad/s], (E, 4), of an action."""
        still = torch.zeros_like(action[:, 3])
        if self._law == "rates":
            return action, memory
        if self._law == "attitude":
            return torch.cat((action[:, :1], self._rate_setpoint(state, action[:, 1:], still)), dim=-1), memory
        velocity = self.gains.position.position * (action[:, :3] - state.position) + action[:, 4:]
        thrust, memory = self._thrust(state, velocity, memory, begins)
        heading = torch.stack((torch.cos(action[:, 3]), torch.sin(action[:, 3]), still), dim=-1)
        rates = self._rate_setpoint(state, attitude_from_thrust(thrust, heading), still)
        return torch.cat((thrust.norm(dim=-1, keepdim=True), rates), dim=-1), memory
