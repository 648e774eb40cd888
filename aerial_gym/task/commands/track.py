"""Gates of an environment's race track, drawn at every reset, and the poses that a pilot knows.

Frames: world of each environment, z up; a gate is flown through along its own x. Letters: E environments, G gates, P poles.
"""

from collections.abc import Mapping

import torch
from torch import Tensor

from aerial_gym.config.checks import Vec3
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import quat_rotate_inverse
from aerial_gym.task.commands.command import COMMANDS, TARGET
from aerial_gym.task.commands.gates import (
    FIRST_GATE,
    GateCommand,
    declare_gate_flags,
    gate_crossing_flags,
    next_gate_index,
)
from aerial_gym.task.terms.observations import rows_at_index
from aerial_gym.task.values import Values

GATE_KEYS = ("gate_position", "gate_orientation")  # Keys of the GTD: where the gates are

SEEN = {"gates_seen": "gate_position", "poles_seen": "pole_position"}
"""Buffers of seen gates and poles with their poses."""


@COMMANDS.register_class("track_gates")
class TrackGates(GateCommand):
    """The next gate of the track, the first at a reset: its centre is the target, ``target_orientation`` its orientation.

    ``gate_passed``, ``gate_missed`` and ``sequence_done`` are as those of ``gates``. ``gates_seen`` and ``poles_seen`` mark
    gates and poles that were within horizontal range since the reset; of others the pilot knows the nominal pose.
    """

    def __init__(
        self, values: Values, env: EnvManager, *, width: float, height: float, sensor_range: float,
        practice_share: float = 0.0, practice_speed: float = 0.0, practice_offset: Vec3 = (0.0, 0.0, 0.0),
    ) -> None:  # fmt: skip
        """Take the gates of the environment.

        Args:
            env: The simulation; its environment has a track.
            width: Of the openings [m], > 0.
            height: Of the openings [m], > 0.
            sensor_range: Horizontal distance below which gates and poles are seen [m], >= 0.
            practice_share: Share of the episodes of a training, 0 to 1, that begin behind a gate other than the last one, as if
                it had just been flown through. All others, and all of an evaluation, begin at the start.
            practice_speed: Largest speed of these, away from the gate [m/s], >= 0.
            practice_offset: Largest distances of their place behind the gate, beside its middle and above it [m], >= 0.
        """
        super().__init__(values, env)
        if env.cfg.track is None:
            raise ConfigError("command track_gates: the environment has no track. Give it one, or take command gates")
        if not (width > 0.0 and height > 0.0 and sensor_range >= 0.0):
            raise ConfigError(
                f"command track_gates: width = {width!r}, height = {height!r}: must be > 0; sensor_range = {sensor_range!r}: "
                "must be >= 0"
            )
        self._half, self._range = (0.5 * width, 0.5 * height), sensor_range
        gates, poles = len(env.cfg.track.gates), len(env.cfg.track.poles)
        self._count = gates
        self._target()
        values.declare("target_orientation", (4,), frame="world", meaning="orientation of the next gate to world, xyzw")
        declare_gate_flags(values)
        for name, count, kind in (("gates_seen", gates, "gate"), ("poles_seen", poles, "pole")):
            values.declare(name, (count,), dtype=torch.bool, meaning=f"whether the robot has been near each {kind}")
        poses = values.find(GATE_KEYS[0], "command track_gates"), values.find(GATE_KEYS[1], "command track_gates")
        self._declare_practice(poses, share=practice_share, speed=practice_speed, offset=practice_offset)
        self.reads = (
            TARGET, "target_orientation", "target_index", "gate_passed", FIRST_GATE, "robot_position", "previous_position",
            *GATE_KEYS, *SEEN, "pole_position",
        )  # fmt: skip

    def current_values(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return the crossing flags of the gate for the motion of this step."""
        before, now = (
            quat_rotate_inverse(values["target_orientation"], values[name] - values[TARGET])
            for name in ("previous_position", "robot_position")
        )
        crossed, passed = gate_crossing_flags(before, now, half=self._half)
        last = values["target_index"] == self._count - 1
        return {"gate_passed": passed, "gate_missed": crossed & ~passed, "sequence_done": passed & last}

    def next_values(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return the gate of the next step, and the flags of gates and poles seen so far."""
        index = next_gate_index(values, self._count, loop=False)
        position, orientation = (rows_at_index(index, values[key]) for key in GATE_KEYS)
        buffers = {"target_index": index, TARGET: position, "target_orientation": orientation}
        for name, key in SEEN.items():
            away = values[key][..., :2] - values["robot_position"][:, None, :2]
            near = (away * away).sum(-1) < self._range * self._range
            buffers[name] = (values[name] & ~values["begun"].unsqueeze(-1)) | near
        return buffers
