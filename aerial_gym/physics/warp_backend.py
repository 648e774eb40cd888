"""The fused backend in Warp: all substeps of a step in one launch, float32, CPU and CUDA.

Letters: E environments, R rotors, U entries of an action, N numbers per environment.
"""

from dataclasses import dataclass, replace
from math import nan
from typing import Any, NamedTuple

import torch
import warp as wp
from torch import Tensor

from aerial_gym import interop
from aerial_gym.config.rotor import ROTOR_TRAITS
from aerial_gym.errors import CapabilityError, ShapeError
from aerial_gym.math.draws import random_arrays
from aerial_gym.math.random import Randomness
from aerial_gym.math.warp_functions import vector_type
from aerial_gym.physics.backend import Capabilities, ControlLaw, EffectSupport
from aerial_gym.physics.contact import displacement_per_velocity_change
from aerial_gym.physics.effects import Effect, FluidEffect, LoadEffect
from aerial_gym.physics.effects.wakes import WakeSum
from aerial_gym.physics.fused.contact import contact_parameters
from aerial_gym.physics.fused.dynamics import STAGES
from aerial_gym.physics.fused.gradient import Rollout
from aerial_gym.physics.fused.hook import NoHook
from aerial_gym.physics.fused.kernel import make_kernel
from aerial_gym.physics.fused.law import FusedLaw, fuse_law
from aerial_gym.physics.fused.memory import MemoryArrays, memory_type
from aerial_gym.physics.fused.packing import (
    Numbers,
    Packing,
    collect_numbers,
    law_rows,
    make_packing,
    make_structs,
    pack_rows,
    parameter_rows,
    rotor_types_of_model,
)
from aerial_gym.physics.fused.types import LawArrays, rotor_types
from aerial_gym.physics.ground import Ground
from aerial_gym.physics.law_memory import LawMemory, check_law_step, fresh_law_memory, law_needs
from aerial_gym.physics.memory import Memory, make_memory, num_past_commands
from aerial_gym.physics.model import Model
from aerial_gym.physics.state import BodyState, JointEfforts
from aerial_gym.physics.substep_hook import SubstepHook, check_substeps
from aerial_gym.physics.vehicle import is_same_row, is_shared

BLOCK_DIM = 128  # Threads of a block; measured in docs/results/performance.md
ROW_GAP = 32  # Padding between packed rows; rows of a power of two would share a line of a CPU's cache
MIN_STEPS_PER_THREAD = 4096  # Least substeps per CPU thread; with fewer the start of a thread (50 µs) costs more


class _GroundArrays(NamedTuple):
    """Kernel arguments of a ground: three inputs, two outputs."""

    spheres: wp.array
    height: float
    law: Any
    contact: wp.array
    impulse: wp.array


@dataclass(frozen=True)
class _LaunchRecord:
    """Recorded launches for particular tensors."""

    state: BodyState
    command: Tensor
    dt: float
    substeps: int
    launches: list[interop.ReusableLaunch]


