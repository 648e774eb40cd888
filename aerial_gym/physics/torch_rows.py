"""A substep of the torch backend without memory, as one kernel forward and one backward.

Letters: E environments, C collision spheres.
"""

from collections.abc import Callable
from functools import partial

from torch import Tensor

from aerial_gym.interop.rows import DifferentiableRows
from aerial_gym.physics.ground import Ground, touches_ground
from aerial_gym.physics.state import BodyState

Substep = Callable[[BodyState, Tensor, float], BodyState]  # State, action (E, U) and dt [s] to the state after dt


class SubstepRows:
    """A substep of the torch backend as row kernels, with contact flags of the ground."""

    def __init__(self, substep: Substep, state: BodyState, action: Tensor, dt: float, ground: Ground | None) -> None:
        """Trace the substep and its gradient with respect to state and action.

        Args:
            substep: Function whose parameters must keep their memory.
            state: Example state.
            action: Example action, (E, number of actions).
            ground: Ground whose ``contact`` is set; None without ground.

        Raises:
            UntraceableError: If the substep cannot be computed row by row; the text states the reason.
        """
        self._names, self._ground = tuple(vars(state)), ground
        rows = [action, *state.tensors()]
        if ground is not None:
            rows.append(ground.spheres)
        self._rows = DifferentiableRows(partial(self._compute, substep, dt), rows, lifts=True)

    def __call__(self, state: BodyState, action: Tensor) -> BodyState:
        """Return the differentiable state after the substep, and update the ground's contacts."""
        if self._ground is None:
            return self._state(self._rows(action, *state.tensors()))
        *after, touches = self._rows(action, *state.tensors(), self._ground.spheres)
        self._ground.contact.logical_or_(touches)
        return self._state(after)

    def _compute(self, substep: Substep, dt: float, action: Tensor, *given: Tensor) -> tuple[Tensor, ...]:
        after = substep(self._state(given[: len(self._names)]), action, dt)
        if self._ground is None:
            return after.tensors()
        spheres = given[-1]
        ground = Ground(height=self._ground.height, spheres=spheres, contact=self._ground.contact)
        return (*after.tensors(), touches_ground(ground, after))

    def _state(self, tensors: "list[Tensor] | tuple[Tensor, ...]") -> BodyState:
        return BodyState(**dict(zip(self._names, tensors, strict=True)))
