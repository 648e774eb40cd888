# pyright: reportArgumentType=false, reportCallIssue=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportGeneralTypeIssues=false, reportAttributeAccessIssue=false, reportAssignmentType=false

"""Places of several vehicles: where each begins and where it is to fly, such as a formation or an exchange of places.

Frames: world of each environment, z up. Letters: E environments, V vehicles of each, B = E V rows.
"""

from collections.abc import Mapping

import torch
import warp as wp
from torch import Tensor

from aerial_gym.config.checks import Vec3
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import ConfigError
from aerial_gym.interop import make_struct
from aerial_gym.math.draws import RandomArrays, draw_vec3, episode_stream, random_arrays
from aerial_gym.math.random import Purpose
from aerial_gym.robots.secondary_states import write_derived
from aerial_gym.task.commands.command import COMMANDS, TARGET, Command
from aerial_gym.task.commands.gates import RobotMotion
from aerial_gym.task.kernels.draws import MaskLaunch
from aerial_gym.task.values import Values

PLACE = "place"  # Buffer of the place drawn for the episode [m], world, (B, 3)
WAY, PREVIOUS_WAY = "way_to_target", "previous_way_to_target"  # Buffers of the length of the way [m], (B,)


@wp.kernel(enable_backward=False)
def _draw_starts(
    mask: wp.array[wp.bool],  # (B,)
    # params
    random: RandomArrays,  # of the vehicles
    starts: wp.array[wp.vec3],  # (V,) [m]
    offset: wp.vec3,  # largest [m]
    # out
    motion_out: RobotMotion,  # (B,)
):
    """Write the positions of masked vehicles, at rest; leave attitudes and other rows alone."""
    row = wp.tid()
    if not mask[row]:
        return
    stream = episode_stream(random, row, wp.static(int(Purpose.COMMAND)))
    position = starts[row % starts.shape[0]] + draw_vec3(stream, 0, -offset, offset)
    motion_out.position[row] = position
    motion_out.lin_vel[row] = wp.vec3()
    motion_out.ang_vel[row] = wp.vec3()
    write_derived(motion_out.derived, row, position, motion_out.attitude[row], wp.vec3(), wp.vec3())


@wp.kernel(enable_backward=False)
def _draw_places(
    mask: wp.array[wp.bool],  # (B,)
    # params
    random: RandomArrays,  # of the environments, by row
    targets: wp.array[wp.vec3],  # (V,) [m]
    offset: wp.vec3,  # largest [m]
    # out
    place_out: wp.array[wp.vec3],  # (B,) world [m]
):
    """Write the places of masked vehicles, with one offset for all of an environment; leave other rows alone."""
    row = wp.tid()
    if not mask[row]:
        return
    stream = episode_stream(random, row, wp.static(int(Purpose.GOAL)))
    place_out[row] = targets[row % targets.shape[0]] + draw_vec3(stream, 0, -offset, offset)


