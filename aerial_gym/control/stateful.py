"""Base class of controllers with memory: delayed actions, delayed setpoints of the law, a held rotor command.

    action --(action delay)--> law --(delay, held)--> rate loop --> allocation --(held)--> rotors

Letters: E environments, R rotors, U entries of an action, S slots of a ring, M numbers of memory, P delayed numbers.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from aerial_gym.control.allocation import Allocation
from aerial_gym.control.timing import Timing
from aerial_gym.physics.fused.law import FusedLaw
from aerial_gym.physics.law_memory import LawMemory, LawNeeds, fresh_law_memory
from aerial_gym.physics.state import BodyState


@dataclass(frozen=True)
class MemoryLayout:
    """Offsets into a controller's memory."""

    held: int  # First held rotor command, of R numbers
    width: int  # M
    actions: int  # First number of the ring of actions, after that of setpoints
    past: int  # P


def make_layout(timing: Timing, *, own: int, num_rotors: int, num_actions: int) -> MemoryLayout:
    """Return the offsets for ``own`` numbers of the controller, then the held command (R)."""
    actions = 4 * timing.setpoint_slots
    return MemoryLayout(
        own, own + (num_rotors if timing.loop > 1 else 0), actions, actions + timing.action_slots * num_actions
    )


class StatefulController(ABC):
    """A controller with memory; ``command`` is one physics step of it.

    A subclass has a timing, a layout and an allocation, and defines one run with its own memory.
    """

    action_names: tuple[str, ...]  # Meaning and unit of each entry of an action
    allocation: Allocation  # Allocation of wrenches to thrusts
    timing: Timing  # Timing of its levels

    _layout: MemoryLayout

    @property
    def needs(self) -> LawNeeds:
        """Memory that it needs."""
        return LawNeeds(width=self._layout.width, past=self._layout.past, dt=self.timing.dt)

    @property
    def period(self) -> int:
        """Physics steps after which the pattern of runs repeats."""
        return self.timing.law

    @abstractmethod
    def _run(self, state: BodyState, action: Tensor, memory: LawMemory, sent: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return the rotor commands (E, R) of one run, its new memory, and the delayed setpoints."""

    @property
    @abstractmethod
    def _hover_setpoint(self) -> Tensor:
        """Thrust setpoint of the rate loop at hover, of the first environment, in the loop's unit."""

    def rest_memory(self, thrust: Tensor) -> Tensor:
        """Return the memory of the first environment at rest under thrusts [N], (R,): numbers and setpoints."""
        numbers, sent = thrust.new_zeros(self._layout.width), thrust.new_zeros(self._layout.actions)
        if self.timing.loop > 1:
            like = self.allocation.inverse
            numbers[self._layout.held :] = self.allocation.speed(thrust.to(like).expand(len(like), -1))[0]
        sent[::4] = self._hover_setpoint.to(thrust)
        return torch.cat((numbers, sent))

    def phase(self, step: int) -> tuple[bool, bool, int]:
        """Return the phase of a step in its period: the levels that run, and the age of the setpoint that has arrived.

        Steps of equal phase have the same map of states and memory.
        """
        timing = self.timing
        return step % timing.law == 0, step % timing.loop == 0, (step - timing.delay) // timing.law

    def restore_memory(self, remembered: Tensor, step: int) -> LawMemory:
        """Return the memory with numbers and setpoints (E, ...) as ``rest_memory`` gives them, long after a reset."""
        numbers, sent = remembered.split((self._layout.width, self._layout.actions), dim=-1)
        actions = sent.new_zeros(len(sent), self._layout.past - self._layout.actions)
        long_ago = 1000 * self.period * max(self.timing.setpoint_slots, 1) + step
        since = torch.full((len(sent),), long_ago, dtype=torch.int32, device=sent.device)
        return LawMemory(numbers=numbers, past=torch.cat((sent, actions), dim=-1), since=since)

    def flatten_memory(self, memory: LawMemory) -> Tensor:
        """Return the numbers and setpoints of a memory, the inverse of ``restore_memory``."""
        return torch.cat((memory.numbers, memory.past[:, : self._layout.actions]), dim=-1)

    def rotate_ring(self, remembered: Tensor) -> Tensor:
        """Rotate the ring of setpoints (..., N) by a period, so that equal slots have equal age."""
        numbers, sent = remembered.split((self._layout.width, self._layout.actions), dim=-1)
        slots = self.timing.setpoint_slots
        if slots:
            sent = sent.unflatten(-1, (slots, 4)).roll(-1, dims=1).flatten(1)
        return torch.cat((numbers, sent), dim=-1)

    def rotor_command(self, state: BodyState, action: Tensor) -> Tensor:
        """Return the command of the first step after a reset."""
        return self.command(state, action, fresh_law_memory(self.needs, state.num_envs, state.position))[0]

    def command(self, state: BodyState, action: Tensor, memory: LawMemory) -> tuple[Tensor, LawMemory]:
        """Return commanded rotor speeds [rad/s], (E, R), of one physics step, and the memory after it."""
        layout, timing, since = self._layout, self.timing, memory.since
        sent, actions = memory.past[:, : layout.actions], memory.past[:, layout.actions :]
        if timing.action_delay:
            actions = write_ring(actions, action, since, timing.action_slots)
            action = read_ring(actions, (since - timing.action_delay).clamp_min(0), timing.action_slots)
        command, numbers, sent = self._run(state, action, memory, sent)
        if timing.loop > 1:
            due = (since % timing.loop == 0).unsqueeze(-1)
            command = torch.where(due, command, memory.numbers[:, layout.held :])
            numbers = torch.where(due, numbers, memory.numbers[:, : layout.held])
            numbers = torch.cat((numbers, command), dim=-1)
        return command, LawMemory(numbers=numbers, past=torch.cat((sent, actions), dim=-1), since=since + 1)

    def _fused(self, **law: Any) -> FusedLaw:
        """Return the Warp law with this allocation and memory, and the given gains and code."""
        allocation = self.allocation
        return FusedLaw(
            output="wrench",
            num_actions=len(self.action_names),
            low=allocation.low,
            high=allocation.high,
            thrust_map=allocation.vehicle.thrust_map,
            reverse_thrust_map=allocation.vehicle.reverse_thrust_map,
            allocation=allocation.inverse,
            follow=allocation.compute_rows if allocation.rows else None,
            saturation=allocation.saturation,
            lateral=False,
            idle=allocation.idle,
            needs=self.needs,
            **law,
        )

    def _delay_setpoint(self, setpoint: Tensor, sent: Tensor, since: Tensor) -> tuple[Tensor, Tensor]:
        """Return the delayed thrust and body rates (E, 4), and the updated ring of setpoints."""
        timing = self.timing
        if not timing.setpoint_slots:
            return setpoint, sent
        due = (since % timing.law == 0).unsqueeze(-1)
        sent = torch.where(due, write_ring(sent, setpoint, since // timing.law, timing.setpoint_slots), sent)
        arrived = (since - timing.delay).clamp_min(0) // timing.law
        return read_ring(sent, arrived, timing.setpoint_slots), sent


def write_ring(ring: Tensor, row: Tensor, count: Tensor, slots: int) -> Tensor:
    """Write a row (E, W) into a ring (E, S W), at the slot ``count`` modulo S, (E,)."""
    here = torch.arange(slots, device=ring.device) == (count % slots).unsqueeze(-1)
    rows = torch.where(here.unsqueeze(-1), row.unsqueeze(1), ring.unflatten(-1, (slots, -1)))
    return rows.flatten(1)


def read_ring(ring: Tensor, count: Tensor, slots: int) -> Tensor:
    """Read the row (E, W) of a ring (E, S W) at the slot ``count`` modulo S, (E,)."""
    rows = ring.unflatten(-1, (slots, -1))
    index = (count.long() % slots)[:, None, None].expand(-1, 1, rows.shape[-1])
    return rows.gather(1, index).squeeze(1)
