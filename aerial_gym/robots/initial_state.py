"""The beginning of an episode, with a state drawn inside a kernel, and of a step.

Letters: E environments, R rotors, U entries of an action.
"""

import warp as wp
from torch import Tensor

from aerial_gym.config.robot import InitialStateCfg
from aerial_gym.interop import RecordedLaunch, on_torch_stream
from aerial_gym.interop.streams import BLOCK_DIM
from aerial_gym.math.draws import RandomArrays, draw_vec3, quat_of_angles, random_arrays, stream_of
from aerial_gym.math.random import Purpose, Randomness, take_mask
from aerial_gym.physics import BodyState
from aerial_gym.robots.derived import DerivedArrays, DerivedStates, write_derived
from aerial_gym.robots.noticed import Noticed, take_place


@wp.struct
class Ranges:
    """Ends of the uniform ranges of ``InitialStateCfg``."""

    position_ratio_low: wp.vec3  # share of the bounds
    position_ratio_high: wp.vec3
    euler_low: wp.vec3  # ZYX roll, pitch, yaw [rad]
    euler_high: wp.vec3
    lin_vel_low: wp.vec3  # world [m/s]
    lin_vel_high: wp.vec3
    ang_vel_low: wp.vec3  # body [rad/s]
    ang_vel_high: wp.vec3


@wp.kernel(enable_backward=False)
def _reset(
    mask: wp.array[wp.bool],  # (E,)
    # params
    random: RandomArrays,
    ranges: Ranges,
    bounds_min: wp.array[wp.vec3],  # (E,) world [m]
    bounds_max: wp.array[wp.vec3],  # (E,) world [m]
    rest_speed: wp.array[float],  # (R,) [rad/s]
    # in and out
    non_finite: wp.array[wp.int32],  # (E,) bits of NonFinite, of the step that ends
    episode_step: wp.array[wp.int32],  # (E,) that it was
    # out
    crashes_out: wp.array[wp.bool],  # (E,)
    truncations_out: wp.array[wp.bool],  # (E,)
    position_out: wp.array[wp.vec3],
    attitude_out: wp.array[wp.quat],
    lin_vel_out: wp.array[wp.vec3],
    ang_vel_out: wp.array[wp.vec3],
    rotor_speed_out: wp.array2d[float],  # (E, R)
    actions_out: wp.array2d[float],  # (E, U)
    prev_actions_out: wp.array2d[float],  # (E, U)
    derived_out: DerivedArrays,
    count_out: wp.array[wp.int32],  # (1,) rows that were not finite
    rows_out: wp.array2d[wp.int32],  # (K, 4) environment, episode, step and bits of the first ones
):
    """Write a new state and what follows from it where the mask says so; leave every other row alone.

    Rows that end because they were not finite are counted, and the first ones written down. Then what said that an episode
    ended is cleared.
    """
    e = wp.tid()
    if not mask[e]:
        return
    if non_finite[e] != 0:
        place = take_place(count_out)
        if place < rows_out.shape[0]:
            rows_out[place, 0] = e
            rows_out[place, 1] = random.episode[e] - 1  # the new one has begun
            rows_out[place, 2] = episode_step[e]
            rows_out[place, 3] = non_finite[e]
    non_finite[e] = 0
    episode_step[e] = 0
    crashes_out[e] = False
    truncations_out[e] = False
    stream = stream_of(random, e, wp.static(int(Purpose.START)))
    share = draw_vec3(stream, 0, ranges.position_ratio_low, ranges.position_ratio_high)
    position = bounds_min[e] + wp.cw_mul(bounds_max[e] - bounds_min[e], share)
    attitude = quat_of_angles(draw_vec3(stream, 1, ranges.euler_low, ranges.euler_high))
    lin_vel = draw_vec3(stream, 2, ranges.lin_vel_low, ranges.lin_vel_high)
    ang_vel = draw_vec3(stream, 3, ranges.ang_vel_low, ranges.ang_vel_high)
    position_out[e] = position
    attitude_out[e] = attitude
    lin_vel_out[e] = lin_vel
    ang_vel_out[e] = ang_vel
    write_derived(derived_out, e, position, attitude, lin_vel, ang_vel)
    for i in range(rest_speed.shape[0]):
        rotor_speed_out[e, i] = rest_speed[i]
    for i in range(actions_out.shape[1]):
        actions_out[e, i] = 0.0
        prev_actions_out[e, i] = 0.0


