"""Gates: openings that are to be flown through one after the other, each from its own side.

A gate is a rectangle that stands upright: its centre, the heading in which it is flown through, its width and height.
Frames: world of each environment, z up. Letters: E environments.
"""

from collections.abc import Mapping
from math import cos, sin

import torch
from torch import Tensor

from aerial_gym.config.robot import Vec3
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import ConfigError
from aerial_gym.task.commands.command import COMMANDS, TARGET, Command
from aerial_gym.task.commands.points import chosen, next_index
from aerial_gym.task.values import Values


def crossing(before: Tensor, now: Tensor, *, half: tuple[float, float]) -> tuple[Tensor, Tensor]:
    """Return whether a gate's plane was crossed in its direction, and whether that was within its opening, bool (E,).

    Args:
        before: Where the robot was [m], in the gate's frame: x is the way through it, the opening lies in y and z, (E, 3).
        now: Where it is, likewise.
        half: Half of the width, along y, and of the height, along z, of the opening [m].
    """
    (fx, fy, fz), (tx, ty, tz) = before.unbind(-1), now.unbind(-1)
    crossed = (fx < 0.0) & (tx >= 0.0)
    share = fx / torch.where(crossed, fx - tx, -1.0)  # of the way at which the plane is crossed
    left, up = fy + share * (ty - fy), fz + share * (tz - fz)
    return crossed, crossed & (left.abs() <= half[0]) & (up.abs() <= half[1])


def declare_gates(values: Values) -> None:
    """Declare which gate is next, and what a step tells of it."""
    values.declare("target_index", dtype=torch.int32, meaning="which point or gate is next, from 0 on")
    for name, meaning in (
        ("gate_passed", "the robot flew through its gate in this step"),
        ("gate_missed", "the robot crossed the plane of its gate beside the opening in this step"),
        ("sequence_done", "it flew through the last one in this step"),
    ):
        values.declare(name, dtype=torch.bool, meaning=meaning)
    values.find("previous_position", "a command of gates")


@COMMANDS.generator("gates")
class Gates(Command):
    """The next gate's centre is the target, ``target_direction`` the way through it; the first one at every reset.

    ``gate_passed`` is true in the step in which the robot crosses the gate's plane in its direction through the opening,
    ``gate_missed`` where it crosses beside it, ``sequence_done`` where it passes the last one.
    """

    def __init__(
        self,
        values: Values,
        env: EnvManager,
        *,
        centers: tuple[Vec3, ...],
        yaws: tuple[float, ...],
        width: float = 1.0,
        height: float = 1.0,
        loop: bool = False,
    ) -> None:
        """Take the gates.

        Args:
            values: Of the task.
            env: The simulation.
            centers: In order [m].
            yaws: Heading in which each is flown through [rad]; 0 is along x.
            width: Of the opening [m], > 0.
            height: Of the opening [m], > 0.
            loop: Whether the first one follows the last one; otherwise that one stays the target.
        """
        super().__init__(values, env)
        if not centers or len(centers) != len(yaws):
            raise ConfigError(
                f"command gates: {len(centers)} centers and {len(yaws)} yaws: needs one of each for every gate"
            )
        if not (width > 0.0 and height > 0.0):
            raise ConfigError(f"command gates: width = {width!r}, height = {height!r}: must be > 0")
        self._gates = [(*center, cos(yaw), sin(yaw)) for center, yaw in zip(centers, yaws, strict=True)]
        self._half, self._loop = (0.5 * width, 0.5 * height), loop
        self._target()
        values.declare("target_direction", (2,), frame="world", meaning="way through the next gate: x and y, unit")
        declare_gates(values)
        self.reads = (
            TARGET, "target_direction", "target_index", "gate_passed", "robot_position", "previous_position",
        )  # fmt: skip

    def at(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return what the way from the last position to this one crosses."""
        x, y = values["target_direction"].unbind(-1)

        def seen_from_gate(place: Tensor) -> Tensor:
            ahead, left, up = (place - values[TARGET]).unbind(-1)
            return torch.stack((ahead * x + left * y, left * x - ahead * y, up), dim=-1)

        ways = (seen_from_gate(values[name]) for name in ("previous_position", "robot_position"))
        crossed, passed = crossing(*ways, half=self._half)
        last = (values["target_index"] == len(self._gates) - 1) & (not self._loop)
        return {"gate_passed": passed, "gate_missed": crossed & ~passed, "sequence_done": passed & last}

    def after(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return the gate of the next step."""
        index = next_index(values, values["gate_passed"], len(self._gates), loop=self._loop)
        gate = chosen(index, self._gates)
        return {"target_index": index, TARGET: gate[:, :3], "target_direction": gate[:, 3:]}
