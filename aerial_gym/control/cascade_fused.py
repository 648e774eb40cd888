"""Controllers with memory in the fused kernel: the Warp version of ``control.cascade``.

Their memory is in device memory; a level that is not due costs one comparison.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING

import warp as wp

from aerial_gym.control.lee_fused import LeeParams, read_vec3
from aerial_gym.control.timing import Timing
from aerial_gym.math.warp_functions import vector_type
from aerial_gym.physics.fused.allocation import make_allot_thrust
from aerial_gym.physics.fused.command import make_clamp, make_speed_command
from aerial_gym.physics.fused.law import FusedLaw, preparation
from aerial_gym.physics.fused.memory import LawArrays
from aerial_gym.physics.fused.types import rotor_types

if TYPE_CHECKING:
    from aerial_gym.control.laws import Law
    from aerial_gym.control.stateful import MemoryLayout


@wp.struct
class CascadeGains:
    """Gains of the law and of the rate loop."""

    lee: LeeParams
    proportional: wp.vec3  # [1/s]
    integral: wp.vec3  # [1/s²]
    integral_limit: wp.vec3  # [rad/s²]
    derivative: wp.vec3  # [-]
    smoothing: float
    body_inertia: wp.mat33  # [kg m²]


def maker(
    lee_law: "Law", timing: Timing, layout: "MemoryLayout", *, has_loop: bool
) -> Callable[[FusedLaw, int, bool], wp.Function]:
    """Return ``FusedLaw.make_stateful_step`` of the controller."""

    def make(law: FusedLaw, num_rotors: int, general: bool) -> wp.Function:
        if has_loop:
            wish, run_loop = make_setpoint(law, lee_law), make_rate_loop(law, num_rotors, general, timing)
            run = make_two_levels(law, num_rotors, general, timing, wish, run_loop)
        else:
            run = make_one_level(law, num_rotors, general, lee_law)
        return make_stateful_step(law, num_rotors, general, timing, layout, run)

    return make


def make_stateful_step(
    law: FusedLaw, num_rotors: int, general: bool, timing: Timing, layout: "MemoryLayout", run: wp.Function
) -> wp.Function:
    """Return the function of one physics step, from motion and action to commanded rotor speeds [rad/s]; it updates the memory.

    It is the Warp version of ``remembering.RememberingController.command``.

    Args:
        general: Whether to support every kind of rotor.
        layout: Offsets into the memory.
        run: ``wp.func`` of one run, with the arguments of ``remembering`` below and ``since``.
    """
    types = rotor_types(num_rotors, general)
    command_type, vector, action_type = types.command, types.vector, vector_type(law.num_actions)
    gains_type, held, loop_steps = law.gains_type, layout.held, timing.loop
    late = make_action_delay(law.num_actions, timing, layout)

    @wp.func
    def stateful_step(
        params: command_type, gains: gains_type, position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3,
        ang_vel: wp.vec3, action: action_type, arrays: LawArrays, env: int, dt: float,
    ) -> vector:  # fmt: skip
        since = arrays.since[env]
        arrays.since[env] = since + 1
        arrived = late(arrays, env, since, action)
        command = vector()
        if since % wp.static(loop_steps) == 0:
            command = run(params, gains, position, attitude, lin_vel, ang_vel, arrived, arrays, env, since, dt)
            if wp.static(loop_steps > 1):
                for i in range(wp.static(num_rotors)):
                    arrays.numbers[wp.static(held) + i, env] = command[i]
        else:
            for i in range(wp.static(num_rotors)):
                command[i] = arrays.numbers[wp.static(held) + i, env]
        return command

    return stateful_step


def make_one_level(law: FusedLaw, num_rotors: int, general: bool, lee_law: "Law") -> wp.Function:
    """Return the run of a law without a rate loop."""
    types = rotor_types(num_rotors, general)
    command_type, vector, action_type = types.command, types.vector, vector_type(law.num_actions)
    allot, speed_of = make_allot(law, num_rotors, general), make_speed_command(num_rotors, general)
    law_wrench, prepare, gains_type = lee_law.fused, preparation(lee_law.prepare, law.num_actions), law.gains_type

    @wp.func
    def run(
        params: command_type, gains: gains_type, position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3,
        ang_vel: wp.vec3, action: action_type, arrays: LawArrays, env: int, since: int, dt: float,
    ) -> vector:  # fmt: skip
        thrust, _turn, _rest = allot(
            params, law_wrench(position, attitude, lin_vel, ang_vel, prepare(action, gains), gains)
        )
        return speed_of(params, thrust)

    return run


def make_setpoint(law: FusedLaw, lee_law: "Law") -> wp.Function:
    """Return the function from motion and action to thrust [N] and body-rate setpoint [rad/s] of a geometric law."""
    action_type, gains_type = vector_type(law.num_actions), law.gains_type
    law_wrench, prepare = lee_law.fused, preparation(lee_law.prepare, law.num_actions)

    @wp.func
    def setpoint_function(
        gains: gains_type, position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3, ang_vel: wp.vec3,
        action: action_type, arrays: LawArrays, env: int, since: int, dt: float,
    ) -> wp.vec4:  # fmt: skip
        wrench = law_wrench(position, attitude, lin_vel, ang_vel, prepare(action, gains.lee), gains.lee)
        return wp.vec4(wrench[2], wrench[3] + ang_vel[0], wrench[4] + ang_vel[1], wrench[5] + ang_vel[2])

    return setpoint_function


def make_two_levels(
    law: FusedLaw, num_rotors: int, general: bool, timing: Timing, wish: wp.Function, run_loop: wp.Function
) -> wp.Function:
    """Return the run of a law over a rate loop, with the delayed setpoints between them."""
    types = rotor_types(num_rotors, general)
    command_type, vector, action_type = types.command, types.vector, vector_type(law.num_actions)
    gains_type, period, slots, delay = law.gains_type, timing.law, timing.setpoint_slots, timing.delay

    @wp.func
    def run(
        params: command_type, gains: gains_type, position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3,
        ang_vel: wp.vec3, action: action_type, arrays: LawArrays, env: int, since: int, dt: float,
    ) -> vector:  # fmt: skip
        setpoint = wp.vec4()
        if since % wp.static(period) == 0:
            setpoint = wish(gains, position, attitude, lin_vel, ang_vel, action, arrays, env, since, dt)
            if wp.static(slots > 0):
                for i in range(4):
                    arrays.past[4 * ((since / wp.static(period)) % wp.static(slots)) + i, env] = setpoint[i]
        if wp.static(slots > 0):
            arrived = wp.max(since - wp.static(delay), 0) / wp.static(period)
            for i in range(4):
                setpoint[i] = arrays.past[4 * (arrived % wp.static(slots)) + i, env]
        return run_loop(params, gains, attitude, ang_vel, setpoint, arrays, env, since, dt)

    return run


def make_action_delay(num_actions: int, timing: Timing, layout: "MemoryLayout") -> wp.Function:
    """Return the delay of actions: a function that stores the new action and returns the delayed one."""
    action_type, first = vector_type(num_actions), layout.actions
    slots, delay = timing.action_slots, timing.action_delay

    @wp.func
    def at_once(arrays: LawArrays, env: int, since: int, action: action_type) -> action_type:
        return action

    @wp.func
    def delay_action(arrays: LawArrays, env: int, since: int, action: action_type) -> action_type:
        arrived = action_type()
        for i in range(wp.static(num_actions)):
            arrays.past[wp.static(first) + (since % wp.static(slots)) * wp.static(num_actions) + i, env] = action[i]
        now = wp.max(since - wp.static(delay), 0) % wp.static(slots)
        for i in range(wp.static(num_actions)):
            arrived[i] = arrays.past[wp.static(first) + now * wp.static(num_actions) + i, env]
        return arrived

    return delay_action if slots else at_once


def make_allot(law: FusedLaw, num_rotors: int, general: bool) -> wp.Function:
    """Return the Warp version of ``Allocation.allot``: thrusts, and the shares of the wanted torque that they give."""
    types, prioritised = rotor_types(num_rotors, general), law.saturation == "prioritised"
    limited = make_clamp(num_rotors, general)
    command_type, thrust_for = (
        types.command,
        make_allot_thrust(num_rotors, general, idle=law.idle, lateral=law.lateral),
    )

    @wp.func
    def clamp_thrust(params: command_type, wanted: wp.spatial_vector):
        thrust = params.allocation * wanted
        given = wp.float32(1.0)
        for i in range(wp.static(num_rotors)):
            if thrust[i] < params.low[i] or thrust[i] > params.high[i]:
                given = 0.0
        return limited(params, thrust), given, given

    return thrust_for if prioritised else clamp_thrust


def make_rate_loop(law: FusedLaw, num_rotors: int, general: bool, timing: Timing) -> wp.Function:
    """Return the Warp version of ``CascadeController._run_loop``."""
    types = rotor_types(num_rotors, general)
    command_type, vector, period = types.command, types.vector, float(timing.loop)
    allot, speed_of = make_allot(law, num_rotors, general), make_speed_command(num_rotors, general)

    @wp.func
    def run_loop(
        params: command_type, gains: CascadeGains, attitude: wp.quat, ang_vel: wp.vec3, setpoint: wp.vec4,
        arrays: LawArrays, env: int, since: int, dt: float,
    ) -> vector:  # fmt: skip
        span = wp.static(period) * dt
        integral = read_vec3(arrays.numbers, 0, env)
        slope = read_vec3(arrays.numbers, 3, env)
        measured = wp.vec3()
        if since > 0:
            measured = (ang_vel - read_vec3(arrays.numbers, 6, env)) / span
        slope += gains.smoothing * (measured - slope)
        error = wp.vec3(setpoint[1], setpoint[2], setpoint[3]) - ang_vel
        wanted = wp.cw_mul(gains.proportional, error) + integral - wp.cw_mul(gains.derivative, slope)
        torque = gains.body_inertia * wanted + wp.cross(ang_vel, gains.body_inertia * ang_vel)
        thrust, turn, rest = allot(params, wp.spatial_vector(0.0, 0.0, setpoint[0], torque[0], torque[1], torque[2]))
        given = wp.vec3(turn, turn, rest)
        for i in range(3):
            if given[i] >= 1.0 or error[i] * wanted[i] <= 0.0:
                integral[i] = integral[i] + gains.integral[i] * span * error[i]
            integral[i] = wp.clamp(integral[i], -gains.integral_limit[i], gains.integral_limit[i])
            arrays.numbers[i, env] = integral[i]
            arrays.numbers[3 + i, env] = slope[i]
            arrays.numbers[6 + i, env] = ang_vel[i]
        return speed_of(params, thrust)

    return run_loop
