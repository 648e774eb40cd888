"""From an action to commanded rotor speeds, for one environment: control law, allocation, limits.

Letters: R rotors, U entries of an action.
"""

import warp as wp

from aerial_gym.physics.fused.law import FusedLaw, NoGains
from aerial_gym.physics.fused.types import rotor_types, vector_of

NEGLIGIBLE = wp.constant(1.0e-6)
"""A difference below this share of the sum is round-off."""

UNLIMITED = wp.constant(1.0e9)
"""Thrust along body z [N] to which a rotor that does not carry sets no limit."""


def make_command(law: FusedLaw, num_rotors: int, general: bool) -> wp.Function:
    """Return a function from the motion of the body origin and an action to commanded rotor speeds [rad/s]."""
    types = rotor_types(num_rotors, general)
    command_type, vector, action_type = types.command, types.vector, vector_of(law.num_actions)
    gains_type, law_wrench = law.gains_type or NoGains, law.wrench
    speed_of, prioritised = make_speed_of(num_rotors, general), law.saturation == "prioritised"
    thrust_for = make_prioritised_thrust(num_rotors, general)

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
        return speed_of(params, action)

    @wp.func
    def wrench(
        params: command_type, gains: gains_type, position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3,
        ang_vel: wp.vec3, action: action_type,
    ) -> vector:  # fmt: skip
        wanted = law_wrench(position, attitude, lin_vel, ang_vel, action, gains)
        if wp.static(prioritised):
            allotted, _turn, _rest = thrust_for(params, wanted)
            return speed_of(params, allotted)
        return speed_of(params, params.allocation * wanted)

    return {"speed": speed, "thrust": thrust, "wrench": wrench}[law.output]


def make_speed_of(num_rotors: int, general: bool) -> wp.Function:
    """Return a function from thrusts [N] to what is commanded of the rotors within the limits."""
    types = rotor_types(num_rotors, general)
    command_type, vector = types.command, types.vector

    @wp.func
    def speed_of(params: command_type, thrust: vector) -> vector:
        speed = vector()
        for i in range(wp.static(num_rotors)):
            allowed = wp.clamp(thrust[i], params.low[i], params.high[i])
            square = params.speed_map[i, 0] + params.speed_map[i, 1] * allowed
            speed[i] = wp.sqrt(wp.max(square, 0.0)) - params.speed_map[i, 2]
        return speed

    @wp.func
    def state_of(params: command_type, thrust: vector) -> vector:
        state = vector()
        for i in range(wp.static(num_rotors)):
            allowed = wp.clamp(thrust[i], params.low[i], params.high[i])
            c0 = params.thrust_map[i, 0]
            c1 = params.thrust_map[i, 1]
            c2 = params.thrust_map[i, 2]
            reverse = allowed < 0.0 and params.low[i] < 0.0
            if reverse:
                c0 = params.reverse_thrust_map[i, 0]
                c1 = params.reverse_thrust_map[i, 1]
                c2 = params.reverse_thrust_map[i, 2]
            size = wp.where(reverse, -allowed, allowed) - c0
            root = wp.sqrt(wp.max(c1 * c1 + 4.0 * c2 * size, 0.0))
            if c2 > 0.0:
                size = (root - c1) / (2.0 * c2)
            if c2 == 0.0:  # force mode
                size = size / c1
            state[i] = wp.where(reverse, -size, size)
        return state

    return state_of if general else speed_of


def make_prioritised_thrust(num_rotors: int, general: bool = False) -> wp.Function:
    """Return ``control.allocation.allot`` for one environment, from parameters and wrench to thrusts [N] and two shares.

    Where no rotor is at a limit, which is nearly always, it is the product with the pseudo-inverse and 2 R comparisons.
    """
    types = rotor_types(num_rotors, general)
    command_type, vector = types.command, types.vector

    @wp.func
    def share_of(thrust: vector, change: vector, params: command_type) -> float:
        share = 1.0
        for i in range(wp.static(num_rotors)):
            room = wp.where(change[i] > 0.0, params.high[i] - thrust[i], thrust[i] - params.low[i])
            share = fitting(share, room, wp.abs(change[i]))
        return share

    @wp.func
    def share_of_pairs(floor: vector, ceiling: vector, slope: vector) -> float:
        share = 1.0
        for i in range(wp.static(num_rotors)):
            for j in range(wp.static(num_rotors)):
                need = slope[j] - slope[i]
                if need > NEGLIGIBLE * (wp.abs(slope[j]) + wp.abs(slope[i])):  # rotors of one kind stay level
                    share = fitting(share, ceiling[j] - floor[i], need)
        return share

    @wp.func
    def highest(ceiling: vector, twist: vector, most: float) -> float:
        found = float(UNLIMITED)
        for i in range(wp.static(num_rotors)):
            found = wp.min(found, ceiling[i] - most * wp.min(twist[i], 0.0))
            for j in range(wp.static(num_rotors)):
                if twist[i] > 0.0 and twist[j] < 0.0:
                    weight = twist[i] / (twist[i] - twist[j])
                    found = wp.min(found, ceiling[i] + weight * (ceiling[j] - ceiling[i]))
        return found

    @wp.func
    def spread(params: command_type, wanted: wp.spatial_vector):
        inverse = params.allocation
        turn, rest, resting, idle, other = vector(), vector(), vector(), vector(), vector()
        lift, floor, ceiling, slope, twist = vector(), vector(), vector(), vector(), vector()
        for i in range(wp.static(num_rotors)):
            turn[i] = inverse[i, 3] * wanted[3] + inverse[i, 4] * wanted[4]
            rest[i] = inverse[i, 0] * wanted[0] + inverse[i, 1] * wanted[1] + inverse[i, 5] * wanted[5]
            lift[i] = inverse[i, 2]
            if lift[i] == 0.0:
                floor[i] = -UNLIMITED
                ceiling[i] = UNLIMITED
                resting[i] = wp.clamp(0.0, params.low[i], params.high[i])
                idle[i] = turn[i]
                other[i] = rest[i]
            else:
                floor[i] = wp.min(params.low[i] / lift[i], params.high[i] / lift[i])
                ceiling[i] = wp.max(params.low[i] / lift[i], params.high[i] / lift[i])
                slope[i] = turn[i] / lift[i]
                twist[i] = rest[i] / lift[i]
        share = wp.min(share_of_pairs(floor, ceiling, slope), share_of(resting, idle, params))
        floor -= share * slope
        ceiling -= share * slope
        resting += share * idle
        most = wp.min(share_of_pairs(floor, ceiling, twist), share_of(resting, other, params))
        thrust = share * (turn - idle) + resting
        thrust += wp.max(wp.min(wanted[2], highest(ceiling, twist, most)), -highest(-floor, -twist, most)) * lift
        rest_share = share_of(thrust, rest, params)
        return thrust + rest_share * rest, share, rest_share

    @wp.func
    def prioritised_thrust(params: command_type, wanted: wp.spatial_vector):
        thrust = params.allocation * wanted
        turn = 1.0
        rest = 1.0
        inside = True
        for i in range(wp.static(num_rotors)):
            if thrust[i] < params.low[i] or thrust[i] > params.high[i]:
                inside = False
        if not inside:
            thrust, turn, rest = spread(params, wanted)
        return thrust, turn, rest

    return prioritised_thrust


@wp.func
def fitting(share: float, room: float, need: float) -> float:
    """Return a share, or less: that of a need for which there is room."""
    if share * need > wp.max(room, 0.0):
        share = wp.max(room, 0.0) / need
    return share
