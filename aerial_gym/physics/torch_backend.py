"""The readable reference backend in torch: any float type, CPU or GPU, differentiable through a whole rollout."""

import torch
from torch import Tensor

from aerial_gym.errors import CapabilityError
from aerial_gym.physics.backend import BACKENDS, Capabilities, ControlLaw
from aerial_gym.physics.ground import Ground, touches_ground
from aerial_gym.physics.integrators import INTEGRATORS, Stepper, to_body_state, to_mass_state
from aerial_gym.physics.model import Model
from aerial_gym.physics.state import BodyState


def advance(
    model: Model, stepper: Stepper, control: ControlLaw, state: BodyState, command: Tensor, dt: float, substeps: int
) -> BodyState:
    """Return the state after ``substeps`` of ``dt`` [s]; the control law runs before each. Differentiable.

    Args:
        model: Vehicle and effects.
        stepper: One of ``INTEGRATORS``.
        control: Turns the action into rotor commands.
        state: Motion of the body origin and rotor speeds.
        command: Action, held, (E, number of actions).
        dt: Length of one substep [s].
        substeps: How many.
    """
    for _ in range(substeps):
        rotor_command = control.rotor_command(state, command)
        state = to_body_state(model, stepper(model, to_mass_state(model, state), rotor_command, dt))
    return state


class TorchBackend:
    """Physics in plain torch operations."""

    capabilities = Capabilities(
        devices=("cpu", "cuda"),
        dtypes=(torch.float32, torch.float64),
        integrators=tuple(INTEGRATORS),
        differentiable=True,
        effects=None,
    )

    _model: Model
    _control: ControlLaw
    _stepper: Stepper

    def allocate(self, model: Model, control: ControlLaw, *, integrator: str, ground: Ground | None = None) -> None:
        """Take model, control law, stepper by name, and ground."""
        if integrator not in INTEGRATORS:
            raise CapabilityError(f"backend torch: no integrator {integrator!r}. Known: {', '.join(INTEGRATORS)}")
        self._stepper, self._control, self._ground = INTEGRATORS[integrator], control, ground
        self.set_model(model)

    def set_model(self, model: Model) -> None:
        """Take other parameters."""
        self._model = model

    def advance(self, state: BodyState, command: Tensor, dt: float, substeps: int) -> BodyState:
        """Return the state after ``substeps`` of ``dt`` [s], differentiable."""
        return advance(self._model, self._stepper, self._control, state, command, dt, substeps)

    @torch.no_grad()
    def step(self, state: BodyState, command: Tensor, dt: float, substeps: int) -> None:
        """Advance ``state`` in place."""
        if self._ground is None:
            state.copy_(self.advance(state, command, dt, substeps))
            return
        for _ in range(substeps):
            state.copy_(self.advance(state, command, dt, 1))
            self._ground.contact.logical_or_(touches_ground(self._ground, state))

    def reset(self, mask: Tensor) -> None:
        """Nothing to forget: all memory is in the state."""
        del mask


BACKENDS.register("torch", TorchBackend)
