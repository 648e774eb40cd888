"""The readable reference backend in torch: any float type, CPU or GPU, differentiable through a whole rollout."""

import torch
from torch import Tensor

from aerial_gym.config.contact import ContactCfg
from aerial_gym.errors import CapabilityError
from aerial_gym.physics.backend import BACKENDS, Capabilities, ControlLaw
from aerial_gym.physics.contact import POSITION_SHARE
from aerial_gym.physics.ground import Ground, push_off_ground, touches_ground
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
        self._share = POSITION_SHARE[integrator]
        self.set_model(model)

    def set_model(self, model: Model) -> None:
        """Take other parameters."""
        self._model = model

    def advance(self, state: BodyState, command: Tensor, dt: float, substeps: int) -> BodyState:
        """Return the state after ``substeps`` of ``dt`` [s], differentiable; a ground that pushes does so here as well."""
        if self._ground is None or self._ground.cfg is None:
            return advance(self._model, self._stepper, self._control, state, command, dt, substeps)
        for _ in range(substeps):
            state, _, _ = self._advance_on_ground(self._ground, self._ground.cfg, state, command, dt)
        return state

    def _advance_on_ground(
        self, ground: Ground, cfg: ContactCfg, state: BodyState, command: Tensor, dt: float
    ) -> tuple[BodyState, Tensor, Tensor]:
        """Return the state after one substep, the impulse of the ground (E, 3) and which crash (E,)."""
        before = to_mass_state(self._model, state)
        free = self._stepper(self._model, before, self._control.rotor_command(state, command), dt)
        after, impulse, crashes = push_off_ground(ground, cfg, self._model, before, free, dt=dt, share=self._share)
        return to_body_state(self._model, after), impulse, crashes

    @torch.no_grad()
    def step(self, state: BodyState, command: Tensor, dt: float, substeps: int) -> None:
        """Advance ``state`` in place."""
        ground = self._ground
        if ground is None:
            state.copy_(self.advance(state, command, dt, substeps))
            return
        for _ in range(substeps):
            if ground.cfg is None:
                state.copy_(self.advance(state, command, dt, 1))
                ground.contact.logical_or_(touches_ground(ground, state))
                continue
            after, impulse, crashes = self._advance_on_ground(ground, ground.cfg, state, command, dt)
            state.copy_(after)
            ground.contact.logical_or_(crashes)
            if ground.impulse is not None:
                ground.impulse.add_(impulse)

    def reset(self, mask: Tensor) -> None:
        """Nothing to forget: all memory is in the state."""
        del mask


BACKENDS.register("torch", TorchBackend)
