"""The interface of physics backends."""

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from aerial_gym.math.random import Randomness
from aerial_gym.physics.effects import EFFECTS, Effect, LearnedResidual
from aerial_gym.physics.ground import Ground
from aerial_gym.physics.model import Model
from aerial_gym.physics.state import BodyState, JointEfforts
from aerial_gym.physics.substep_hook import SubstepHook


@dataclass(frozen=True, kw_only=True)
class Capabilities:
    """Capabilities of a backend."""

    devices: tuple[str, ...]  # Types of device, `cpu` or `cuda`
    dtypes: tuple[torch.dtype, ...]  # Float types of the state
    integrators: tuple[str, ...]  # Names of integrators
    differentiable: bool  # Whether gradients flow through a rollout
    effects: Collection[str] | None  # Names of supported effects; None for every one with a torch formula
    lacks: tuple[str, ...] = ()  # Names of unsupported effects, as exceptions
    rotors: tuple[str, ...] = ()  # Supported traits of rotors, of `config.rotor.ROTOR_TRAITS`
    contact: bool = False  # Whether ground and obstacles have contact forces
    joints: bool = False  # Whether vehicles may have joints
    contact_of_links: bool = False  # Whether links have contact forces with ground, obstacles and each other


class EffectSupport(Collection[str]):
    """Names of supported effects. An effect is imported at its test, because a vehicle has few."""

    def __init__(self, can_run: Callable[[Effect], bool]) -> None:
        self._can_run = can_run

    def __contains__(self, name: object) -> bool:
        named = isinstance(name, str) and name in EFFECTS and self._can_run(EFFECTS.get(name))
        return named or name == LearnedResidual.name

    def __iter__(self) -> Iterator[str]:
        return (name for name in (*sorted(EFFECTS), LearnedResidual.name) if name in self)

    def __len__(self) -> int:
        return sum(1 for _ in self)


class ControlLaw(Protocol):
    """Control law: it turns an action into rotor commands, once per physics step. All controllers implement it."""

    action_names: tuple[str, ...]  # Meaning and unit of each entry of an action

    def rotor_command(self, state: BodyState, action: Tensor) -> Tensor:
        """Return commanded rotor speeds [rad/s], (E, R), for actions (E, number of actions).

        The fused backend traces it, so it must be the same arithmetic in every environment. A law with memory has ``needs``,
        ``outer`` and ``inner`` too (``control.stateful``).
        """
        ...


class PhysicsBackend(Protocol):
    """Engine of a batch of multirotors. ``step`` works in place, so that its tensors can be captured in a graph."""

    @property
    def capabilities(self) -> Capabilities:
        """Capabilities of this backend."""
        ...

    def allocate(
        self, model: Model, control: ControlLaw, *, integrator: str, ground: Ground | None = None,
        hook: SubstepHook | None = None, random: Randomness | None = None, efforts: JointEfforts | None = None,
    ) -> None:  # fmt: skip
        """Set model, control law, integrator, ground, substep hook and random numbers, and allocate all buffers.

        Without random numbers, seed 0 counts. ``step`` writes the efforts applied to joints into ``efforts``, if given.

        Raises:
            CapabilityError: If the backend lacks a requested capability, which the message names.
        """
        ...

    def advance(self, state: BodyState, command: Tensor, dt: float, substeps: int) -> BodyState:
        """Return the state after ``substeps`` of ``dt`` [s]; differentiable if the capabilities say so."""
        ...

    def step(self, state: BodyState, command: Tensor, dt: float, substeps: int) -> None:
        """Advance ``state`` in place by ``substeps`` of ``dt`` [s] with the action ``command`` (E, n) held."""
        ...

    def reset_memory(self, mask: Tensor) -> None:
        """Reset the backend's memory of the environments in ``mask``, bool (E,)."""
        ...

    def set_model(self, model: Model) -> None:
        """Replace the parameters by others of the same shapes."""
        ...

    def take_ground_heights(self) -> None:
        """Update the ground heights from ``Model.ground_height`` if that is a tensor (E, 1)."""
        ...

    def wake_memory(self) -> list[Tensor]:
        """Return the memory (E,) of the last parameter of each ``effects.wakes.WakeSum``, from which a step reads it."""
        ...

    def link_state_of_load(self) -> Tensor | None:
        """Return direction and rate of the load's link, world, (E, 6); None without a load."""
        ...

    def prepare(self, dt: float) -> None:
        """Prepare all values and buffers that depend on the length of a substep [s]."""
        ...

    def state_tensors(self) -> dict[str, Tensor]:
        """Return the state for a checkpoint, by name, once prepared: parameters, and memory of effects and control law."""
        ...

    def parameter_rows(self, model: Model) -> tuple[Tensor, ...]:
        """Return the stored parameters of a model per environment, (E, ...), as a row function of the model."""
        ...

    def parameter_targets(self) -> tuple[Tensor, ...]:
        """Return the memory of ``parameter_rows``, in the same order; writing its rows changes environments' parameters."""
        ...
