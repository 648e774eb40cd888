"""The reference backend in torch: any float type, CPU or GPU, differentiable through a whole rollout."""

import logging
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from math import nan
from typing import TYPE_CHECKING, TypeVar

import torch
from torch import Tensor

from aerial_gym.config.environment import ContactCfg
from aerial_gym.config.rotor import ROTOR_TRAITS
from aerial_gym.errors import CapabilityError
from aerial_gym.interop.rows import UntraceableError
from aerial_gym.math.random import Randomness
from aerial_gym.physics.backend import Capabilities, ControlLaw
from aerial_gym.physics.contact import displacement_per_velocity_change
from aerial_gym.physics.effects import FluidEffect, LoadEffect
from aerial_gym.physics.effects.wakes import WakeSum
from aerial_gym.physics.ground import Ground, push_off_ground, touches_ground
from aerial_gym.physics.integrators import INTEGRATORS, MassState, Stepper, to_body_state, to_mass_state
from aerial_gym.physics.law_memory import (
    LawMemory,
    check_law_step,
    fresh_law_memory,
    law_needs,
    reset_law_memory,
    rotor_command_and_memory,
)
from aerial_gym.physics.memory import (
    Memory,
    begin_substep,
    end_substep,
    link_state_of_load,
    make_memory,
    num_past_commands,
    reset_effect_memory,
)
from aerial_gym.physics.model import Model
from aerial_gym.physics.rotor_lag import LinearRotorSpeeds, stop_in_dead_band
from aerial_gym.physics.state import ArticulatedState, BodyState, JointEfforts
from aerial_gym.physics.substep_hook import SubstepHook, check_substeps
from aerial_gym.physics.torch_rows import SubstepRows
from aerial_gym.physics.vehicle import is_shared

if TYPE_CHECKING:
    from aerial_gym.physics.articulated.tree import TreeState

_log = logging.getLogger(__name__)


def advance(
    model: Model, stepper: Stepper, control: ControlLaw, state: BodyState, command: Tensor, dt: float, substeps: int
) -> BodyState:
    """Return the state after ``substeps`` of ``dt`` [s], each with a run of the control law. Differentiable.

    Effects and laws with memory start as after a reset; a backend keeps their memory between calls.

    Args:
        stepper: One of ``INTEGRATORS``.
        control: Control law.
        state: Motion of the body origin and rotor speeds.
        command: Constant action, (E, number of actions).
        dt: Length of one substep [s].
    """
    memory, law_memory = make_memory(model, dt) if model.effects.names_with_memory else None, None
    needs = law_needs(control)
    if needs is not None:
        check_law_step(needs, dt)
        law_memory = fresh_law_memory(needs, state.num_envs, state.position)
    return advance_remembering(model, stepper, control, state, command, dt, substeps, memory, law_memory)[0]


def advance_remembering(
    model: Model, stepper: Stepper, control: ControlLaw | None, state: BodyState, command: Tensor | LinearRotorSpeeds,
    dt: float, substeps: int, memory: Memory | None, law_memory: LawMemory | None = None,
) -> tuple[BodyState, Memory | None]:  # fmt: skip
    """Return the state of ``advance`` from a given memory, and the new memory; None if no effect has memory.

    Without a control law, ``command`` is the rotor command.
    """
    rotor_command = command
    for _ in range(substeps):
        if control is not None:
            assert isinstance(command, Tensor)
            rotor_command, law_memory = rotor_command_and_memory(control, state, command, law_memory)
        _, after, memory = _substep(model, stepper, state, rotor_command, dt, memory)
        state = to_body_state(model, after)
    return state, memory


def _substep(
    model: Model, stepper: Stepper, state: BodyState, rotor_command: Tensor | LinearRotorSpeeds, dt: float,
    memory: Memory | None,
) -> tuple[MassState, MassState, Memory | None]:  # fmt: skip
    """Return the motion before and after a substep, and the new memory."""
    if isinstance(rotor_command, Tensor):
        rotor_command = stop_in_dead_band(model.vehicle, rotor_command)
    if memory is None:
        before = to_mass_state(model, state)
        return before, stepper(model, before, rotor_command, dt), None
    now, followed, memory = begin_substep(model, memory, state.rotor_speed, rotor_command, dt)
    before = to_mass_state(model, state, link_state_of_load(model, memory))
    after = stepper(now, before, followed, dt)
    return before, after, end_substep(memory, after.load)


AnyMemory = TypeVar("AnyMemory", Memory, LawMemory)


