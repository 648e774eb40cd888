"""Reports of rows with NaN or infinite values: the first by name, and on request a record of their last steps.

The host reads the table of non-finite rows without waiting for a GPU; the record is one launch at the end of a step.
Letters: E environments, N numbers kept of a step, K rows kept.
"""

import csv
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntFlag
from pathlib import Path

import torch
import warp as wp
from torch import Tensor

from aerial_gym.config.storage import storage_errors
from aerial_gym.errors import ConfigError
from aerial_gym.interop import ReusableLaunch, start_warp
from aerial_gym.physics import BodyState
from aerial_gym.registry import GlobalTensorDictionary


class NonFinite(IntFlag):
    """Quantities that were NaN or infinite in a step; they are bits of ``gtd["non_finite"]``, int32 (E,)."""

    ACTION = 1  # Action. The physics may clamp it and continue.
    STATE = 2  # Position, attitude, velocities or rotor speeds after the physics
    REWARD = 4  # Reward of the task
    OBSERVATION = 8  # Observation term of the task

    def names(self) -> str:
        """Return the quantities in words."""
        return " and ".join(str(flag.name).lower() for flag in NonFinite if flag in self)


KEPT_ROWS = 8  # Rows K that are written down: the first ones


@wp.func
def count_row(count_out: wp.array[wp.int32]) -> int:
    """Count a row and return the count before it, which stops at 2**30 to avoid overflow."""
    if count_out[0] >= 1073741824:
        return 1073741824
    return wp.atomic_add(count_out, 0, 1)


@dataclass(frozen=True, kw_only=True)
class NonFiniteRows:
    """Table of rows with NaN or infinite values, and the flags that fill it."""

    bits: Tensor  # Bits of ``NonFinite`` of the step that ends, int32 (E,)
    episode_step: Tensor  # Number of that step within the episode, int32 (E,)
    flags: tuple[Tensor, Tensor]  # Reasons for its end, `crashes` and `truncations`, bool (E,), cleared by a reset
    record: Tensor  # Count; environment, episode, step and bits of the first K rows, int32 (1 + 4 K,): one copy

    @property
    def count(self) -> Tensor:
        """Number of such rows, (1,)."""
        return self.record[:1]

    @property
    def rows(self) -> Tensor:
        """The first ones, (K, 4)."""
        return self.record[1:].view(KEPT_ROWS, 4)

    @classmethod
    def from_gtd(cls, gtd: GlobalTensorDictionary) -> "NonFiniteRows":
        """Return an empty table that reads the flags of a simulation."""
        record = torch.zeros(1 + 4 * KEPT_ROWS, dtype=torch.int32, device=gtd.device)
        flags = gtd["crashes"], gtd["truncations"]
        return cls(bits=gtd["non_finite"], episode_step=gtd["sim_steps"], flags=flags, record=record)

    @classmethod
    def placeholder(cls, state: BodyState) -> "NonFiniteRows":
        """Return a table for robots without a simulation, whose rows are all finite."""
        device = state.position.device
        zeros, no = (torch.zeros(state.num_envs, dtype=dtype, device=device) for dtype in (torch.int32, torch.bool))
        record = torch.zeros(1 + 4 * KEPT_ROWS, dtype=torch.int32, device=device)
        return cls(bits=zeros, episode_step=zeros, flags=(no, no), record=record)


KEPT_STEPS = 64  # Last steps of a row that are kept
LOOK_EVERY = 64  # Steps between two reads of a GPU's table by the host

_log = logging.getLogger(__name__)

STATE_COLUMNS = {
    "robot_position": ("p_x", "p_y", "p_z"),
    "robot_orientation": ("q_x", "q_y", "q_z", "q_w"),
    "robot_linvel": ("v_x", "v_y", "v_z"),
    "robot_body_angvel": ("omega_x", "omega_y", "omega_z"),
}
"""Keys of the GTD that a row keeps, and their columns in a dump; rotor speeds, commands and actions follow."""

HEAD_COLUMNS = ("t", "env", "episode_step", "not_finite")
"""First columns of a dump: time until the row ended [s] (0: the step in which it did), environment, step of the episode, and
what was not finite in the end."""


