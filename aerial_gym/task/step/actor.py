"""Commands from actions: transform, delay, first-order filter and noise in one kernel.

The filter is the exact low pass of a command that is held over a step, ``y += (1 - exp(-dt / tau)) (u - y)``.
Letters: E environments, V entries of an action, U of a command.
"""

from collections.abc import Mapping
from math import exp
from typing import Any

import torch
from torch import Tensor

from aerial_gym.config.task_terms import ActionCfg, fewest_and_most_steps
from aerial_gym.errors import ConfigError
from aerial_gym.math.random import Purpose, Randomness
from aerial_gym.task.kernels.draws import UniformDraws, WhiteNoise
from aerial_gym.task.step.row_kernels import HistoryLine, StepKernel
from aerial_gym.task.terms.actions import ROTOR_RANGE, Action, affine, direct
from aerial_gym.task.values import Values

LINE, DELAY, FILTERED, POLICY_ACTION = "command_line", "action_delay", "filtered_command", "policy_action"  # Buffers
NOISE = "command_noise"  # Buffer of the command noise, drawn in every step


def declare_delay(cfg: ActionCfg, values: Values) -> None:
    """Declare the command delay in steps, readable by terms."""
    delay = values.declare(DELAY, (1,), unit="steps", meaning="how late commands are in this episode")
    delay.fill_(fewest_and_most_steps(cfg.delay_steps)[0])


class ActionConverter:
    """Conversion of a policy's actions to commands; the identity without transform, delay, filter and noise."""

    def __init__(
        self, cfg: ActionCfg, action: Action, params: Mapping[str, Any], values: Values, *, num_actions: int,
        num_commands: int, dt: float, random: Randomness,
    ) -> None:  # fmt: skip
        """Take the conversion and the time ``dt`` of a step [s]; declare its buffers, after all inputs are declared."""
        self.transform, self.params = action.value, params
        low, high = fewest_and_most_steps(cfg.delay_steps)
        self._line, self._drawn = HistoryLine(longest_delay=high), low < high
        self._gain = 1.0 - exp(-dt / cfg.filter_time_s) if cfg.filter_time_s > 0.0 else None
        self._draws: UniformDraws | None = None
        writes: dict[str, Tensor] = {}
        reads = {"begun": values.find("begun", "the action")}
        if high:
            writes[LINE] = values.declare(LINE, (high * num_commands,), meaning="last commands, oldest first")
        if self._drawn:
            reads[DELAY] = values.own[DELAY]
            self._draws = UniformDraws(
                reads[DELAY], [(low, high)], purpose=Purpose.ACTION_DELAY, random=random, whole=True
            )
        self._noise: WhiteNoise | None = None
        if cfg.noise_std > 0.0:
            kinds = dict.fromkeys(range(num_commands), (cfg.noise_std, 0.0))
            self._noise = WhiteNoise(kinds, values.gtd["sim_steps"], random, purpose=Purpose.ACTION_NOISE)
            reads[NOISE] = self._noise.noise
        if self._gain is not None:
            writes[FILTERED] = values.declare(FILTERED, (num_commands,), meaning="command behind the low pass")
        if POLICY_ACTION in values.own:
            writes[POLICY_ACTION] = values.own[POLICY_ACTION]
        given = torch.zeros(random.num_envs, num_actions, device=random.mask.device)
        self._check_transform(cfg.transform, given, num_commands)
        self.rows = None  # The kernel; None where nothing is between
        if writes or self._noise is not None or self.transform is not direct:
            reads |= {"action": given} | writes
            self.rows = StepKernel(
                self._command_and_buffers, "the action", reads=reads, writes=writes, graph=values.graph
            )

    def _check_transform(self, name: str, given: Tensor, num_commands: int) -> None:
        """Refuse a transform that gives no command, before the first step does."""
        if self.transform is affine:
            for end in ("low", "high"):
                told = len(self.params[end])
                if told != num_commands:
                    raise ConfigError(
                        f"action {name}: {end} has {told} numbers, but this robot takes {num_commands}. Choose a robot that "
                        f"takes {told}, or another {end}; transform {ROTOR_RANGE} fits the rotors of any robot"
                    )
        try:
            shape = tuple(self.transform(given, **self.params).shape)
        except Exception as error:
            reason = (str(error).strip().splitlines() or [""])[0]
            raise ConfigError(f"action {name}: cannot be computed ({type(error).__name__}: {reason})") from error
        if shape != (len(given), num_commands):
            raise ConfigError(
                f"action {name}: returns {shape} for actions {tuple(given.shape)}; the controller takes "
                f"(E, U) = {(len(given), num_commands)}"
            )

    def draw_delay(self, mask: Tensor) -> None:
        """Draw the delay of new episodes."""
        if self._draws is not None:
            self._draws.draw(mask)

    def __call__(self, actions: Tensor) -> Tensor:
        """Return the commands (E, U) of actions (E, V), and move line and filter on."""
        if self._noise is not None:
            self._noise.draw()
        return actions if self.rows is None else self.rows(action=actions)["command"]

    def _command_and_buffers(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        action, begun, buffers = values["action"], values["begun"], {}
        command = self.transform(action, **self.params)
        if self._line.length:
            frames = self._line.frames_of_step(values[LINE], command, begun)
            buffers[LINE] = self._line.next_line(frames)
            command = self._line.read_frames(frames, values[DELAY][:, 0] if self._drawn else None)
        if self._gain is not None:
            before = torch.where(begun.unsqueeze(-1), command, values[FILTERED])
            command = before + self._gain * (command - before)
            buffers[FILTERED] = command
        if NOISE in values:
            command = command + values[NOISE]
        if POLICY_ACTION in values:
            buffers[POLICY_ACTION] = action
        return buffers | {"command": command}
