"""Training episodes that start behind a gate, for all gate commands. Letters: E environments, G gates."""

import torch
from torch import Tensor

from aerial_gym.config.checks import Vec3
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import ConfigError
from aerial_gym.task.kernels.practice import PracticeStarts
from aerial_gym.task.values import Values

FIRST_GATE = "first_gate"
"""Buffer of the gate with which an episode begins, int32, (E,)."""


class Practice:
    """Start of training episodes behind a gate other than the last, as if just passed."""

    def __init__(
        self,
        name: str,
        values: Values,
        env: EnvManager,
        gates: tuple[Tensor, Tensor],
        *,
        share: float,
        speed: float,
        offset: Vec3,
    ) -> None:
        """Take the gates, and declare what is drawn.

        Args:
            gates: Positions [m], world, (E, G, 3), and attitudes, gate to world, xyzw, (E, G, 4).
            share: Of the episodes of a training, 0 to 1, that begin so; no episode of an evaluation does.
            speed: Largest speed of these, away from the gate [m/s], >= 0.
            offset: Largest distances of their place behind the gate, beside its middle and above it [m], >= 0.
        """
        if not (0.0 <= share <= 1.0 and speed >= 0.0 and min(offset) >= 0.0):
            raise ConfigError(
                f"command {name}: practice_share = {share!r}: must be 0 to 1; practice_speed = {speed!r}, practice_offset = "
                f"{offset!r}: must be >= 0"
            )
        first = values.declare(FIRST_GATE, dtype=torch.int32, meaning="gate with which the episode begins")
        present = values.declare(
            "practice_share", (1,), rows=False, meaning="share of episodes that begin behind a gate"
        )
        self._share, self._present = share, present
        self._starts: PracticeStarts | None = None
        if share > 0.0 and gates[0].shape[1] > 1:
            self._starts = PracticeStarts(
                env.robot_manager.tensors,
                gates,
                share=present,
                speed=speed,
                offset=offset,
                first_out=first,
                random=env.random,
            )

    def begin(self) -> None:
        """Start training episodes from the next resets on."""
        self._present.fill_(self._share)

    def place(self, mask: Tensor) -> None:
        """Place the robots of ``mask``, bool (E,), that begin behind a gate."""
        if self._starts is not None:
            self._starts.draw(mask)