@wp.kernel(enable_backward=False)
def _record_step(
    non_finite: wp.array[wp.int32],  # (E,) bits of NonFinite
    episode_step: wp.array[wp.int32],  # (E,)
    ended: wp.array[wp.bool],  # (E,) the row is reset after this step
    position: wp.array2d[float],  # (E, 3) world [m]
    attitude: wp.array2d[float],  # (E, 4) body to world, xyzw
    lin_vel: wp.array2d[float],  # (E, 3) world [m/s]
    ang_vel: wp.array2d[float],  # (E, 3) body [rad/s]
    rotor_speed: wp.array2d[float],  # (E, R) [rad/s]
    command: wp.array2d[float],  # (E, U)
    action: wp.array2d[float],  # (E, V) of the policy
    # out
    steps_out: wp.array[wp.int32],  # (E,) kept of the present episode
    ring_out: wp.array3d[float],  # (64, N, E)
    count_out: wp.array[wp.int32],  # (1,) rows so far
    rows_out: wp.array2d[wp.int32],  # (K, 4) environment, step of the episode, bits, steps kept
    kept_out: wp.array3d[float],  # (K, 64, N) oldest first
):
    """Store this step of every row in a ring buffer, and copy the buffer of a row with a bit, in order, to one of K records."""
    e = wp.tid()
    size = ring_out.shape[0]
    slot = steps_out[e] % size
    column = 0
    for i in range(3):
        ring_out[slot, column + i, e] = position[e, i]
        ring_out[slot, column + 7 + i, e] = lin_vel[e, i]
        ring_out[slot, column + 10 + i, e] = ang_vel[e, i]
    for i in range(4):
        ring_out[slot, column + 3 + i, e] = attitude[e, i]
    column += 13
    for i in range(rotor_speed.shape[1]):
        ring_out[slot, column + i, e] = rotor_speed[e, i]
    column += rotor_speed.shape[1]
    for i in range(command.shape[1]):
        ring_out[slot, column + i, e] = command[e, i]
    column += command.shape[1]
    for i in range(action.shape[1]):
        ring_out[slot, column + i, e] = action[e, i]
    steps = steps_out[e] + 1
    steps_out[e] = wp.where(ended[e], 0, steps)
    if non_finite[e] == 0:
        return
    place = count_row(count_out)
    if place < rows_out.shape[0]:
        known = wp.min(steps, size)
        rows_out[place, 0] = e
        rows_out[place, 1] = episode_step[e]
        rows_out[place, 2] = non_finite[e]
        rows_out[place, 3] = known
        for k in range(known):
            source = (steps - known + k) % size
            for i in range(ring_out.shape[1]):
                kept_out[place, k, i] = ring_out[source, i, e]


