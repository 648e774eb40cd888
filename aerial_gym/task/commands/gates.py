# pyright: reportArgumentType=false, reportCallIssue=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportGeneralTypeIssues=false, reportAttributeAccessIssue=false, reportAssignmentType=false

"""Gates: openings to be passed in order, each from its front.

A training episode can start behind a gate of the track, as if the robot had just passed it.
A gate is an upright rectangle: its centre, heading of passage, width and height.
Frames: world of each environment, z up. Letters: E environments.
"""

from collections.abc import Mapping
from math import cos, sin

import torch
import warp as wp
from torch import Tensor

from aerial_gym.config.checks import Vec3
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import ConfigError
from aerial_gym.interop import make_struct, start_warp
from aerial_gym.math.draws import RandomArrays, draw_vec3, episode_stream, random_arrays, substream
from aerial_gym.math.random import Purpose, Randomness
from aerial_gym.robots.secondary_states import SecondaryArrays, write_derived
from aerial_gym.robots.state_keys import RobotTensors
from aerial_gym.task.commands.command import COMMANDS, TARGET, Command
from aerial_gym.task.commands.points import next_index, row_at_index
from aerial_gym.task.kernels.draws import MaskLaunch
from aerial_gym.task.values import Values


@wp.struct
class RobotMotion:
    """The robot's motion, written."""

    position: wp.array[wp.vec3]  # (E,) world [m]
    attitude: wp.array[wp.quat]  # (E,) body to world, xyzw
    lin_vel: wp.array[wp.vec3]  # (E,) world [m/s]
    ang_vel: wp.array[wp.vec3]  # (E,) body [rad/s]
    derived: SecondaryArrays


@wp.kernel(enable_backward=False)
def _draw_practice_starts(
    mask: wp.array[wp.bool],  # (E,)
    # state
    gate_position: wp.array2d[wp.vec3],  # (E, G) world [m]
    gate_attitude: wp.array2d[wp.quat],  # (E, G) gate to world, xyzw
    # params
    random: RandomArrays,
    share: wp.array[float],  # (1,) of the episodes that begin behind a gate
    speed: float,  # [m/s]
    offset: wp.vec3,  # [m] in the gate's frame
    # out
    motion_out: RobotMotion,
    first_out: wp.array[wp.int32],  # (E,) gate with which the episode begins
):
    """Write the first gate of masked environments, and where some of their robots begin; leave the others alone."""
    env = wp.tid()
    if not mask[env]:
        return
    stream = episode_stream(random, env, wp.static(int(Purpose.PRACTICE)))
    first_out[env] = 0
    if wp.randf(substream(stream, 0)) >= share[0]:
        return
    last_gate = gate_position.shape[1] - 1
    behind = wp.min(int(wp.randf(substream(stream, 1)) * float(last_gate)), last_gate - 1)
    turn = gate_attitude[env, behind]
    low = wp.vec3(0.0, -offset[1], -offset[2])
    position = gate_position[env, behind] + wp.quat_rotate(turn, draw_vec3(stream, 2, low, offset))
    lin_vel = wp.quat_rotate(turn, wp.vec3(speed * wp.randf(substream(stream, 3)), 0.0, 0.0))
    attitude = motion_out.attitude[env]
    ang_vel = motion_out.ang_vel[env]
    motion_out.position[env] = position
    motion_out.lin_vel[env] = lin_vel
    write_derived(motion_out.derived, env, position, attitude, lin_vel, ang_vel)
    first_out[env] = behind + 1


class PracticeStarts(MaskLaunch):
    """Draws of start positions of masked environments; attitudes stay."""

    def __init__(
        self, robot: RobotTensors, gates: tuple[Tensor, ...], *, share: Tensor, speed: float, offset: Vec3,
        first_out: Tensor, random: Randomness,
    ) -> None:  # fmt: skip
        """Take the robot's motion, positions (E, G, 3) [m] and attitudes (E, G, 4) of the gates, and the inputs of the draws.

        ``share`` is that of the episodes, (1,), ``speed`` the largest one along the gate's x [m/s]. ``offset`` has the largest
        distances from the middle of the gate along its axes [m]; along x it lies behind. ``first_out`` receives the first gate.
        """
        start_warp()
        state = robot.state
        moved = {name: getattr(state, name) for name in ("position", "attitude", "lin_vel", "ang_vel")}
        motion = make_struct(RobotMotion, derived=robot.derived.arrays, **moved)
        inputs = [*gates, random_arrays(random), share, speed, wp.vec3(*offset)]
        super().__init__(_draw_practice_starts, state.num_envs, inputs, [motion, first_out], random)


FIRST_GATE = "first_gate"  # Buffer of the gate with which an episode begins, int32, (E,)


class GateCommand(Command):
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
                first_out=first, random=self.env.rows.random,
            )  # fmt: skip

    def practise(self) -> None:
        """Start training episodes from the next resets on."""
        self._present_share.fill_(self._share)

    def place(self, mask: Tensor) -> None:
        """Place the robots of new episodes that begin behind a gate."""
        if self._starts is not None:
            self._starts.draw(mask)


