"""Training episodes that start behind a gate, for all gate commands. Letters: E environments, G gates."""

import torch
from torch import Tensor

from aerial_gym.config.checks import Vec3
from aerial_gym.errors import ConfigError
from aerial_gym.task.commands.command import Command
from aerial_gym.task.kernels.practice import PracticeStarts

FIRST_GATE = "first_gate"  # Buffer of the gate with which an episode begins, int32, (E,)


class PracticeCommand(Command):
    """A command of gates whose training episodes start behind a gate other than the last, as if just passed."""

    def _declare_practice(self, gates: tuple[Tensor, Tensor], *, share: float, speed: float, offset: Vec3) -> None:
        """Take positions [m], world, (E, G, 3), and attitudes, gate to world, (E, G, 4), and declare what is drawn."""
        if not (0.0 <= share <= 1.0 and speed >= 0.0 and min(offset) >= 0.0):
            raise ConfigError(
                f"command {self.name}: practice_share = {share!r}: must be 0 to 1; practice_speed = {speed!r}, "
                f"practice_offset = {offset!r}: must be >= 0"
            )
        first = self.values.declare(FIRST_GATE, dtype=torch.int32, meaning="gate with which the episode begins")
        self._share = share
        meaning = "share of episodes that begin behind a gate"
        self._present_share = self.values.declare("practice_share", (1,), rows=False, meaning=meaning)
        self._starts: PracticeStarts | None = None
        if share > 0.0 and gates[0].shape[1] > 1:
            self._starts = PracticeStarts(
                self.env.robot_manager.tensors, gates, share=self._present_share, speed=speed, offset=offset,
                first_out=first, random=self.env.random,
            )  # fmt: skip

    def practise(self) -> None:
        """Start training episodes from the next resets on."""
        self._present_share.fill_(self._share)

    def place(self, mask: Tensor) -> None:
        """Place the robots of new episodes that begin behind a gate."""
        if self._starts is not None:
            self._starts.draw(mask)
