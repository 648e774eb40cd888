"""Betaflight's rate loop in the fused kernel: the Warp version of ``control.betaflight.controller``.

Letters: E environments, R rotors.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING

import warp as wp

from aerial_gym.config.autopilots.betaflight import BetaflightCfg
from aerial_gym.control.betaflight.loop import RATE_LIMIT, RELAXED_FROM, THROTTLE_STEP
from aerial_gym.control.cascade_fused import make_stateful_step, make_two_levels
from aerial_gym.control.filters.biquad_fused import make_filter
from aerial_gym.control.lee_fused import read_vec3, write_vec3
from aerial_gym.control.timing import Timing
from aerial_gym.physics.fused.command import make_clamp, make_speed_command
from aerial_gym.physics.fused.law import FusedLaw
from aerial_gym.physics.fused.memory import LawArrays
from aerial_gym.physics.fused.types import rotor_types

if TYPE_CHECKING:
    from aerial_gym.control.betaflight.parameters import BetaflightFilters
    from aerial_gym.control.stateful import MemoryLayout

FILTERS, SLOW, EASED, BEFORE, USED = 3, 27, 30, 33, 36
"""Offsets of ``controller.PARTS``."""


@wp.struct
class BetaflightRows:
    """All parameters: ``parameters.BetaflightGains``."""

    rate: wp.vec3  # [s/rad]
    integral: wp.vec3  # [1/rad]
    derivative: wp.vec3  # [s²/rad]
    forward: wp.vec3  # [s²/rad]
    limit: wp.vec3  # [-]
    integral_limit: wp.vec3  # [-]
    mix: wp.vec3  # [1/(N m)] to [-]
    weight: float  # [N]
    center: wp.vec3  # [rad/s]
    largest: wp.vec3  # [rad/s]
    expo: wp.vec3  # [-]


def make_setpoint(rates_type: str) -> wp.Function:
    """Return the function from an action to thrust per weight and body rates [rad/s]."""

    @wp.func
    def rates(
        gains: BetaflightRows, position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3, ang_vel: wp.vec3,
        action: wp.vec4, arrays: LawArrays, env: int, since: int, dt: float,
    ) -> wp.vec4:  # fmt: skip
        return wp.vec4(action[0] + 1.0, action[1], action[2], action[3])

    @wp.func
    def sticks(
        gains: BetaflightRows, position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3, ang_vel: wp.vec3,
        action: wp.vec4, arrays: LawArrays, env: int, since: int, dt: float,
    ) -> wp.vec4:  # fmt: skip
        wanted = wp.vec4(action[0] + 1.0, 0.0, 0.0, 0.0)
        for i in range(3):
            x = wp.clamp(action[1 + i], -1.0, 1.0)
            bent = wp.abs(x) * (gains.expo[i] * x * x * x * x * x + (1.0 - gains.expo[i]) * x)
            rate = gains.center[i] * x + wp.max(gains.largest[i] - gains.center[i], 0.0) * bent
            wanted[1 + i] = wp.clamp(rate, -wp.static(RATE_LIMIT), wp.static(RATE_LIMIT))
        return wanted

    return sticks if rates_type == "ACTUAL" else rates


def make_loop(
    law: FusedLaw, num_rotors: int, general: bool, own: BetaflightCfg, filters: "BetaflightFilters", timing: Timing
) -> wp.Function:
    """Return the Warp version of ``controller.BetaflightController._loop``."""
    types = rotor_types(num_rotors, general)
    command_type, vector, period = types.command, types.vector, float(timing.loop)
    gyro1, gyro2, slow1, slow2 = (
        make_filter(one, FILTERS + 6 * k) for k, one in enumerate((*filters.gyro, *filters.derivative))
    )
    limited, speed_of = make_clamp(num_rotors, general), make_speed_command(num_rotors, general)
    mix_motors = make_mixer(num_rotors, own.airmode)
    relax, relaxed = filters.relax, {"OFF": 0, "RP": 2, "RPY": 3}[own.iterm_relax]
    windup = own.iterm_windup / 100.0
    tpa, tpa_from, of_error = own.tpa_rate / 100.0, own.tpa_breakpoint / 1000.0 - 1.0, own.tpa_mode == "PD"

    @wp.func
    def run_loop(
        params: command_type, gains: BetaflightRows, attitude: wp.quat, ang_vel: wp.vec3, setpoint: wp.vec4,
        arrays: LawArrays, env: int, since: int, dt: float,
    ) -> vector:  # fmt: skip
        span = wp.static(period) * dt
        seen = gyro2(gyro1(ang_vel, arrays, env, since), arrays, env, since)
        rate = slow2(slow1(seen, arrays, env, since), arrays, env, since)
        wanted = wp.vec3(setpoint[1], setpoint[2], setpoint[3])
        error = wanted - seen
        ang_acc = wp.vec3()
        change = wp.vec3()
        eased = wanted
        if since > 0:
            ang_acc = (rate - read_vec3(arrays.numbers, SLOW, env)) / span
            change = (wanted - read_vec3(arrays.numbers, BEFORE, env)) / span
            eased = read_vec3(arrays.numbers, EASED, env)
            eased = eased + wp.static(relax) * (wanted - eased)
        room = 1.0
        if wp.static(windup < 1.0):
            room = wp.clamp((1.0 - arrays.numbers[USED, env]) / wp.static(1.0 - windup), 0.0, 1.0)
        thrust = vector()
        for i in range(wp.static(num_rotors)):
            thrust[i] = setpoint[0] * gains.weight * params.allocation[i, 2]
        low = speed_of(params, params.low)
        high = speed_of(params, params.high)
        throttle = speed_of(params, limited(params, thrust))
        mean = wp.float32(0.0)
        for i in range(wp.static(num_rotors)):
            throttle[i] = (throttle[i] - low[i]) / (high[i] - low[i])
            mean += throttle[i] / wp.static(float(num_rotors))
        resets = wp.static(not own.airmode) and mean < wp.static(THROTTLE_STEP)
        weaker = 1.0 - wp.static(tpa) * wp.clamp((mean - wp.static(tpa_from)) / wp.static(1.0 - tpa_from), 0.0, 1.0)
        correction = wp.vec3()
        for i in range(3):
            share = wp.float32(1.0)
            if i == 2:
                share = room
            if i < wp.static(relaxed):
                share *= wp.max(1.0 - wp.abs(wanted[i] - eased[i]) / wp.static(RELAXED_FROM), 0.0)
            integral = arrays.numbers[i, env] + share * gains.integral[i] * error[i] * span
            integral = wp.clamp(integral, -gains.integral_limit[i], gains.integral_limit[i])
            arrays.numbers[i, env] = wp.where(resets, 0.0, integral)
            part = gains.rate[i] * error[i]
            if wp.static(of_error):
                part *= weaker
            part += integral - weaker * gains.derivative[i] * ang_acc[i] + gains.forward[i] * change[i]
            correction[i] = gains.mix[i] * wp.clamp(part, -gains.limit[i], gains.limit[i])
        mix = vector()
        for i in range(wp.static(num_rotors)):
            row = params.allocation[i]
            mix[i] = row[3] * correction[0] + row[4] * correction[1] + row[5] * correction[2]
        signal, used = mix_motors(throttle, mix)
        write_vec3(arrays.numbers, SLOW, env, rate)
        write_vec3(arrays.numbers, EASED, env, eased)
        write_vec3(arrays.numbers, BEFORE, env, wanted)
        arrays.numbers[USED, env] = used
        return low + wp.cw_mul(high - low, signal)

    return run_loop


def make_mixer(num_rotors: int, airmode: bool) -> wp.Function:
    """Return the Warp version of ``loop.mixed``."""
    vector = rotor_types(num_rotors).vector

    @wp.func
    def mix_motors(throttle: vector, mix: vector):
        used = wp.max(wp.max(mix), 0.0) - wp.min(wp.min(mix), 0.0)
        scale = 1.0 / wp.max(used, 1.0)
        if wp.static(not airmode):
            mean = wp.float32(0.0)
            for i in range(wp.static(num_rotors)):
                mean += throttle[i] / wp.static(float(num_rotors))
            scale *= wp.clamp(0.5 + mean, 0.5, 1.0)
        signal = throttle + scale * mix
        up = wp.max(-wp.min(signal), 0.0)
        down = wp.max(wp.max(signal) + up - 1.0, 0.0)
        for i in range(wp.static(num_rotors)):
            signal[i] = wp.clamp(signal[i] + up - down, 0.0, 1.0)
        return signal, used

    return mix_motors


def maker(
    own: BetaflightCfg, filters: "BetaflightFilters", timing: Timing, layout: "MemoryLayout"
) -> Callable[[FusedLaw, int, bool], wp.Function]:
    """Return ``FusedLaw.make_stateful_step`` of the loop."""

    def make(law: FusedLaw, num_rotors: int, general: bool) -> wp.Function:
        run_loop = make_loop(law, num_rotors, general, own, filters, timing)
        run = make_two_levels(law, num_rotors, general, timing, make_setpoint(own.rates_type), run_loop)
        return make_stateful_step(law, num_rotors, general, timing, layout, run)

    return make
