"""Base class of controllers with memory: timing, delays and memory around two pure functions.

    action --(action delay)--> outer --(delay, held)--> inner --(held)--> rotors

``outer`` is the law, for example of position; ``inner`` is the loop below it, for example of body rates, with the allocation.
A law of one level leaves ``outer`` out. Torch calls both functions; the fused backend traces them.
Letters: E environments, R rotors, U entries of an action, S slots of a ring, M numbers of memory, P delayed numbers.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import torch
from torch import Tensor

from aerial_gym.control.allocation import Allocation
from aerial_gym.physics.law_memory import LawMemory, LawNeeds, Timing, fresh_law_memory
from aerial_gym.physics.state import BodyState


class StatefulController(ABC):
    """A controller with memory; ``command`` is one physics step of it."""

    action_names: tuple[str, ...]  # Meaning and unit of each entry of an action
    allocation: Allocation  # Allocation of wrenches to thrusts
    needs: LawNeeds  # Timing and memory
    gains_by_name: Mapping[str, Tensor] = MappingProxyType({})  # Gains by name in `randomize:`; empty if shared
    hover_action: Sequence[float] = ()  # Action at hover for the checks; empty: zeros. `z [m]` is the height

    def outer(self, state: BodyState, action: Tensor, memory: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Return the setpoint (E, S) of an action (E, U) and the new memory; by default the action.

        Args:
            memory: Its numbers, ``needs.outer`` of them, (E, M); zeros after a reset.
            begins: Whether this is the first run after a reset, bool (E, 1).
        """
        return action, memory

    @abstractmethod
    def inner(self, state: BodyState, setpoint: Tensor, memory: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Return rotor speeds [rad/s], (E, R), for a setpoint (E, S) and the new memory; arguments as for ``outer``."""

    def set_needs(
        self, timing: Timing, *, num_rotors: int, inner: int = 0, outer: int = 0, num_setpoint: int | None = None
    ) -> None:
        """Set timing and memory of the levels; ``action_names`` must be set.

        Args:
            inner: Numbers of memory of the inner level.
            outer: Numbers of memory of the outer level.
            num_setpoint: Entries of a setpoint; as many as of an action if not given.
        """
        num_actions = len(self.action_names)
        self.needs = LawNeeds(
            timing=timing,
            inner=inner,
            outer=outer,
            num_rotors=num_rotors,
            num_setpoint=num_actions if num_setpoint is None else num_setpoint,
            num_actions=num_actions,
        )

    @property
    def timing(self) -> Timing:
        """Timing of its levels."""
        return self.needs.timing

    @property
    def period(self) -> int:
        """Physics steps after which the pattern of runs repeats."""
        return self.timing.law

    @property
    def hover_setpoint(self) -> Tensor:
        """Setpoint of the inner level at hover, of the first environment, (S,); zeros by default."""
        return self.allocation.inverse.new_zeros(self.needs.num_setpoint)

    def memory_at_rest(self, thrust: Tensor) -> Tensor:
        """Return the memory of the first environment at rest under thrusts [N], (R,): numbers and setpoints."""
        needs = self.needs
        numbers = thrust.new_zeros(needs.width)
        if self.timing.loop > 1:
            like = self.allocation.inverse
            numbers[needs.command_offset :] = self.allocation.speed(thrust.to(like).expand(len(like), -1))[0]
        return torch.cat((numbers, self.hover_setpoint.to(thrust).repeat(self.timing.setpoint_slots)))

    def phase_of_step(self, step: int) -> tuple[bool, bool, int]:
        """Return the phase of a step in its period: the levels that run, and the age of the setpoint that has arrived.

        Steps of equal phase have the same map of states and memory.
        """
        timing = self.timing
        return step % timing.law == 0, step % timing.loop == 0, (step - timing.delay) // timing.law

    def memory_long_after_reset(self, remembered: Tensor, step: int) -> LawMemory:
        """Return the memory with numbers and setpoints (E, ...) as ``memory_at_rest`` gives them, long after a reset."""
        needs = self.needs
        numbers, sent = remembered.split((needs.width, needs.action_offset), dim=-1)
        actions = sent.new_zeros(len(sent), needs.ring_width - needs.action_offset)
        long_ago = 1000 * self.period * max(self.timing.setpoint_slots, 1) + step
        since = torch.full((len(sent),), long_ago, dtype=torch.int32, device=sent.device)
        return LawMemory(numbers=numbers, past=torch.cat((sent, actions), dim=-1), since=since)

    def flatten_memory(self, memory: LawMemory) -> Tensor:
        """Return the numbers and setpoints of a memory, the inverse of ``memory_long_after_reset``."""
        return torch.cat((memory.numbers, memory.past[:, : self.needs.action_offset]), dim=-1)

    def rotate_ring(self, remembered: Tensor) -> Tensor:
        """Rotate the ring of setpoints (..., N) by a period, so that equal slots have equal age."""
        numbers, sent = remembered.split((self.needs.width, self.needs.action_offset), dim=-1)
        slots = self.timing.setpoint_slots
        if slots:
            sent = sent.unflatten(-1, (slots, -1)).roll(-1, dims=1).flatten(1)
        return torch.cat((numbers, sent), dim=-1)

    def rotor_command(self, state: BodyState, action: Tensor) -> Tensor:
        """Return the command of the first step after a reset."""
        return self.command(state, action, fresh_law_memory(self.needs, state.num_envs, state.position))[0]

    def command(self, state: BodyState, action: Tensor, memory: LawMemory) -> tuple[Tensor, LawMemory]:
        """Return commanded rotor speeds [rad/s], (E, R), of one physics step, and the memory after it."""
        needs, timing, since = self.needs, self.timing, memory.since
        sent, actions = memory.past[:, : needs.action_offset], memory.past[:, needs.action_offset :]
        if timing.action_delay:
            actions = write_ring(actions, action, since, timing.action_slots)
            action = read_ring(actions, (since - timing.action_delay).clamp_min(0), timing.action_slots)
        inner, outer, held = memory.numbers.split(
            (needs.inner, needs.outer, needs.width - needs.command_offset), dim=-1
        )
        begins = (since == 0).unsqueeze(-1)
        setpoint, after = self.outer(state, action, outer, begins)
        if timing.law > 1:
            after = torch.where((since % timing.law == 0).unsqueeze(-1), after, outer)
        setpoint, sent = self._delay_setpoint(setpoint, sent, since)
        command, inner_after = self.inner(state, setpoint, inner, begins)
        if timing.loop > 1:
            due = (since % timing.loop == 0).unsqueeze(-1)
            command, inner_after = torch.where(due, command, held), torch.where(due, inner_after, inner)
            held = command
        numbers = torch.cat((inner_after, after, held), dim=-1)
        return command, LawMemory(numbers=numbers, past=torch.cat((sent, actions), dim=-1), since=since + 1)

    def _delay_setpoint(self, setpoint: Tensor, sent: Tensor, since: Tensor) -> tuple[Tensor, Tensor]:
        """Return the delayed setpoint (E, S), and the updated ring of setpoints."""
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
