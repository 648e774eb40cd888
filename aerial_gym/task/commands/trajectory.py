"""Targets that move as a function of time.

Frames: world of each environment, z up. Letters: E environments.
"""

from collections.abc import Callable, Mapping
from math import pi

import torch
from torch import Tensor

from aerial_gym.config.robot import Vec3
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import ConfigError
from aerial_gym.math.random import Purpose
from aerial_gym.task.commands.command import COMMANDS, TARGET, Command
from aerial_gym.task.kernels.draws import UniformDraws
from aerial_gym.task.values import Values

Curve = Callable[[Tensor], tuple[tuple[Tensor, ...], tuple[Tensor, ...]]]
"""From an angle [rad], (E,), to the coordinates of a point of size about 1, and their derivatives with respect to the angle."""


def _circle(angle: Tensor) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
    cos, sin, zero = torch.cos(angle), torch.sin(angle), torch.zeros_like(angle)
    return (cos, sin, zero), (-sin, cos, zero)


def _lemniscate(angle: Tensor) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
    """The eight of Gerono, (cos a, sin a cos a)."""
    cos, sin, zero = torch.cos(angle), torch.sin(angle), torch.zeros_like(angle)
    return (cos, sin * cos, zero), (-sin, cos * cos - sin * sin, zero)


def _helix(angle: Tensor) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
    """A circle that goes up and down once a turn."""
    cos, sin = torch.cos(angle), torch.sin(angle)
    return (cos, sin, sin), (-sin, cos, cos)


CURVES: dict[str, Curve] = {"circle": _circle, "lemniscate": _lemniscate, "helix": _helix}
"""Closed curves, once round in 2 pi."""


@COMMANDS.generator("trajectory")
class TrajectoryCommand(Command):
    """A target on a closed curve, a function of the time since the episode began; ``target_velocity`` is its derivative."""

    follows_reset = True

    def __init__(
        self, values: Values, env: EnvManager, *, curve: str, size: Vec3, period: float,
        center: Vec3 = (0.0, 0.0, 0.0), random_phase: bool = False,
    ) -> None:  # fmt: skip
        """Take the curve.

        Args:
            curve: ``circle``, ``lemniscate`` or ``helix``.
            size: Half of its extent along each axis [m].
            period: Time once round [s], > 0.
            center: Its middle [m].
            random_phase: Whether every episode begins somewhere else on it, drawn; otherwise at the end of its x axis.
        """
        super().__init__(values, env)
        if curve not in CURVES:
            raise ConfigError(f"command trajectory: no curve {curve!r}. Known: {', '.join(CURVES)}")
        if not 0.0 < period < float("inf"):
            raise ConfigError(f"command trajectory: period = {period!r}: must be > 0 and finite")
        self._curve, self._size, self._center = CURVES[curve], size, center
        self._rate, self._dt = 2.0 * pi / period, env.dt
        self._target(moving=True)
        phase = values.declare(
            "target_phase", (1,), unit="rad", meaning="angle on the curve at which the episode began"
        )
        self._phase = UniformDraws(phase, [(0.0, 2.0 * pi)], purpose=Purpose.COMMAND, random=env.random)
        self._random_phase = random_phase
        self.reads = ("target_phase",)

    def current_values(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return place and velocity of the target at this instant."""
        time = values["sim_steps"].float() * self._dt
        place, slope = self._curve(self._rate * time + values["target_phase"][:, 0])
        position = [c + s * x for c, s, x in zip(self._center, self._size, place, strict=True)]
        velocity = [self._rate * s * x for s, x in zip(self._size, slope, strict=True)]
        return {TARGET: torch.stack(position, dim=-1), "target_velocity": torch.stack(velocity, dim=-1)}

    def draw(self, mask: Tensor) -> None:
        """Draw where new episodes begin."""
        if self._random_phase:
            self._phase.draw(mask)