@wp.kernel(enable_backward=False)
def _begin_step(
    given: wp.array2d[float],  # (E, U)
    # out
    actions_out: wp.array2d[float],  # (E, U)
    prev_actions_out: wp.array2d[float],  # (E, U)
    episode_step_out: wp.array[wp.int32],  # (E,)
    crashes_out: wp.array[wp.bool],  # (E,)
    truncations_out: wp.array[wp.bool],  # (E,)
):
    """Take the action of every environment and keep the one before, count the step, clear what ends an episode."""
    e, i = wp.tid()
    prev_actions_out[e, i] = actions_out[e, i]
    actions_out[e, i] = given[e, i]
    if i == 0:
        episode_step_out[e] = episode_step_out[e] + 1
        crashes_out[e] = False
        truncations_out[e] = False


class StepBegin:
    """Begins a step of every environment in one launch, with all views but that of the action made at construction."""

    def __init__(self, actions: Tensor, prev_actions: Tensor, noticed: Noticed) -> None:
        """Take what is written, the first two (E, U)."""
        self._actions = actions
        self._command = RecordedLaunch(
            _begin_step,
            dim=tuple(actions.shape),
            inputs=[wp.from_torch(actions)],
            outputs=[wp.from_torch(tensor) for tensor in (actions, prev_actions, noticed.episode_step, *noticed.flags)],
            device=wp.device_from_torch(actions.device),
        )

    def take(self, given: Tensor) -> None:
        """Begin with an action, (E, U); launched on torch's current stream, not waited for."""
        given = given.detach().to(self._actions).contiguous()
        self._command.set_param_at_index(0, wp.from_torch(given))
        with on_torch_stream(self._actions):
            self._command.launch()


class InitialState:
    """Resets the motion of one robot per environment, with all views made at construction."""

    def __init__(
        self,
        cfg: InitialStateCfg,
        state: BodyState,
        derived: DerivedStates,
        *,
        bounds: tuple[Tensor, Tensor],
        rest_speed: Tensor,
        actions: Tensor,
        prev_actions: Tensor,
        random: Randomness,
        noticed: Noticed | None = None,
    ) -> None:
        """Take what is written and what the draws depend on.

        Args:
            cfg: Ranges.
            state: Written where a mask says so.
            derived: What follows from it, likewise.
            bounds: Lower and upper corner [m], world, each (E, 3); read at every reset.
            rest_speed: Rotor speeds of a new state [rad/s], (R,).
            actions: Set to zero, (E, U).
            prev_actions: Likewise.
            random: Of the draws.
            noticed: What becomes of rows that were not finite, and what is cleared.
        """
        device = state.position.device
        self._mask = random.mask
        noticed = noticed or Noticed.nothing(state)
        self._kept_alive = random, noticed
        ranges = Ranges()
        for name, value in vars(cfg).items():
            setattr(ranges, name, wp.vec3(*value))
        inputs = [wp.from_torch(self._mask), random_arrays(random), ranges]
        inputs += [wp.from_torch(corner, dtype=wp.vec3) for corner in bounds]
        self._command = RecordedLaunch(
            _reset,
            dim=state.num_envs,
            inputs=[*inputs, *(wp.from_torch(tensor) for tensor in (rest_speed, noticed.bits, noticed.episode_step))],
            outputs=[
                *(wp.from_torch(flag) for flag in noticed.flags),
                wp.from_torch(state.position, dtype=wp.vec3),
                wp.from_torch(state.attitude, dtype=wp.quat),
                wp.from_torch(state.lin_vel, dtype=wp.vec3),
                wp.from_torch(state.ang_vel, dtype=wp.vec3),
                wp.from_torch(state.rotor_speed),
                wp.from_torch(actions),
                wp.from_torch(prev_actions),
                derived.arrays,
                wp.from_torch(noticed.count),
                wp.from_torch(noticed.rows),
            ],
            device=wp.device_from_torch(device),
            block_dim=BLOCK_DIM,
        )

    def reset(self, mask: Tensor) -> None:
        """Draw for the environments in ``mask``, bool (E,); launched on torch's current stream, not waited for."""
        take_mask(self._mask, mask)
        with on_torch_stream(self._mask):
            self._command.launch()
