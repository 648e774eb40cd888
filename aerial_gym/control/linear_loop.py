"""The sampled closed loop of vehicles and their control law, linearised about any state.

The state vector x has all inputs of the next step: the twelve ``AXES`` of the body, the states of the rotors, the memory of
effects, and the memory of the law. Law and plant are differentiated separately, by central differences of the torch
reference in float64, with all vehicles and perturbations as a batch of environments. Dead time adds exact delay states for
commands. A law that runs less often than the physics has a period; its map is the product of its steps. Laws read the true
state of the body; sensor latency affects observations only.
Letters: B vehicles under one law, E environments, R rotors, X numbers of the state vector, Z of them of the plant, N of law
memory, Q independent commands, D delay states.
"""

from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from functools import cached_property, partial, reduce
from itertools import groupby

import torch
from torch import Tensor

from aerial_gym.control.allocation import Allocation
from aerial_gym.control.stateful import StatefulController
from aerial_gym.math.quaternion import quat_exp, quat_log
from aerial_gym.physics.backend import ControlLaw, PhysicsBackend
from aerial_gym.physics.effects import DelayEffect, EffectsByKind
from aerial_gym.physics.integrators import INTEGRATORS
from aerial_gym.physics.law_memory import rotor_command_and_memory
from aerial_gym.physics.memory import Memory, make_memory
from aerial_gym.physics.model import Model
from aerial_gym.physics.rotors import state_for_thrust
from aerial_gym.physics.state import BodyState
from aerial_gym.physics.torch_backend import advance_remembering
from aerial_gym.physics.vehicle import Vehicle, is_shared, own_rows, share_row

AXES = ("x", "y", "z", "roll", "pitch", "yaw", "vx", "vy", "vz", "p", "q", "r")  # State of the body, in SI units
BODY = len(AXES)  # Size of the body's part of the state vector, before the rotors
NUDGE = 1e-5  # Step of central differences in the units of the axes; their error is its square
INDEPENDENT = 1e-9  # Relative singular value of the commands' derivatives below which a combination of rotors is unused


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearStep:
    """One physics step linearised about a state of each vehicle: derivatives, and the change of the state itself."""

    plant: Tensor  # Derivative of the next plant state by the plant state, (B, Z, Z)
    earlier: Tensor  # Derivative by the command before an arrival within the step, (B, Z, R), or 0
    later: Tensor  # Derivative by the command after the arrival, (B, Z, R)
    command: Tensor  # Derivative of the command by the state, (B, R, X)
    law: Tensor  # Derivative of the law's next memory by the state, (B, N, X)
    change: Tensor  # Change of the state in the step, (B, X)


@dataclass(frozen=True, kw_only=True)
class LinearLoop:
    """A period of the closed loop about a state of each vehicle."""

    steps: tuple[LinearStep, ...]  # Steps in order; steps of equal phase are the same object
    command: Tensor  # Command in that state, (B, R)
    rotate_ring: Callable[
        [Tensor], Tensor
    ]  # Function that restores the order of the law's memory (..., N) after a period
    slots: int  # Number of delayed commands: whole physics steps of dead time plus one; 0 without dead time

    @cached_property
    def rotor_combinations(self) -> Tensor:
        """Orthonormal combinations of rotors that the law uses, (R, Q)."""
        commands = torch.cat([torch.cat(list(step.command), dim=-1) for step in dict.fromkeys(self.steps)], dim=-1)
        combinations, sizes, _ = torch.linalg.svd(commands, full_matrices=False)
        return combinations[:, sizes > INDEPENDENT * sizes[0]]

    def period_map(self, *, gain: float = 1.0, late: bool = True) -> Tensor:
        """Return the affine map of deviations over a period, (B, X + D + 1, X + D + 1); its last column is the change.

        Args:
            gain: Factor on the deviation of commands from those at rest [-].
            late: Whether to include dead time; without it D is 0. The equilibrium is the same.
        """
        slots, parts = self.slots if late else 0, []
        for step, run in groupby(self.steps):
            matrix = _step_map(step, self.rotor_combinations, slots=slots, gain=gain)
            parts.append(torch.linalg.matrix_power(matrix, len(list(run))))
        whole = reduce(lambda before, after: after @ before, parts)
        plant, size = self.steps[0].plant.shape[-1], self.steps[0].change.shape[-1]
        remembered = whole[:, plant:size].mT
        whole[:, plant:size] = self.rotate_ring(remembered.flatten(0, 1)).view(remembered.shape).mT
        return whole


