"""Start of an episode, with a state drawn inside a kernel, and start of a step.

Letters: E environments, R rotors, U entries of an action.
"""

import warp as wp
from torch import Tensor

from aerial_gym.config.robot import InitialStateCfg
from aerial_gym.interop import ReusableLaunch, make_struct
from aerial_gym.interop.rows import RowWork
from aerial_gym.math.draws import RandomArrays, draw_vec3, episode_stream, quat_from_angles, random_arrays
from aerial_gym.math.random import Purpose, Randomness, copy_mask
from aerial_gym.physics import BodyState
from aerial_gym.robots.finite_watch import NonFiniteRows, count_row
from aerial_gym.robots.secondary_states import SecondaryArrays, SecondaryStates, write_derived


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


@wp.struct
class StartArrays:
    """Arrays that the start of an episode reads and writes."""

    random: RandomArrays
    ranges: Ranges
    bounds_min: wp.array[wp.vec3]  # (E,) world [m]
    bounds_max: wp.array[wp.vec3]  # (E,) world [m]
    rest_speed: wp.array[float]  # (R,) [rad/s]
    non_finite: wp.array[wp.int32]  # (E,) bits of NonFinite, of the step that ends; cleared
    episode_step: wp.array[wp.int32]  # (E,) that it was; cleared
    crashes: wp.array[wp.bool]  # (E,) cleared
    truncations: wp.array[wp.bool]  # (E,) cleared
    position: wp.array[wp.vec3]  # (E,) this and all below is written
    attitude: wp.array[wp.quat]  # (E,)
    lin_vel: wp.array[wp.vec3]  # (E,)
    ang_vel: wp.array[wp.vec3]  # (E,)
    rotor_speed: wp.array2d[float]  # (E, R)
    actions: wp.array2d[float]  # (E, U)
    prev_actions: wp.array2d[float]  # (E, U)
    derived: SecondaryArrays
    count: wp.array[wp.int32]  # (1,) rows that were not finite
    rows: wp.array2d[wp.int32]  # (K, 4) environment, episode, step and bits of the first ones


@wp.func
def start_episode(e: int, given: StartArrays):
    """Write a new state of one environment and its secondary states.

    Rows that end by NaN or infinity are counted, and the first ones recorded. Then the flags of episode ends are cleared.
    """
    if given.non_finite[e] != 0:
        place = count_row(given.count)
        if place < given.rows.shape[0]:
            given.rows[place, 0] = e
            given.rows[place, 1] = given.random.episode[e] - 1  # the counter is already at the new episode
            given.rows[place, 2] = given.episode_step[e]
            given.rows[place, 3] = given.non_finite[e]
    given.non_finite[e] = 0
    given.episode_step[e] = 0
    given.crashes[e] = False
    given.truncations[e] = False
    stream = episode_stream(given.random, e, wp.static(int(Purpose.START)))
    ranges = given.ranges
    share = draw_vec3(stream, 0, ranges.position_ratio_low, ranges.position_ratio_high)
    position = given.bounds_min[e] + wp.cw_mul(given.bounds_max[e] - given.bounds_min[e], share)
    attitude = quat_from_angles(draw_vec3(stream, 1, ranges.euler_low, ranges.euler_high))
    lin_vel = draw_vec3(stream, 2, ranges.lin_vel_low, ranges.lin_vel_high)
    ang_vel = draw_vec3(stream, 3, ranges.ang_vel_low, ranges.ang_vel_high)
    given.position[e] = position
    given.attitude[e] = attitude
    given.lin_vel[e] = lin_vel
    given.ang_vel[e] = ang_vel
    write_derived(given.derived, e, position, attitude, lin_vel, ang_vel)
    for i in range(given.rest_speed.shape[0]):
        given.rotor_speed[e, i] = given.rest_speed[i]
    for i in range(given.actions.shape[1]):
        given.actions[e, i] = 0.0
        given.prev_actions[e, i] = 0.0