def gate_crossing_flags(before: Tensor, now: Tensor, *, half: tuple[float, float]) -> tuple[Tensor, Tensor]:
    """Return whether a gate's plane was crossed in its direction, and whether that was within its opening, bool (E,).

    Positions ``before`` and ``now`` [m] are in the gate's frame, (E, 3): x leads through it, y and z span the opening, whose
    half width and height are ``half`` [m].
    """
    (fx, fy, fz), (tx, ty, tz) = before.unbind(-1), now.unbind(-1)
    crossed = (fx < 0.0) & (tx >= 0.0)
    share = fx / torch.where(crossed, fx - tx, -1.0)  # of the way at which the plane is crossed
    left, up = fy + share * (ty - fy), fz + share * (tz - fz)
    return crossed, crossed & (left.abs() <= half[0]) & (up.abs() <= half[1])


def declare_gate_flags(values: Values) -> None:
    """Declare the index of the next gate and its crossing flags."""
    values.declare("target_index", dtype=torch.int32, meaning="which point or gate is next, from 0 on")
    for name, meaning in (
        ("gate_passed", "the robot flew through its gate in this step"),
        ("gate_missed", "the robot crossed the plane of its gate beside the opening in this step"),
        ("sequence_done", "it flew through the last one in this step"),
    ):
        values.declare(name, dtype=torch.bool, meaning=meaning)
    values.find("previous_position", "a command of gates")


def next_gate_index(values: Mapping[str, Tensor], count: int, *, loop: bool) -> Tensor:
    """Return the index of the next one of ``count`` gates, int32, (E,): ``first_gate`` where an episode begins."""
    index = next_index(values, values["gate_passed"], count, loop=loop)
    return torch.where(values["begun"], values[FIRST_GATE], index).int()


@COMMANDS.register_class("gates")
class Gates(GateCommand):
    """The next gate's centre is the target, ``target_direction`` and ``target_orientation`` the way through it.

    ``following_position`` and ``following_direction`` are those of the gate behind it. A reset begins with the first gate;
    ``gate_passed`` is true in the step that crosses the gate's plane forward through the opening, ``gate_missed`` in one
    that crosses outside it. ``sequence_done`` is true when the last gate is passed.
    """

    def __init__(
        self, values: Values, env: EnvManager, *, centers: tuple[Vec3, ...], yaws: tuple[float, ...],
        width: float = 1.0, height: float = 1.0, loop: bool = False, practice_share: float = 0.0,
        practice_speed: float = 0.0, practice_offset: Vec3 = (0.0, 0.0, 0.0),
    ) -> None:  # fmt: skip
        """Take the gates.

        Args:
            centers: In order [m].
            yaws: Heading in which each is flown through [rad]; 0 is along x.
            width: Of the opening [m], > 0.
            height: Of the opening [m], > 0.
            loop: Whether the first one follows the last one; otherwise that one stays the target.
            practice_share: Share of the episodes of a training that begin behind a gate.
            practice_speed: Largest speed of these, away from the gate [m/s].
            practice_offset: Largest distances of their place behind the gate, beside its middle and above it [m].
        """
        super().__init__(values, env)
        if not centers or len(centers) != len(yaws):
            raise ConfigError(f"command gates: {len(centers)} centers and {len(yaws)} yaws: needs one of each per gate")
        if not (width > 0.0 and height > 0.0):
            raise ConfigError(f"command gates: width = {width!r}, height = {height!r}: must be > 0")
        turns = [(cos(yaw), sin(yaw), 0.0, 0.0, sin(0.5 * yaw), cos(0.5 * yaw)) for yaw in yaws]
        self._gates = [(*center, *turn) for center, turn in zip(centers, turns, strict=True)]
        behind = [*self._gates[1:], self._gates[0 if loop else -1]]
        self._following = [gate[:5] for gate in behind]
        self._half, self._loop = (0.5 * width, 0.5 * height), loop
        self._target()
        values.declare("target_direction", (2,), frame="world", meaning="way through the next gate: x and y, unit")
        values.declare("target_orientation", (4,), frame="world", meaning="orientation of the next gate to world, xyzw")
        values.declare("following_position", (3,), unit="m", frame="world", meaning="centre of the gate after the next")
        values.declare("following_direction", (2,), frame="world", meaning="way through that: x and y, unit")
        declare_gate_flags(values)
        rows = torch.tensor(self._gates, device=env.device).expand(env.rows.random.num_envs, -1, -1)
        poses = rows[..., :3].contiguous(), rows[..., 5:].contiguous()
        self._declare_practice(poses, share=practice_share, speed=practice_speed, offset=practice_offset)
        self.reads = (
            TARGET, "target_direction", "target_index", "gate_passed", FIRST_GATE, "robot_position", "previous_position",
        )  # fmt: skip

    def current_values(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return the crossing flags of the gate for the motion of this step."""
        x, y = values["target_direction"].unbind(-1)

        def to_gate_frame(place: Tensor) -> Tensor:
            ahead, left, up = (place - values[TARGET]).unbind(-1)
            return torch.stack((ahead * x + left * y, left * x - ahead * y, up), dim=-1)

        ways = (to_gate_frame(values[name]) for name in ("previous_position", "robot_position"))
        crossed, passed = gate_crossing_flags(*ways, half=self._half)
        last = (values["target_index"] == len(self._gates) - 1) & (not self._loop)
        return {"gate_passed": passed, "gate_missed": crossed & ~passed, "sequence_done": passed & last}

    def next_values(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return the gate of the next step."""
        index = next_gate_index(values, len(self._gates), loop=self._loop)
        gate, following = row_at_index(index, self._gates), row_at_index(index, self._following)
        buffers = {"target_index": index, "target_orientation": gate[:, 5:]}
        for name, row in (("target", gate), ("following", following)):
            buffers |= {f"{name}_position": row[:, :3], f"{name}_direction": row[:, 3:5]}
        return buffers