def _step_map(step: LinearStep, basis: Tensor, *, slots: int, gain: float) -> Tensor:
    """Return the affine map of a physics step, (B, X + slots Q + 1, X + slots Q + 1); the newest command comes first."""
    (count, size), plant, width = step.change.shape, step.plant.shape[-1], basis.shape[1]
    matrix = step.plant.new_zeros(count, size + slots * width + 1, size + slots * width + 1)
    asked = gain * basis.T @ step.command
    matrix[:, :plant, :plant] = step.plant
    matrix[:, plant:size, :size] = step.law
    matrix[:, :size, -1] = step.change
    matrix[:, -1, -1] = 1.0
    for slopes, age in ((step.later @ basis, slots - 1), (step.earlier @ basis, slots)):
        if age <= 0:
            matrix[:, :plant, :size] += slopes @ asked
        else:
            matrix[:, :plant, size + (age - 1) * width : size + age * width] += slopes
    if slots:
        matrix[:, size : size + width, :size] = asked
        matrix[:, size:-1, size:-1].diagonal(-width, dim1=1, dim2=2).fill_(1.0)
    return matrix


class DiscreteLoop:
    """Vehicles with their effects under one control law, at one time step."""

    def __init__(
        self, model: Model, make_law: Callable[[Vehicle], ControlLaw], *, declared: Vehicle, dt: float, integrator: str
    ) -> None:
        """Set up the loop.

        Args:
            model: Vehicles with their effects, in float64 on the CPU, with equal whole steps of dead time.
            make_law: Returns the law for a declared vehicle of any number of rows.
            declared: The vehicle of the law; all rows equal the first.
        """
        self._model, self._declared, self._make_law = model, declared, make_law
        self.dt = dt
        """Time step [s]."""
        self._integrator = integrator
        law = make_law(_repeat_vehicle(declared, 1))
        self._cascade = law if isinstance(law, StatefulController) else None
        self._laws: dict[int, ControlLaw] = {}
        self._plants: dict[int, tuple[Model, Memory]] = {}
        self._whole = command_delay_in_steps(model, dt)
        self.num_rotors = model.vehicle.num_rotors
        self.num_plant = BODY + self.num_rotors + len(self._repeat_plant(1)[1].initial)
        """Z."""

    def start(self, height: float, thrust: Tensor) -> Tensor:
        """Return the state at rest at a height [m], (B, X), with the memory of effects and law after a reset.

        Args:
            height: World z of the body origin [m].
            thrust: Of the declared rotors [N], (R,).
        """
        body = torch.zeros(BODY, dtype=torch.float64)
        body[AXES.index("z")] = height
        thrust = thrust.to(body)
        speed = state_for_thrust(_repeat_vehicle(self._declared, 1), thrust.unsqueeze(0))[0]
        law = body[:0] if self._cascade is None else self._cascade.memory_at_rest(thrust)
        state = torch.cat((body, speed, self._repeat_plant(1)[1].initial, law))
        return state.repeat(self._model.vehicle.num_envs, 1)

    def linearise(self, state: Tensor, action: Tensor) -> LinearLoop:
        """Linearise the loop about states (B, X) under an action (U,)."""
        cascade, plant = self._cascade, state[:, : self.num_plant]
        size = state.abs().clamp_min(1.0)
        size[:, :BODY] = 1.0
        phases = [None] if cascade is None else [cascade.phase_of_step(number) for number in range(cascade.period)]
        at_start = self._law_step(state, action, 0)[0]
        reach = torch.cat((size[:, : self.num_plant], *[at_start.abs().clamp_min(1.0)] * 2), dim=-1)
        moved = _central_differences(self._plant_step, torch.cat((plant, at_start, at_start), dim=-1), reach)
        moved, earlier, later = moved.split((plant.shape[1], at_start.shape[1], at_start.shape[1]), dim=-1)
        step_by_phase: dict[Hashable, LinearStep] = {}
        for number, phase in enumerate(phases):
            if phase in step_by_phase:
                continue
            command, memory = self._law_step(state, action, number)
            asked = _central_differences(partial(self._law_response, action, number), state, size)
            after = torch.cat((self._plant_step(torch.cat((plant, command, command), dim=-1)), memory), dim=-1)
            step_by_phase[phase] = LinearStep(
                plant=moved,
                earlier=earlier,
                later=later,
                command=asked[:, : command.shape[1]],
                law=asked[:, command.shape[1] :],
                change=after - state,
            )
        return LinearLoop(
            steps=tuple(step_by_phase[phase] for phase in phases),
            command=at_start,
            rotate_ring=(lambda rows: rows) if cascade is None else cascade.rotate_ring,
            slots=self._whole + 1 if self._model.effects[DelayEffect] else 0,
        )

    def prepare_flight(self, backend: PhysicsBackend, states: Tensor) -> BodyState:
        """Allocate the first vehicle and its law on a backend, and return the body in states (E, X) for its steps."""
        count = len(states)
        first = model_of_first_vehicle(self._model)
        law = self._make_law(_repeat_vehicle(parameters_of_first_vehicle(self._declared), count))
        _update_allocation(getattr(law, "allocation", None), _repeat_vehicle(first.vehicle, count))
        backend.allocate(repeat_model(first, count), law, integrator=self._integrator)
        return _state_of_rows(states[:, : BODY + self.num_rotors])

    def _law_response(self, action: Tensor, number: int, states: Tensor) -> Tensor:
        """Return commands and law memory, (E, R + N), at a step of a period."""
        return torch.cat(self._law_step(states, action, number), dim=-1)

    def _law_step(self, states: Tensor, action: Tensor, number: int) -> tuple[Tensor, Tensor]:
        """Return commands (E, R) in states (E, X) at a step of a period, and the memory of the law after it, (E, N)."""
        law, cascade = self._law(len(states)), self._cascade
        body, remembered = _state_of_rows(states[:, : BODY + self.num_rotors]), states[:, self.num_plant :]
        memory = None if cascade is None else cascade.memory_long_after_reset(remembered, number)
        command, memory = rotor_command_and_memory(law, body, action.expand(len(states), -1), memory)
        return command, remembered if cascade is None or memory is None else cascade.flatten_memory(memory)

    def _plant_step(self, rows: Tensor) -> Tensor:
        """Return plant states (E, Z) after a step, from rows of plant state, earlier and later command, (E, Z + 2 R)."""
        states, earlier, later = rows.split((self.num_plant, self.num_rotors, self.num_rotors), dim=-1)
        model, memory = self._repeat_plant(len(rows) // self._model.vehicle.num_envs)
        body, numbers = _state_of_rows(states[:, : BODY + self.num_rotors]), states[:, BODY + self.num_rotors :]
        known = None
        if model.effects.names_with_memory:
            past = memory.past.clone()
            past[:, self._whole : self._whole + 1] = earlier.unsqueeze(1)
            past[:, max(self._whole - 1, 0) : self._whole] = later.unsqueeze(1)
            known = replace(memory, numbers=numbers, past=past)
        body, after = advance_remembering(model, INTEGRATORS[self._integrator], None, body, later, self.dt, 1, known)
        numbers = numbers if after is None else after.numbers
        return torch.cat((*replace(body, attitude=quat_log(body.attitude)).tensors(), numbers), dim=-1)

    def _repeat_plant(self, each: int) -> tuple[Model, Memory]:
        """Return the vehicles in ``each`` rows, and their memory with delayed commands of the law."""
        if each not in self._plants:
            model = repeat_model(self._model, each)
            memory = make_memory(model, self.dt)
            long_ago = torch.full_like(memory.since, memory.past.shape[1])
            self._plants[each] = model, replace(memory, since=long_ago)
        return self._plants[each]

    def _law(self, num_rows: int) -> ControlLaw:
        if num_rows not in self._laws:
            self._laws[num_rows] = law = self._make_law(
                _repeat_vehicle(parameters_of_first_vehicle(self._declared), num_rows)
            )
            each = num_rows // self._model.vehicle.num_envs
            _update_allocation(getattr(law, "allocation", None), _repeat_vehicle(self._model.vehicle, each))
        return self._laws[num_rows]


def command_delay_in_steps(model: Model, dt: float) -> int:
    """Return the whole physics steps of the first vehicle's dead time, as in ``physics.memory``; 0 without dead time."""
    for effect, params in model.effects[DelayEffect]:
        return int(float(effect.delay(params)[0]) / dt)
    return 0


def repeat_model(model: Model, each: int) -> Model:
    """Repeat every vehicle of a model in ``each`` consecutive rows."""
    params = [(effect, rows.repeat_interleave(each, 0)) for effect, rows in model.effects]
    return replace(
        model,
        vehicle=_repeat_vehicle(model.vehicle, each),
        inertia_inverse=_repeat_rows(model.inertia_inverse, each),
        other_position=_repeat_rows(model.other_position, each),
        effects=EffectsByKind(params),
    )


def model_of_first_vehicle(model: Model) -> Model:
    """Return the model of the first vehicle alone."""
    effects = EffectsByKind((effect, params[:1]) for effect, params in model.effects)
    return replace(
        model,
        vehicle=parameters_of_first_vehicle(model.vehicle),
        inertia_inverse=share_row(model.inertia_inverse[0], 1),
        other_position=share_row(model.other_position[0], 1),
        effects=effects,
    )


def parameters_of_first_vehicle(vehicle: Vehicle) -> Vehicle:
    """Return the first vehicle alone."""
    return vehicle.map_rows(lambda rows: share_row(rows[0], 1))


def _repeat_vehicle(vehicle: Vehicle, each: int) -> Vehicle:
    return vehicle.map_rows(lambda rows: _repeat_rows(rows, each))


def _repeat_rows(rows: Tensor, each: int) -> Tensor:
    return share_row(rows[0], len(rows) * each) if is_shared(rows) else rows.repeat_interleave(each, 0)


def _update_allocation(allocation: Allocation | None, vehicle: Vehicle) -> None:
    """Update an allocation of actual effectiveness for a vehicle."""
    if allocation is None or allocation.effectiveness != "actual":
        return
    own = vehicle.map_rows(own_rows)
    allocation.follow(own)
    for name, rows in allocation.compute_rows(own).items():
        allocation.rows[name].copy_(rows)


def _state_of_rows(rows: Tensor) -> BodyState:
    position, turn, lin_vel, ang_vel, rotors = rows.split((3, 3, 3, 3, rows.shape[1] - BODY), dim=-1)
    return BodyState(position=position, attitude=quat_exp(turn), lin_vel=lin_vel, ang_vel=ang_vel, rotor_speed=rotors)


def _central_differences(function: Callable[[Tensor], Tensor], points: Tensor, size: Tensor) -> Tensor:
    """Return the derivatives (B, M, K) of a function of rows at points (B, K), by central differences of ``NUDGE`` sizes."""
    count, width = points.shape
    nudges = NUDGE * torch.diag_embed(size)
    ends = function((points.unsqueeze(1) + torch.cat((nudges, -nudges), dim=1)).flatten(0, 1)).view(
        count, 2 * width, -1
    )
    return ((ends[:, :width] - ends[:, width:]) / (2.0 * NUDGE * size.unsqueeze(-1))).mT
