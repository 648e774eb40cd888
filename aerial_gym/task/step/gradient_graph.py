"""Inputs of terms with gradients: motion and actions of a differentiable simulation, and quantities derived from them.

The Global Tensor Dictionary and the task's buffers have no gradients and are overwritten in every step. With a graph the
functions that otherwise become kernels run as torch operations, on tensors that are never overwritten.
Letters: E environments.
"""

from collections.abc import Mapping

from torch import Tensor

from aerial_gym.physics.torch_backend import copy_tensors
from aerial_gym.robots.differentiable import DifferentiableBackend


class GradientGraph:
    """Values by name with their gradients: of the simulation, and of the buffers that the task writes."""

    def __init__(self, simulation: DifferentiableBackend) -> None:
        """Take the part of a simulation that has gradients."""
        self._simulation = simulation
        self._own: dict[str, Tensor] = {}
        self._places: dict[str, Tensor] = {}

    def select(self, reads: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return tensors by name: with their gradients where they have any, else as copies."""
        motion = self._simulation.gradient_tensors
        tensors: dict[str, Tensor] = {}
        for name, tensor in reads.items():
            if name in motion:
                tensors[name] = motion[name]
            else:
                tensors[name] = self._own[name] if name in self._own else tensor.clone()
        return tensors

    def keep(self, written: Mapping[str, Tensor]) -> None:
        """Store new values of buffers, with their gradients."""
        self._own |= written

    def detach(self) -> None:
        """Cut the gradients at this instant."""
        self._own = {name: tensor.detach() for name, tensor in self._own.items()}

    def settle(self) -> None:
        """Cut the gradients at this instant, in tensors that stay the same at every call."""
        self._own = copy_tensors(self._places, self._own)

    def forget(self) -> None:
        """Drop the stored values, as the buffers were written from outside."""
        self._own.clear()
