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
class LawNeeds:
    """Memory that a law needs."""

    width: int  # Numbers M; all are zero after a reset
    past: int  # Numbers P of delayed commands in rings; never cleared, because `since` excludes old ones
    dt: float  # Time step [s] for which the law was built


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
        past=like.new_zeros(num_envs, needs.past),
        since=torch.zeros(num_envs, dtype=torch.int32, device=like.device),
    )


def forget_law(memory: LawMemory, mask: Tensor) -> LawMemory:
    """Return the memory (E, ...) with the environments in ``mask``, bool (E,), reset; others stay bit for bit."""
    return replace(
        memory,
        numbers=memory.numbers.masked_fill(mask.unsqueeze(-1), 0.0),
        since=memory.since.masked_fill(mask, 0),
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
