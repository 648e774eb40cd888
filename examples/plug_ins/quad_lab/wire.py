"""A backend: vehicles on vertical wires, by the torch backend with another stepper."""

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from aerial_gym.physics import BodyState, TorchBackend
from aerial_gym.physics.integrators import semi_implicit_euler
from aerial_gym.physics.model import Model


def step_along_wire(model: Model, state: BodyState, rotor_command: Tensor, dt: float) -> BodyState:
    """Return the state after a semi-implicit Euler step [s], with the centre of mass on a vertical wire."""
    free = semi_implicit_euler(model, state, rotor_command, dt)
    up = torch.tensor((0.0, 0.0, 1.0), dtype=free.position.dtype, device=free.position.device)
    position = torch.where(up > 0.0, free.position, state.position)
    return replace(free, position=position, lin_vel=up * free.lin_vel)


class WireBackend(TorchBackend):
    """Vehicles on vertical wires, as on a test stand."""

    name = "wire"
    capabilities = replace(TorchBackend.capabilities, integrators=("euler",), joints=False)

    def make_stepper(self, integrator: str) -> Callable[[Model, BodyState, Tensor, float], BodyState]:
        """Return the stepper of the wire."""
        return step_along_wire