def _store_memory(old: AnyMemory | None, new: AnyMemory | None) -> AnyMemory | None:
    """Return the memory to keep: the old one, written in place for captured steps, or the new one if it has gradients."""
    if new is None or old is None or any(part.requires_grad for m in (new, old) for part in m.tensors().values()):
        return new
    for kept, part in zip(old.tensors().values(), new.tensors().values(), strict=True):
        kept.copy_(part)
    return old


def _memory_without_gradients(memory: AnyMemory) -> AnyMemory:
    """Return the memory detached from gradients."""
    return replace(memory, **{name: tensor.detach() for name, tensor in memory.tensors().items()})


@torch.no_grad()
def copy_tensors(places: dict[str, Tensor], tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Copy tensors into ``places``, allocating new names, and return these."""
    for name, tensor in tensors.items():
        if name not in places or places[name].shape != tensor.shape:
            places[name] = tensor.clone()
        elif places[name] is not tensor:
            places[name].copy_(tensor)
    return {name: places[name] for name in tensors}


class TorchBackend:
    """Physics in plain torch operations."""

    name = "torch"  # Registered name

    capabilities = Capabilities(
        devices=("cpu", "cuda"),
        dtypes=(torch.float32, torch.float64),
        integrators=tuple(INTEGRATORS),
        differentiable=True,
        effects=None,
        rotors=ROTOR_TRAITS,
        contact=True,
        joints=True,
    )

    _model: Model
    _control: ControlLaw
    _stepper: Stepper
    _memory: Memory | None = None
    _random: Randomness | None = None
    _efforts: JointEfforts | None = None
    _crept: Tensor | None = None
    law_memory: LawMemory | None = None  # Memory of the control law; None before its first step, and without memory

    def allocate(
        self, model: Model, control: ControlLaw, *, integrator: str, ground: Ground | None = None,
        hook: SubstepHook | None = None, random: Randomness | None = None, efforts: JointEfforts | None = None,
    ) -> None:  # fmt: skip
        """Set model, control law, integrator by name, ground, hook, random numbers and tensors of applied efforts."""
        if integrator not in self.capabilities.integrators:
            known = ", ".join(self.capabilities.integrators)
            raise CapabilityError(f"backend {self.name}: no integrator {integrator!r}. Known: {known}")
        if model.articulation is not None:
            from aerial_gym.physics.articulated.flight import check_integrator_and_ground

            check_integrator_and_ground(integrator, ground, self.capabilities)
        self._stepper, self._control, self._ground = self.make_stepper(integrator), control, ground
        self._hook, self._efforts = hook, efforts
        self._share = displacement_per_velocity_change(integrator, in_fluid=bool(model.effects[FluidEffect]))
        self._memory, self.law_memory, self._random, self._crept = None, None, random, None
        self._places: tuple[dict[str, Tensor], ...] = ({}, {}, {})
        self.set_model(model)

    def make_stepper(self, integrator: str) -> Stepper:
        """Return the integrator of the body for one of ``capabilities.integrators``; other engines override it."""
        return INTEGRATORS[integrator]

    def tree_stepper(self, model: Model, dt: float) -> "Callable[..., TreeState]":
        """Return the integrator of an articulated vehicle's links for substeps of ``dt`` [s], like ``implicit_euler``."""
        from aerial_gym.physics.articulated.steppers import implicit_euler

        return implicit_euler

    def set_model(self, model: Model) -> None:
        """Replace the parameters."""
        self._model = model
        rows = model.vehicle.tensors_by_name() | {"inertia_inverse": model.inertia_inverse}
        self._own = [name for name, kept in rows.items() if not is_shared(kept)]

    def take_ground_heights(self) -> None:
        """Do nothing, because every step reads the tensor."""

    def wake_memory(self) -> list[Tensor]:
        """Return the column of the parameters, which every step reads."""
        return [params[:, -1] for _, params in self._model.effects[WakeSum]]

    def link_state_of_load(self) -> Tensor | None:
        """Return direction and rate of the load's link, (E, 6); None without a load."""
        return (
            link_state_of_load(self._model, self._memory)
            if self._memory is not None and self._model.effects[LoadEffect]
            else None
        )

    def prepare(self, dt: float) -> None:
        """Allocate the memory of effects and control law."""
        self._get_memory(dt)
        self._get_law_memory(self._model.vehicle.mass, dt)
        if self._model.articulation is not None and self._model.articulation.num_creep and self._crept is None:
            self._crept = self._model.articulation.unset_dashpots(self._model.vehicle.num_envs)

    def state_tensors(self) -> dict[str, Tensor]:
        """Return the state for a checkpoint, by name."""
        tensors = {f"parameter.{i}": rows for i, rows in enumerate(self.parameter_targets())}
        for name, memory in (("memory", self._memory), ("law", self.law_memory)):
            if memory is not None:
                tensors |= {f"{name}.{key}": tensor for key, tensor in memory.tensors().items()}
        return tensors if self._crept is None else tensors | {"crept": self._crept}

    def parameter_rows(self, model: Model) -> tuple[Tensor, ...]:
        """Return the vehicle's parameters that differ between environments, and the inverse inertia."""
        rows = model.vehicle.tensors_by_name() | {"inertia_inverse": model.inertia_inverse}
        return tuple(rows[name] for name in self._own)

    def parameter_targets(self) -> tuple[Tensor, ...]:
        """Return these tensors of the own model."""
        return self.parameter_rows(self._model)

    def advance(self, state: BodyState, command: Tensor, dt: float, substeps: int) -> BodyState:
        """Return the state after ``substeps`` of ``dt`` [s], differentiable, with contact forces of the ground.

        Effects continue with their memory of the previous call, through which gradients flow as well.
        """
        for _ in range(substeps):
            if self._ground is None or self._ground.cfg is None:
                _, state = self._free_substep_of_body(state, command, dt)
            else:
                _, state, _, _ = self._advance_on_ground(self._ground, self._ground.cfg, state, command, dt)
        return state

    def _free_substep_of_body(self, state: BodyState, command: Tensor, dt: float) -> tuple[MassState, BodyState]:
        """Return motion before and state after a substep without contact, of a rigid or articulated vehicle."""
        if self._model.articulation is None:
            before, after = self._free_substep(state, command, dt)
            return before, to_body_state(self._model, after)
        assert isinstance(state, ArticulatedState)
        return to_mass_state(self._model, state), self._articulated_substep(state, command, dt)

    def _articulated_substep(self, state: ArticulatedState, command: Tensor, dt: float) -> ArticulatedState:
        """Return the state after a substep; the last entries of the action command the joints' drives."""
        from aerial_gym.physics.articulated.flight import articulated_step

        memory, model = self._get_memory(dt), self._model
        assert model.articulation is not None
        num_actions = command.shape[1] - model.articulation.num_driven
        command, joint_command = command[:, :num_actions], command[:, num_actions:]
        followed, law_memory = rotor_command_and_memory(
            self._control, state, command, self._get_law_memory(state.position, dt)
        )
        followed = stop_in_dead_band(model.vehicle, followed)
        self.law_memory = _store_memory(self.law_memory, law_memory)
        if memory is not None:
            model, followed, memory = begin_substep(model, memory, state.rotor_speed, followed, dt)
            self._memory = _store_memory(self._memory, end_substep(memory, state.position[:, :0]))
        stepper = self.tree_stepper(model, dt)
        step = partial(
            articulated_step, model, state, followed, joint_command, dt, stepper=stepper, applied=self._efforts
        )
        bends = self._model.articulation
        if bends is None or not bends.num_creep:
            return step()
        before = bends.unset_dashpots(state.num_envs) if self._crept is None else self._crept
        crept = bends.initialise_creep(before, state.joint_pos)
        after = step(crept=crept)
        crept = bends.advance_creep(crept, after.joint_pos, dt)
        self._crept = crept if self._crept is None or crept.requires_grad else self._crept.copy_(crept)
        return after

    def _free_substep(self, state: BodyState, command: Tensor, dt: float) -> tuple[MassState, MassState]:
        """Return the motion before and after a substep without contact."""
        memory = self._get_memory(dt)
        rotor_command, law_memory = rotor_command_and_memory(
            self._control, state, command, self._get_law_memory(state.position, dt)
        )
        before, after, memory = _substep(self._model, self._stepper, state, rotor_command, dt, memory)
        self._memory = _store_memory(self._memory, memory)
        self.law_memory = _store_memory(self.law_memory, law_memory)
        return before, after

    def _get_law_memory(self, like: Tensor, dt: float) -> LawMemory | None:
        """Return the memory of the control law, allocated at its first step."""
        needs = law_needs(self._control)
        if needs is None:
            return None
        check_law_step(needs, dt)
        if self.law_memory is None:
            self.law_memory = fresh_law_memory(needs, like.shape[0], like)
        return self.law_memory

    def _get_memory(self, dt: float) -> Memory | None:
        """Return the memory of effects, reallocated if the length of a substep changes the number of commands."""
        if not self._model.effects.names_with_memory:
            return None
        if self._memory is None or self._memory.past.shape[1] != num_past_commands(self._model, dt):
            self._memory = make_memory(self._model, dt, random=self._random)
        return self._memory

    def _advance_on_ground(
        self, ground: Ground, cfg: ContactCfg, state: BodyState, command: Tensor, dt: float
    ) -> tuple[MassState, BodyState, Tensor, Tensor]:
        """Return motion before and state after a substep, impulse of the ground (E, 3), and crash flags (E,)."""
        before, free = self._free_substep(state, command, dt)
        after, impulse, crashes = push_off_ground(ground, cfg, self._model, before, free, dt=dt, share=self._share)
        return before, to_body_state(self._model, after), impulse, crashes

    @torch.no_grad()
    def step(self, state: BodyState, command: Tensor, dt: float, substeps: int) -> None:
        """Advance ``state`` in place."""
        check_substeps(self._hook, substeps)
        if self._hook is not None:
            self._hook.begin(state)
        for k in range(substeps):
            before = self._step_once(state, command, dt)
            if self._hook is not None:
                self._hook.after_substep(k, before, state)

    def _step_once(self, state: BodyState, command: Tensor, dt: float) -> MassState:
        """Advance ``state`` in place by one substep and update the ground's contacts; return a copy of the motion before."""
        before, after = self.advance_once(state, command, dt)
        before = MassState(**{name: tensor.clone() for name, tensor in vars(before).items()})
        state.copy_(after)
        return before

    def make_substep_rows(self, state: BodyState, command: Tensor, dt: float) -> SubstepRows | None:
        """Return a substep as one kernel for such a state and action; None if it needs torch operations.

        Memory of effects or law, or contact forces, need them. The kernel is valid until the model is replaced.
        """
        ground, model = self._ground, self._model
        remembers = model.effects.names_with_memory or law_needs(self._control) is not None
        if remembers or model.articulation is not None or (ground is not None and ground.cfg is not None):
            return None

        def substep(state: BodyState, command: Tensor, dt: float) -> BodyState:
            return to_body_state(model, self._free_substep(state, command, dt)[1])

        try:
            return SubstepRows(substep, state, command, dt, ground)
        except UntraceableError as error:
            _log.warning("gradients of the physics run as many small torch operations: %s", error)
            return None

    def advance_once(self, state: BodyState, command: Tensor, dt: float) -> tuple[MassState, BodyState]:
        """Return motion before and state after a substep, differentiable, and update the ground's contacts."""
        ground = self._ground
        if ground is None or ground.cfg is None:
            before, after = self._free_substep_of_body(state, command, dt)
            if ground is not None:
                ground.contact.logical_or_(touches_ground(ground, after))
            return before, after
        before, after, impulse, crashes = self._advance_on_ground(ground, ground.cfg, state, command, dt)
        ground.contact.logical_or_(crashes)
        if ground.impulse is not None:
            ground.impulse.add_(impulse.detach())
        return before, after

    def detach(self) -> None:
        """Detach the memory of effects, law and dashpots from gradients."""
        if self._memory is not None:
            self._memory = _memory_without_gradients(self._memory)
        if self.law_memory is not None:
            self.law_memory = _memory_without_gradients(self.law_memory)
        if self._crept is not None:
            self._crept = self._crept.detach()

    def detach_in_place(self) -> None:
        """Detach the memory from gradients, in the same tensors at every call."""
        self.detach()
        if self._memory is not None:
            self._memory = replace(self._memory, **copy_tensors(self._places[0], self._memory.tensors()))
        if self.law_memory is not None:
            self.law_memory = replace(self.law_memory, **copy_tensors(self._places[1], self.law_memory.tensors()))
        if self._crept is not None:
            self._crept = copy_tensors(self._places[2], {"crept": self._crept})["crept"]

    def reset_memory_with_gradients(self, mask: Tensor) -> None:
        """Reset the memory of the environments in ``mask``, and keep the gradients of others.

        The graph keeps the mask, which must not change.
        """
        if self._memory is not None:
            self._memory = reset_effect_memory(self._memory, mask)
        if self.law_memory is not None:
            self.law_memory = reset_law_memory(self.law_memory, mask)
        if self._crept is not None:
            self._crept = torch.where(mask[:, None, None], nan, self._crept)

    @torch.no_grad()
    def reset_memory(self, mask: Tensor) -> None:
        """Reset the memory of the environments in ``mask``; gradients through memory end for all."""
        self.detach()
        if self._memory is not None:
            self._memory = _store_memory(self._memory, reset_effect_memory(self._memory, mask))
        if self.law_memory is not None:
            self.law_memory = _store_memory(self.law_memory, reset_law_memory(self.law_memory, mask))
        if self._crept is not None:
            self._crept.masked_fill_(mask[:, None, None], nan)
