"""Memory of a control law between substeps: integrators, filters, held and delayed commands.

A backend stores it and resets it by mask, like the memory of effects, but separately, so that a law without memory costs
nothing.
Letters: E environments, M numbers of memory, P delayed numbers.
"""

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from aerial_gym.errors import ConfigError
from aerial_gym.physics.state import BodyState


@dataclass(frozen=True, kw_only=True)
class Timing:
    """Periods and delays of the levels of a law, in physics steps."""

    dt: float  # Physics step [s]
    law: int = 1  # Period of the outer level; a multiple of `loop`
    loop: int = 1  # Period of the inner level; that of the outer one without a rate loop
    delay: int = 0  # Delay from the outer to the inner level
    action_delay: int = 0  # Delay of the action to the outer level

    @property
    def setpoint_slots(self) -> int:
        """Number of setpoints in the ring."""
        if self.delay:
            return self.delay // self.law + 2
        return int(self.law > self.loop)

    @property
    def action_slots(self) -> int:
        """Number of actions in the ring."""
        return self.action_delay + 1 if self.action_delay else 0

    @property
    def lag_between_levels(self) -> float:
        """Delay between the levels beyond one run of the inner one [s]."""
        return (self.law - self.loop + self.delay) * self.dt

    @property
    def outer_period(self) -> float:
        """Period of the outer level [s]."""
        return self.law * self.dt

    @property
    def inner_period(self) -> float:
        """Period of the inner level [s]."""
        return self.loop * self.dt


@dataclass(frozen=True, kw_only=True)
class LawNeeds:
    """Timing and memory of a law.

    Its numbers are those of the inner and outer level and the held rotor command; its rings are those of setpoints and actions.
    """

    timing: Timing
    inner: int  # Numbers of the inner level; all numbers are zero after a reset
    outer: int  # Numbers of the outer level
    num_rotors: int
    num_setpoint: int  # Entries of a setpoint
    num_actions: int

    @property
    def dt(self) -> float:
        """Time step [s] for which the law was built."""
        return self.timing.dt

    @property
    def command_offset(self) -> int:
        """Offset of the held rotor command, of R numbers."""
        return self.inner + self.outer

    @property
    def width(self) -> int:
        """Number of numbers M."""
        return self.command_offset + (self.num_rotors if self.timing.loop > 1 else 0)

    @property
    def action_offset(self) -> int:
        """Offset of the ring of actions, after that of setpoints."""
        return self.num_setpoint * self.timing.setpoint_slots

    @property
    def ring_width(self) -> int:
        """Numbers P of the rings; never cleared, because `since` excludes old ones."""
        return self.action_offset + self.timing.action_slots * self.num_actions


@dataclass(frozen=True, kw_only=True)
class LawMemory:
    """Memory of a law in all environments."""

    numbers: Tensor  # (E, M); (M, E) in the fused backend
    past: Tensor  # (E, P); (P, E) in the fused backend
    since: Tensor  # Physics steps since the reset, int32, (E,)

    def tensors(self) -> dict[str, Tensor]:
        """Return the tensors that change in a substep, by name."""
        return {"numbers": self.numbers, "past": self.past, "since": self.since}


def law_needs(law: object) -> LawNeeds | None:
    """Return the memory that a law needs; None without memory."""
    return getattr(law, "needs", None)


def fresh_law_memory(needs: LawNeeds, num_envs: int, like: Tensor) -> LawMemory:
    """Return the memory of environments after a reset, with float type and device of ``like``."""
    return LawMemory(
        numbers=like.new_zeros(num_envs, needs.width),
        past=like.new_zeros(num_envs, needs.ring_width),
        since=torch.zeros(num_envs, dtype=torch.int32, device=like.device),
    )


def reset_law_memory(memory: LawMemory, mask: Tensor) -> LawMemory:
    """Return the memory (E, ...) with the environments in ``mask``, bool (E,), reset; others stay bit for bit."""
    return replace(
        memory, numbers=memory.numbers.masked_fill(mask.unsqueeze(-1), 0.0), since=memory.since.masked_fill(mask, 0)
    )


def rotor_command_and_memory(
    law: Any, state: BodyState, action: Tensor, memory: LawMemory | None
) -> tuple[Tensor, LawMemory | None]:
    """Return the commanded rotor speeds (E, R) [rad/s] of a law with or without memory, and its new memory."""
    if memory is None:
        return law.rotor_command(state, action), None
    return law.command(state, action, memory)


def check_law_step(needs: LawNeeds, dt: float) -> None:
    """Raise ``ConfigError`` for a time step other than that of the law."""
    if abs(dt - needs.dt) > 1e-9 * needs.dt:
        raise ConfigError(
            f"the control law was built for steps of {needs.dt:g} s, but the physics takes {dt:g} s. Build it anew"
        )