@wp.kernel(enable_backward=False)
def _start_episodes(mask: wp.array[wp.bool], given: StartArrays):
    """Begin an episode in the environments of the mask (E,)."""
    e = wp.tid()
    if mask[e]:
        start_episode(e, given)


@wp.kernel(enable_backward=False)
def _store_actions(
    given: wp.array2d[float],  # (E, U)
    # out
    actions_out: wp.array2d[float],  # (E, U)
    prev_actions_out: wp.array2d[float],  # (E, U)
    episode_step_out: wp.array[wp.int32],  # (E,)
    crashes_out: wp.array[wp.bool],  # (E,)
    truncations_out: wp.array[wp.bool],  # (E,)
):
    """Store the actions and the previous ones, count the step, and clear the flags of episode ends."""
    e, i = wp.tid()
    prev_actions_out[e, i] = actions_out[e, i]
    actions_out[e, i] = given[e, i]
    if i == 0:
        episode_step_out[e] = episode_step_out[e] + 1
        crashes_out[e] = False
        truncations_out[e] = False


class ActionStore:
    """Launch that begins a step of all environments, with all views except the action's made at construction."""

    def __init__(self, actions: Tensor, prev_actions: Tensor, noticed: NonFiniteRows) -> None:
        """Take the output tensors, the first two (E, U)."""
        self._actions = actions
        self._command = ReusableLaunch(
            _store_actions, dim=tuple(actions.shape), inputs=[actions],
            outputs=[actions, prev_actions, noticed.episode_step, *noticed.flags], device=actions.device,
        )  # fmt: skip

    def begin(self, given: Tensor) -> None:
        """Begin with an action, (E, U); launched on torch's current stream, not waited for."""
        given = given.detach().to(self._actions).contiguous()
        self._command.set_param_at_index(0, given)
        self._command.launch(self._actions)


class InitialState:
    """Resets the motion of one robot per environment, with all views made at construction."""

    def __init__(
        self, cfg: InitialStateCfg, state: BodyState, derived: SecondaryStates, *, bounds: tuple[Tensor, Tensor],
        rest_speed: Tensor, actions: Tensor, prev_actions: Tensor, random: Randomness,
        noticed: NonFiniteRows | None = None,
    ) -> None:  # fmt: skip
        """Take the output tensors and the inputs of the draws.

        Args:
            bounds: Lower and upper corner [m], world, each (E, 3); read at every reset.
            rest_speed: Rotor speeds of a new state [rad/s], (R,).
        """
        self._mask = random.mask
        noticed = noticed or NonFiniteRows.placeholder(state)
        given = make_struct(
            StartArrays,
            random=random_arrays(random),
            ranges=make_struct(Ranges, **{name: wp.vec3(*value) for name, value in vars(cfg).items()}),
            derived=derived.arrays,
            bounds_min=bounds[0],
            bounds_max=bounds[1],
            crashes=noticed.flags[0],
            truncations=noticed.flags[1],
            rest_speed=rest_speed,
            non_finite=noticed.bits,
            episode_step=noticed.episode_step,
            actions=actions,
            prev_actions=prev_actions,
            count=noticed.count,
            rows=noticed.rows,
            **{name: getattr(state, name) for name in ("position", "attitude", "lin_vel", "ang_vel", "rotor_speed")},
        )
        self.work = RowWork(function=start_episode, given_type=StartArrays, given=given)
        """The start of one environment, for use in another kernel."""
        self._command = ReusableLaunch(
            _start_episodes, dim=state.num_envs, inputs=[self._mask, given], device=state.position.device,
        )  # fmt: skip

    def reset(self, mask: Tensor) -> None:
        """Draw for the environments in ``mask``, bool (E,); launched on torch's current stream, not waited for."""
        copy_mask(self._mask, mask)
        self()

    def __call__(self) -> None:
        """Begin episodes in the environments of the mask of ``random``."""
        self._command.launch(self._mask)