class FiniteWatch:
    """Names the first row that was not finite; with ``keep`` it also keeps the last steps of the first K rows."""

    def __init__(
        self, gtd: GlobalTensorDictionary, noticed: NonFiniteRows, *, num_actions: int, dt: float, keep: bool,
        num_vehicles: int = 1,
    ) -> None:  # fmt: skip
        """Make the record of all numbers of the last steps of each row with ``keep``, else of the table alone; ``dt`` in s.
        Each environment has ``num_vehicles`` rows."""
        start_warp()
        self._dt, self.keeps, self._found = dt, keep, noticed.record
        self._num_vehicles = num_vehicles
        self._device = gtd["non_finite"].device
        num_envs, self._told, self._looks = gtd["non_finite"].shape[0], False, 0
        self._host = self._found if self._device.type == "cpu" else self._found.cpu().pin_memory()
        self._seen = self._host.numpy()
        if not keep:
            return
        self._columns = [name for names in STATE_COLUMNS.values() for name in names]
        for prefix, width in (
            ("rotor", gtd["rotor_speed"].shape[1]),
            ("command", gtd["robot_actions"].shape[1]),
            ("action", num_actions),
        ):
            self._columns += [f"{prefix}_{i + 1}" for i in range(width)]
        self._count = torch.zeros(1, dtype=torch.int32, device=self._device)
        self._rows = torch.zeros(KEPT_ROWS, 4, dtype=torch.int32, device=self._device)
        self._ring = torch.zeros(KEPT_STEPS, len(self._columns), num_envs, device=self._device)
        self._kept = torch.zeros(KEPT_ROWS, KEPT_STEPS, len(self._columns), device=self._device)
        self._steps = torch.zeros(num_envs, dtype=torch.int32, device=self._device)
        self._ended = torch.zeros(num_envs, dtype=torch.bool, device=self._device)
        self._action = torch.zeros(num_envs, num_actions, device=self._device)
        state = [gtd[key] for key in (*STATE_COLUMNS, "rotor_speed", "robot_actions")]
        inputs = [gtd["non_finite"], gtd["sim_steps"], self._ended, *state, self._action]
        outputs = [self._steps, self._ring, self._count, self._rows, self._kept]
        self._command = ReusableLaunch(_record_step, dim=num_envs, inputs=inputs, outputs=outputs, device=self._device)

    def record_step(self, actions: Tensor, ended: Tensor) -> None:
        """Store this step, before rows in ``ended``, bool (E,), are reset, if recording is on; ``actions``: (E, V)."""
        if not self.keeps:
            return
        self._action.copy_(actions)
        self._ended.copy_(ended)
        self._command.launch(self._action)

    def clear_steps(self) -> None:
        """Clear the recorded steps of all rows, as all are reset."""
        if self.keeps:
            self._steps.zero_()

    def count_rows(self, *, wait: bool = False) -> int:
        """Return the number of non-finite rows known to the host, and warn once of the first.

        Without ``wait`` a GPU is not waited for: the number is that of some steps ago.
        """
        if self._device.type != "cpu":
            self._looks += 1
            if wait:
                self._host.copy_(self._found)
            elif self._looks % LOOK_EVERY == 0:
                self._host.copy_(self._found, non_blocking=True)
        count = int(self._seen[0])
        if count and not self._told:
            self._told = True
            row, episode, step, bits = (int(number) for number in self._seen[1:5])
            env, vehicle = divmod(row, self._num_vehicles)
            _log.warning(
                "environment %d%s, episode %d, step %d: %s not finite (NaN or infinite). Such rows end as crashes and are "
                "counted in info['non_finite']; %s",
                env,
                f", vehicle {vehicle}" if self._num_vehicles > 1 else "",
                episode,
                step,
                NonFinite(bits).names(),
                "their last steps are kept" if self.keeps else "watch them to keep their last steps (--watch)",
            )
        return count

    def dump(self, path: str | Path) -> int:
        """Write the last steps of the first K rows as CSV and return the number of rows. Waits for the device."""
        if not self.keeps:
            raise ConfigError("dump: no steps are kept. Call task.watch() before the first reset")
        rows, kept = self._rows.tolist(), self._kept.cpu()
        count = min(int(self._count), KEPT_ROWS)
        with storage_errors(path), Path(path).open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file)
            writer.writerow([*HEAD_COLUMNS, *self._columns])
            for place in range(count):
                writer.writerows(self._csv_rows(rows[place], kept[place]))
        return count

    def _csv_rows(self, row: Sequence[int], kept: Tensor) -> list[list[object]]:
        env, last_step, bits, known = row
        names = NonFinite(bits).names()
        return [
            [round((k + 1 - known) * self._dt, 6), env, last_step - known + 1 + k, names, *kept[k].tolist()]
            for k in range(known)
        ]


def read_dump(path: str | Path) -> tuple[list[list[str]], list[str]]:
    """Return the table of a dump with its header, and one sentence per recorded row; raise ``ConfigError`` for another file."""
    try:
        with Path(path).open(encoding="utf-8", newline="") as file:
            table = list(csv.reader(file, strict=True))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{path}: cannot be read ({error})") from None
    if not table or tuple(table[0][: len(HEAD_COLUMNS)]) != HEAD_COLUMNS or any(len(r) != len(table[0]) for r in table):
        raise ConfigError(f"{path}: is no dump of a watch; task.dump() writes one")
    ends = [line for line in table[1:] if line[0] in ("0.0", "0")]
    sentences = [
        f"environment {env}, step {step} of its episode: {names} non-finite" for _, env, step, names, *_ in ends
    ]
    return table, sentences