@COMMANDS.register_class("places")
class Places(Command):
    """A start and a target for each vehicle of an environment; the targets together may be shifted and may move.

    ``way_to_target`` is the distance to the target, or the length of the way through a door where that lies between, and
    ``previous_way_to_target`` that of the step before.
    """

    follows_reset = True

    def __init__(
        self, values: Values, env: EnvManager, *, targets: tuple[Vec3, ...], starts: tuple[Vec3, ...] | None = None,
        start_offset: Vec3 = (0.0, 0.0, 0.0), target_offset: Vec3 = (0.0, 0.0, 0.0),
        velocity: Vec3 = (0.0, 0.0, 0.0), travel_s: float = 0.0, door: Vec3 | None = None,
    ) -> None:  # fmt: skip
        """Take the places.

        Args:
            targets: Target of each vehicle [m], in the order of their numbers.
            starts: Start of each [m]; if not given, those of the robot.
            start_offset: Largest offset of a start along each axis [m], drawn for each vehicle.
            target_offset: Largest offset of the targets along each axis [m], drawn once for all of an environment.
            velocity: Velocity of the targets while they move [m/s].
            travel_s: Time for which they move from the start of an episode on [s], >= 0.
            door: Middle of a doorway in a wall across the x axis [m]; None without one.
        """
        super().__init__(values, env)
        count = env.rows.kind.count
        begins = targets if starts is None else starts
        if not len(begins) == len(targets) == count:
            raise ConfigError(
                f"command places: {len(begins)} starts and {len(targets)} targets: needs one of each for all {count} vehicles"
            )
        if starts is not None and env.cfg.payload is not None:
            raise ConfigError("command places: starts would leave the payload behind. Leave starts out, or payload")
        self._places_vehicles = starts is not None
        if not (travel_s >= 0.0 and min(*start_offset, *target_offset) >= 0.0):
            raise ConfigError(
                f"command places: travel_s = {travel_s!r}, start_offset = {start_offset!r}, target_offset = {target_offset!r}: "
                "must be >= 0"
            )
        self._velocity, self._travel_s, self._door, self._dt = velocity, travel_s, door, env.dt
        place = values.declare(PLACE, (3,), unit="m", frame="world", meaning="target at the start of the episode")
        self._target(moving=True)
        values.declare(WAY, unit="m", meaning="length of the way to the target, through the door where it lies between")
        values.declare(PREVIOUS_WAY, unit="m", meaning="that of the step before, or at the reset")
        self.reads = (PLACE, "robot_position")
        group = env.rows
        state = env.robot_manager.tensors.state
        moved = {name: getattr(state, name) for name in ("position", "attitude", "lin_vel", "ang_vel")}
        motion = make_struct(RobotMotion, derived=env.robot_manager.tensors.derived.arrays, **moved)
        device, rows = place.device, place.shape[0]
        points = [torch.tensor(each, device=device) for each in (begins, targets)]
        inputs = [random_arrays(group.random), wp.from_torch(points[0], dtype=wp.vec3), wp.vec3(*start_offset)]
        self._starts = MaskLaunch(_draw_starts, rows, inputs, [motion], group.random)
        inputs = [random_arrays(group.random.shared), wp.from_torch(points[1], dtype=wp.vec3), wp.vec3(*target_offset)]
        self._places = MaskLaunch(_draw_places, rows, inputs, [place], group.random)
        self._kept = points

    def place(self, mask: Tensor) -> None:
        """Place the vehicles of new episodes at their starts."""
        if self._places_vehicles:
            self._starts.draw(mask)

    def draw(self, mask: Tensor) -> None:
        """Draw the offsets of the targets of new episodes."""
        self._places.draw(mask)

    def current_values(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return place and velocity of the targets at this instant, and the length of the way there."""
        place = values[PLACE]
        velocity = torch.zeros_like(place) + place.new_tensor(self._velocity)
        time = values["sim_steps"].float() * self._dt
        target = place + velocity * time.clamp_max(self._travel_s).unsqueeze(-1)
        moves = (time < self._travel_s).float().unsqueeze(-1)
        way = self._way_length(target, values["robot_position"])
        return {TARGET: target, "target_velocity": moves * velocity, WAY: way}

    def next_values(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return the same for the next step, and the way as its previous one."""
        moved = self.current_values(values)
        return moved | {PREVIOUS_WAY: moved[WAY]}

    def _way_length(self, target: Tensor, position: Tensor) -> Tensor:
        """Return the length of the way from positions to targets [m], (B,)."""
        straight = (target - position).norm(dim=-1)
        if self._door is None:
            return straight
        door = torch.zeros_like(position) + position.new_tensor(self._door)
        around = (door - position).norm(dim=-1) + (target - door).norm(dim=-1)
        between = (position[:, 0] - self._door[0]) * (target[:, 0] - self._door[0]) < 0.0
        return torch.where(between, around, straight)