class WarpBackend:
    """Physics in one fused kernel, composed at ``allocate`` from control law, effects and integrator.

    On the CPU the batch is split over as many threads as torch is allowed (``torch.set_num_threads``).
    """

    def __init__(self, *, differentiable: bool = False) -> None:
        """Make a backend; with ``differentiable``, ``advance`` passes gradients through Warp's tape."""
        self._differentiable = differentiable
        self._random: Randomness | None = None
        self._memory: Memory | None = None
        self.law_memory: LawMemory | None = None

    @property
    def capabilities(self) -> Capabilities:
        """Capabilities; an effect whose code cannot be traced is refused by ``allocate``."""
        return Capabilities(
            devices=("cpu", "cuda"),
            dtypes=(torch.float32,),
            integrators=tuple(STAGES),
            differentiable=self._differentiable,
            effects=EffectSupport(self._can_run),
            rotors=ROTOR_TRAITS,
            contact=not self._differentiable,
            joints=not self._differentiable,
        )

    def _can_run(self, effect: Effect) -> bool:
        return not (self._differentiable and effect.remembers)

    def allocate(
        self, model: Model, control: ControlLaw, *, integrator: str, ground: Ground | None = None,
        hook: SubstepHook | None = None, random: Randomness | None = None, efforts: JointEfforts | None = None,
    ) -> None:  # fmt: skip
        """Compose the kernel and make the buffers.

        Raises:
            CapabilityError: If integrator, effect, control law or float type is not supported.
        """
        if integrator not in STAGES:
            raise CapabilityError(f"backend warp: no integrator {integrator!r}. Known: {', '.join(STAGES)}")
        if self._differentiable and model.effects.names_with_memory:
            raise CapabilityError(
                f"backend warp: a differentiable rollout cannot run effect {model.effects.names_with_memory[0]!r}, "
                "which has memory. Use backend 'torch'."
            )
        if model.articulation is not None:
            if self._differentiable:
                raise CapabilityError("backend warp: a differentiable rollout moves no joints. Use backend 'torch'.")
            from aerial_gym.physics.articulated.flight import check_integrator_and_ground

            check_integrator_and_ground(integrator, ground, self.capabilities)
        if isinstance(model.ceiling_height, torch.Tensor):
            raise CapabilityError("backend warp: one height of the ceiling for all. Use backend 'torch'.")
        if law_needs(control) is not None and self._differentiable:
            raise CapabilityError(
                f"backend warp: a differentiable rollout cannot run {type(control).__name__}, which has memory. "
                "Use backend 'torch'."
            )
        if model.vehicle.mass.dtype != torch.float32:
            raise CapabilityError(
                f"backend warp: float32 only, not {model.vehicle.mass.dtype}. Use backend 'torch' for others."
            )
        if ground is not None and self._differentiable:
            raise CapabilityError("backend warp: a differentiable rollout knows no ground. Use backend 'torch'.")
        if hook is not None and self._differentiable:
            raise CapabilityError("backend warp: a differentiable rollout follows no obstacles. Use backend 'torch'.")
        interop.start_warp()
        self._control, self._integrator, self._given_ground, self._hook, self._random, self._efforts = (
            control, integrator, ground, hook, random, efforts
        )  # fmt: skip
        self._compose(model, self._trace_law(model))

    def _trace_law(self, model: Model) -> FusedLaw:
        vehicle = model.vehicle
        return fuse_law(self._control, vehicle.num_envs, vehicle.num_rotors, differentiable=self._differentiable)

    def _compose(self, model: Model, law: FusedLaw) -> None:
        """Compose the kernel and make the buffers for a model that this backend can run."""
        self._law, self._model, integrator, ground, hook = law, model, self._integrator, self._given_ground, self._hook
        self._device = model.vehicle.mass.device
        self._num_envs, self._num_rotors = model.vehicle.num_envs, model.vehicle.num_rotors
        self._num_actions = law.num_actions + (0 if model.articulation is None else model.articulation.num_driven)
        self._dt, self._memory, self.law_memory = 0.0, None, None
        self._packing: Packing = make_packing(self._numbers(1.0), all_packed=self._differentiable)
        rows = torch.zeros(max(self._packing.total, 1), self._num_envs + ROW_GAP, device=self._device)
        self._packed = rows[:, : self._num_envs]
        self._ground = self._ground_arrays(ground)
        fused_hook = None if hook is None else hook.fused()
        self._hook_data = NoHook() if fused_hook is None else fused_hook.data
        num_spheres = 0 if ground is None else ground.spheres.shape[0]
        bends = model.articulation
        self._dashpots: Tensor | None = None
        if bends is not None:
            rows = max(bends.num_creep * bends.num_joints, 1)
            self._dashpots = torch.full((rows, self._num_envs), nan, device=self._device)
        if model.articulation is not None:
            from aerial_gym.physics.articulated.fused.kernel import make_jointed_kernel

            self.kernel = make_jointed_kernel(
                model, law, self._packing, num_spheres=num_spheres, hook=fused_hook, efforts=self._efforts is not None
            )
        else:
            self.kernel = make_kernel(
                model,
                law,
                integrator,
                self._packing,
                num_spheres=num_spheres,
                compliant=ground is not None and ground.cfg is not None,
                hook=fused_hook,
                com_offset=not is_shared(model.vehicle.com) or bool(model.vehicle.com[0].cpu().any()),
                differentiable=self._differentiable,
            )
        if not self._differentiable:
            interop.compile_ahead(self.kernel, wp.device_from_torch(self._device), block_dim=BLOCK_DIM)
        self._binding: _LaunchRecord | None = None

    def _ground_arrays(self, ground: Ground | None) -> _GroundArrays:
        """Return the kernel arguments of a ground."""
        if ground is None:
            placeholder = torch.zeros(1, 4, device=self._device)
            ground = Ground(
                height=0.0, spheres=placeholder, contact=torch.zeros(1, dtype=torch.bool, device=self._device)
            )
        impulse = ground.impulse
        if impulse is None:  # unread
            impulse = torch.zeros(self._num_envs if ground.cfg is not None else 1, 3, device=self._device)
        share = displacement_per_velocity_change(self._integrator, in_fluid=bool(self._model.effects[FluidEffect]))
        return _GroundArrays(
            wp.from_torch(ground.spheres, dtype=wp.vec4),
            ground.height,
            contact_parameters(ground.cfg, share),
            wp.from_torch(ground.contact),
            wp.from_torch(impulse, dtype=wp.vec3),
        )

    def _numbers(self, dt: float) -> Numbers:
        return collect_numbers(self._model, self._law, STAGES[self._integrator] * dt)

    def set_model(self, model: Model) -> None:
        """Replace the parameters.

        Parameters per environment are written in place, which a captured step uses. If a shared parameter changes, or is no
        longer shared, the kernel is recomposed, and a captured step needs a new capture.
        """
        old, self._model = self._model, model
        pairs = [*zip(model.vehicle.tensors_by_name().values(), old.vehicle.tensors_by_name().values(), strict=True)]
        pairs.append((model.other_position, old.other_position))
        changed = any(is_shared(kept) and new is not kept and not is_same_row(new, kept) for new, kept in pairs)
        if changed or not self._packing.fits(self._numbers(1.0)):
            memory, law_memory, dashpots = self._memory, self.law_memory, self._dashpots
            unchanged = self._law.structure.is_unchanged()
            self._compose(model, self._law if unchanged else self._trace_law(model))
            self._memory, self.law_memory, self._dashpots = memory, law_memory, dashpots
        elif self._dt != 0.0:
            self._write_packed()

    def reset_memory(self, mask: Tensor) -> None:
        """Reset the memory of the environments in ``mask``, and write new gains if they are randomised."""
        if self._dashpots is not None:
            self._dashpots.masked_fill_(mask, nan)
        if self._memory is not None:
            numbers = self._memory.numbers
            numbers.copy_(torch.where(mask, self._memory.initial.unsqueeze(-1), numbers))
            self._memory.since.masked_fill_(mask, 0)
        if self.law_memory is not None:
            self.law_memory.numbers.masked_fill_(mask, 0.0)
            self.law_memory.since.masked_fill_(mask, 0)
        if self._packing.law and self._dt != 0.0:
            self._write_gains()

    def take_ground_heights(self) -> None:
        """Write the ground heights into the packed tensor."""
        if isinstance(self._model.ground_height, torch.Tensor):
            self._packed[self._packing.vehicle["ground_height"]].copy_(self._model.ground_height[:, 0])

    def wake_memory(self) -> list[Tensor]:
        """Return the rows of the packed tensor."""
        ends = [
            self._packing.effects + place.params.stop
            for place in self._model.effects.places(self._num_rotors)
            if isinstance(place.effect, WakeSum)
        ]
        return [self._packed[end - 1] for end in ends]

    def link_state_of_load(self) -> Tensor | None:
        """Return direction and rate of the load's link, a view (E, 6); None without a load."""
        return self._memory.numbers[-6:].T if self._memory is not None and self._model.effects[LoadEffect] else None

    def prepare(self, dt: float) -> None:
        """Compute all values that depend on the length of a substep [s]."""
        if dt != self._dt:
            self._set_substep_length(dt)

    def state_tensors(self) -> dict[str, Tensor]:
        """Return the state for a checkpoint, by name."""
        tensors = {"packed": self._packed}
        for name, memory in (("memory", self._memory), ("law", self.law_memory)):
            if memory is not None:
                tensors |= {f"{name}.{key}": tensor for key, tensor in memory.tensors().items()}
        bends = self._model.articulation
        if self._dashpots is not None and bends is not None and bends.num_creep:
            tensors["dashpots"] = self._dashpots
        return tensors

    def parameter_rows(self, model: Model) -> tuple[Tensor, ...]:
        """Return the packed numbers of the vehicle and of a law that follows it, (E, n), and of the effects, (E, m)."""
        law = self._law.follow_vehicle(model.vehicle)
        numbers = collect_numbers(model, law, STAGES[self._integrator] * self._dt)
        return parameter_rows(self._packing, numbers, followed=law.follow is not None)

    def parameter_targets(self) -> tuple[Tensor, ...]:
        """Return their memory in the packed tensor (N, E)."""
        width = sum(rows.shape[1] for rows in self._numbers(self._dt).effects)
        packing = self._packing
        first = packing.vehicle_end if self._law.follow is None else packing.law_start
        return tuple(
            rows.T for rows in (self._packed[:first], self._packed[self._packing.effects :][:width]) if len(rows)
        )

    @torch.no_grad()
    def _write_gains(self) -> None:
        """Write the control law's own numbers of every environment, such as gains."""
        rows = torch.cat([rows.T for rows in law_rows(self._packing, self._numbers(self._dt))])
        self._packed[self._packing.law_start : self._packing.law_start + len(rows)].copy_(rows)

    @torch.no_grad()
    def _write_packed(self) -> None:
        if self._packing.total:
            torch.cat([rows.T for rows in pack_rows(self._packing, self._numbers(self._dt))], out=self._packed)

    def _set_substep_length(self, dt: float) -> None:
        """Compute all values that depend on the length of a substep."""
        self._dt, self._binding = dt, None
        self._write_packed()
        self._arrange_memory(dt)
        self._shared = make_structs(self._packing, self._numbers(dt), self._law, rotor_types_of_model(self._model))

    def _arrange_memory(self, dt: float) -> None:
        """Allocate the memory unless its size is right; neighbouring environments are contiguous, (M, E)."""
        effects, law = self._effect_memory_arrays(dt), self._law_memory_arrays(dt)
        together = memory_type(effects=effects is not None, law=law is not None)
        self._memory_arrays = effects if effects is not None and law is None else together()
        if law is not None:
            self._memory_arrays.law = law
            if effects is not None:
                self._memory_arrays.effects = effects

    def _effect_memory_arrays(self, dt: float) -> Any:
        """Return ``MemoryArrays``; None if no effect has memory."""
        if not self._model.effects.names_with_memory:
            return None
        slots = num_past_commands(self._model, dt)
        memory = self._memory
        if memory is None or memory.past.shape[0] != slots * self._num_rotors:
            memory = make_memory(self._model, dt, random=self._random)
            rows = {"numbers": memory.numbers.T.contiguous(), "past": memory.past.flatten(1).T.contiguous()}
            self._memory = memory = replace(memory, **rows)
        own, shared = memory.random, memory.random.shared
        return interop.make_struct(
            MemoryArrays, **memory.tensors(), slots=slots, random=random_arrays(own), shared=random_arrays(shared),
            shares=shared is not own,
        )  # fmt: skip

    def _law_memory_arrays(self, dt: float) -> Any:
        """Return ``LawArrays``; None for a law without memory."""
        needs = self._law.needs
        if needs is None:
            return None
        check_law_step(needs, dt)
        if self.law_memory is None:
            fresh = fresh_law_memory(needs, self._num_envs, self._model.vehicle.mass)
            rows = {"numbers": fresh.numbers, "past": fresh.past}
            rows = {
                name: memory if memory.numel() else memory.new_zeros(self._num_envs, 1) for name, memory in rows.items()
            }
            self.law_memory = replace(fresh, **{name: memory.T.contiguous() for name, memory in rows.items()})
        return interop.make_struct(LawArrays, **self.law_memory.tensors())

    def step(self, state: BodyState, command: Tensor, dt: float, substeps: int) -> None:
        """Advance ``state`` in place: one launch on torch's current stream, without waiting."""
        if self._differentiable:  # its kernel advances one substep per launch
            with torch.no_grad():
                state.copy_(self.advance(state, command, dt, substeps))
            return
        bound = self._binding
        if dt != self._dt:
            self._set_substep_length(dt)
            bound = None
        if bound is None or bound.state is not state or bound.command is not command or bound.substeps != substeps:
            bound = self._binding = self._bind(state, command, dt, substeps)
        with interop.on_torch_stream(command):
            interop.launch_side_by_side(bound.launches)

    def _bind(self, state: BodyState, command: Tensor, dt: float, substeps: int) -> _LaunchRecord:
        """Record the launches for tensors of fixed addresses, so that a step creates no views."""
        check_substeps(self._hook, substeps)
        arrays = self._arrays(state)
        inputs = [*arrays, self._view(command, vector_type(self._num_actions), "command"), *self._shared]
        ground = self._ground
        inputs += [wp.from_torch(self._packed), *ground[:3], self._model.gravity, dt, substeps]
        creep = [] if self._dashpots is None else [wp.from_torch(self._dashpots)]
        efforts = self._effort_arrays()
        launches = []
        for first, count in self._chunks(substeps):
            launches.append(
                interop.ReusableLaunch(
                    self.kernel,
                    dim=count,
                    inputs=[*inputs, first, self._memory_arrays, self._hook_data, *creep],
                    outputs=[*arrays, *ground[3:], *efforts],
                    device=self._device,
                    block_dim=BLOCK_DIM,
                )
            )
        return _LaunchRecord(state, command, dt, substeps, launches)

    def _chunks(self, substeps: int) -> list[tuple[int, int]]:
        """Return the first environment and the number of environments of each launch."""
        if self._device.type == "cuda":
            return [(0, self._num_envs)]
        threads = min(torch.get_num_threads(), max(1, self._num_envs * substeps // MIN_STEPS_PER_THREAD))
        return interop.split(self._num_envs, threads)

    def _arrays(self, state: BodyState) -> list[wp.array]:
        kinds = self._tensor_types()[:-1]
        if self._model.articulation is not None:
            kinds = (*kinds, *(vector_type(self._model.articulation.num_joints),) * 2)
        return [self._view(tensor, kind, name) for (name, tensor), kind in zip(vars(state).items(), kinds, strict=True)]

    def _effort_arrays(self) -> list[wp.array]:
        """Return the kernel arguments of applied efforts; the kernel of a rigid vehicle has none."""
        bends = self._model.articulation
        if bends is None:
            return []
        kind, efforts = vector_type(bends.num_joints), self._efforts
        if efforts is None:
            return [wp.empty(0, dtype=kind, device=wp.device_from_torch(self._device))] * 2
        return [self._view(tensor, kind, f"effort of {name}") for name, tensor in vars(efforts).items()]

    def _tensor_types(self) -> tuple[type, ...]:
        """Return the Warp types of the tensors of a state and of an action."""
        rotors = rotor_types(self._num_rotors).vector
        return wp.vec3, wp.quat, wp.vec3, wp.vec3, rotors, vector_type(self._law.num_actions)

    def _view(self, tensor: Tensor, kind: type, name: str) -> wp.array:
        shape = (self._num_envs, kind._length_)
        if tuple(tensor.shape) != shape or tensor.dtype != torch.float32 or not tensor.is_contiguous():
            raise ShapeError(
                f"{name} is {tuple(tensor.shape)} {tensor.dtype} with strides {tensor.stride()}, "
                f"expected {shape} torch.float32, contiguous"
            )
        if kind._length_ == 4 and tensor.data_ptr() % 16:
            raise ShapeError(f"{name} does not start at a multiple of 16 bytes: clone the tensor")
        return wp.from_torch(tensor, dtype=kind)

    def advance(self, state: BodyState, command: Tensor, dt: float, substeps: int) -> BodyState:
        """Return the state after ``substeps`` of ``dt`` [s]; differentiable if chosen at construction.

        Gradients flow to the state, the action and every parameter of the model and of the control law.
        """
        if dt != self._dt:
            self._set_substep_length(dt)
        if not self._differentiable:
            after = replace(state, **{name: tensor.clone() for name, tensor in vars(state).items()})
            self.step(after, command, dt, substeps)
            return after
        rows = pack_rows(self._packing, self._numbers(dt))
        rollout = Rollout(
            self.kernel, self._shared, self._ground, self._model.gravity, dt, substeps, self._tensor_types()
        )
        after = rollout(state.tensors(), command, torch.cat([row.T for row in rows]))
        return BodyState(**dict(zip(vars(state), after, strict=True)))
