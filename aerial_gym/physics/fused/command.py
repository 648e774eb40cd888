"""Commanded rotor speeds of an action in the fused kernel: control law, allocation, limits.

Letters: R rotors, U entries of an action.
"""

import warp as wp

from aerial_gym.math.warp_functions import root, vector_type
from aerial_gym.physics.fused.allocation import make_allot_thrust
from aerial_gym.physics.fused.law import FusedLaw, NoGains
from aerial_gym.physics.fused.types import rotor_types


def make_command(law: FusedLaw, num_rotors: int, general: bool, *, differentiable: bool = False) -> wp.Function:
    """Return the function from motion of the body origin and action to commanded rotor speeds [rad/s]."""
    types = rotor_types(num_rotors, general)
    command_type, vector, action_type = types.command, types.vector, vector_type(law.num_prepared)
    gains_type, law_wrench = law.gains_type or NoGains, law.wrench
    limited = make_clamp(num_rotors, general)
    speed_of, prioritised = make_speed_command(num_rotors, general), law.saturation == "prioritised"
    thrust_for = make_allot_thrust(
        num_rotors, general, idle=law.idle, lateral=law.lateral, differentiable=differentiable
    )

    @wp.func
    def speed(
        params: command_type, gains: gains_type, position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3,
        ang_vel: wp.vec3, action: action_type,
    ) -> vector:  # fmt: skip
        command = vector()
        for i in range(wp.static(num_rotors)):
            command[i] = wp.clamp(action[i], params.low[i], params.high[i])
        return command

    @wp.func
    def thrust(
        params: command_type, gains: gains_type, position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3,
        ang_vel: wp.vec3, action: action_type,
    ) -> vector:  # fmt: skip
        return speed_of(params, limited(params, action))

    @wp.func
    def wrench(
        params: command_type, gains: gains_type, position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3,
        ang_vel: wp.vec3, action: action_type,
    ) -> vector:  # fmt: skip
        wanted = law_wrench(position, attitude, lin_vel, ang_vel, action, gains)
        if wp.static(prioritised):
            allotted, _turn, _rest = thrust_for(params, wanted)
            return speed_of(params, allotted)
        return speed_of(params, limited(params, params.allocation * wanted))

    return {"speed": speed, "thrust": thrust, "wrench": wrench}[law.output]


def make_clamp(num_rotors: int, general: bool) -> wp.Function:
    """Return the function that clamps thrusts [N] to their limits."""
    types = rotor_types(num_rotors, general)
    command_type, vector = types.command, types.vector

    @wp.func
    def clamp_thrusts(params: command_type, thrust: vector) -> vector:
        allowed = vector()
        for i in range(wp.static(num_rotors)):
            allowed[i] = wp.clamp(thrust[i], params.low[i], params.high[i])
        return allowed

    return clamp_thrusts


def make_speed_command(num_rotors: int, general: bool) -> wp.Function:
    """Return the function from thrusts [N] within the limits to rotor commands, speeds [rad/s] or in force mode thrusts."""
    types = rotor_types(num_rotors, general)
    command_type, vector = types.command, types.vector

    @wp.func
    def speed_command(params: command_type, thrust: vector) -> vector:
        speed = vector()
        for i in range(wp.static(num_rotors)):
            square = params.speed_map[i, 0] + params.speed_map[i, 1] * thrust[i]
            speed[i] = root(wp.max(square, 0.0)) - params.speed_map[i, 2]
        return speed

    @wp.func
    def state_command(params: command_type, thrust: vector) -> vector:
        state = vector()
        for i in range(wp.static(num_rotors)):
            allowed = thrust[i]
            c0 = params.thrust_map[i, 0]
            c1 = params.thrust_map[i, 1]
            c2 = params.thrust_map[i, 2]
            reverse = allowed < 0.0 and params.low[i] < 0.0
            if reverse:
                c0 = params.reverse_thrust_map[i, 0]
                c1 = params.reverse_thrust_map[i, 1]
                c2 = params.reverse_thrust_map[i, 2]
            size = wp.where(reverse, -allowed, allowed) - c0
            inner = root(wp.max(c1 * c1 + 4.0 * c2 * size, 0.0))
            if c2 > 0.0:
                size = (inner - c1) / (2.0 * c2)
            if c2 == 0.0:  # force mode
                size = size / c1
            state[i] = wp.where(reverse, -size, size)
        return state

    return state_command if general else speed_command
