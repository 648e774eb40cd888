"""Training episodes that start behind a gate of the track, as if the robot had just passed it.

Frames: world of each environment, z up; a gate is flown through along its own x. Letters: E environments, G gates.
"""

import warp as wp
from torch import Tensor

from aerial_gym.config.checks import Vec3
from aerial_gym.interop import make_struct, start_warp
from aerial_gym.math.draws import RandomArrays, draw_vec3, episode_stream, random_arrays, substream
from aerial_gym.math.random import Purpose, Randomness
from aerial_gym.robots.secondary_states import SecondaryArrays, write_derived
from aerial_gym.robots.state_keys import RobotTensors
from aerial_gym.task.kernels.draws import MaskLaunch


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
