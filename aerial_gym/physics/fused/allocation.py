"""From a wrench to thrusts where rotors are at their limits, for one environment: the twin of ``control.allocation.allot``.

Letters: R rotors.
"""

import warp as wp

from aerial_gym.physics.fused.types import rotor_types

NEGLIGIBLE = wp.constant(1.0e-6)
"""A difference below this share of the sum is round-off; so is an entry of the pseudo-inverse that, times the largest entry of
the matrix for that force or torque, is below it: a rotor that has a part in it is near 1."""

UNLIMITED = wp.constant(1.0e9)
"""Thrust along body z [N] to which a rotor that does not carry sets no limit; finite, so that gradients are."""


def make_prioritised_thrust(
    num_rotors: int, general: bool = False, *, idle: bool, lateral: bool, differentiable: bool = False
) -> wp.Function:
    """Return ``control.allocation.allot`` for one environment, from parameters and wrench to thrusts [N] and two shares.

    Where no rotor is at a limit, which is nearly always, it is the product with the pseudo-inverse and 2 R comparisons.

    Args:
        num_rotors: R.
        general: Whether rotors are of any kind.
        idle: Whether any rotor has no part in the force along body z.
        lateral: Whether wrenches have a force beside body z.
        differentiable: Whether the adjoint is needed.
    """
    types = rotor_types(num_rotors, general)
    command_type, vector = types.command, types.vector
    turn_of, rest_of = _make_parts(lateral)
    spread = (_make_unrolled if differentiable else _make_rolled)(num_rotors, general, idle, lateral)

    @wp.func
    def prioritised_thrust(params: command_type, wanted: wp.spatial_vector):
        thrust = vector()
        for i in range(wp.static(num_rotors)):
            row = params.allocation[i]
            thrust[i] = row[2] * wanted[2] + turn_of(row, wanted) + rest_of(row, wanted)
        turn = wp.float32(1.0)
        rest = wp.float32(1.0)
        inside = bool(True)  # noqa: UP018
        for i in range(wp.static(num_rotors)):
            if thrust[i] < params.low[i] or thrust[i] > params.high[i]:
                inside = False
        if not inside:
            thrust, turn, rest = spread(params, wanted)
        return thrust, turn, rest

    return prioritised_thrust


def _make_rolled(num_rotors: int, general: bool, idle: bool, lateral: bool) -> wp.Function:
    """Return the rare path: the linear programs solved by following their edges from limit to limit.

    None comes twice, so that 2 R and R rounds are enough. What the rare path takes in registers of a GPU is taken from all that
    is done beside it; so its table stands in local memory, and its loops stay loops, as long as a number says that the compiler
    does not know. Unrolled, it took 120 registers more than the rest of a kernel.
    """
    types = rotor_types(num_rotors, general)
    command_type, vector = types.command, types.vector
    turn_of, rest_of = _make_parts(lateral)
    table_type = wp.types.matrix(shape=(num_rotors, 4), dtype=wp.float32)

    @wp.func
    def idle_share(params: command_type, wanted: wp.spatial_vector, turned: float, rest: bool) -> float:
        """Return the share of the turn, or of the rest, that rotors can give which do not carry."""
        share = wp.float32(1.0)
        for i in range(wp.static(num_rotors)):
            if params.allocation[i, 2] == 0.0:
                turn = turn_of(params.allocation[i], wanted)
                change = wp.where(rest, rest_of(params.allocation[i], wanted), turn)
                start = wp.clamp(0.0, params.low[i], params.high[i]) + turned * turn
                share = fitting(share, wp.where(change > 0.0, params.high[i] - start, start - params.low[i]), change)
        return share

    @wp.func
    def spread(params: command_type, wanted: wp.spatial_vector):
        table = table_type()
        for i in range(wp.static(num_rotors)):
            per_thrust = 1.0 / params.allocation[i, 2]
            table[i, FLOOR] = wp.min(params.low[i] * per_thrust, params.high[i] * per_thrust)
            table[i, CEILING] = wp.max(params.low[i] * per_thrust, params.high[i] * per_thrust)
            table[i, SLOPE] = turn_of(params.allocation[i], wanted) * per_thrust
            table[i, TWIST] = rest_of(params.allocation[i], wanted) * per_thrust
            if wp.static(idle):  # noqa: SIM102
                if params.allocation[i, 2] == 0.0:
                    table[i] = wp.vec4(-UNLIMITED, UNLIMITED, 0.0, 0.0)
        count = wp.static(num_rotors) + int(0.0 * params.high[0])
        shares = wp.vec2(1.0, 1.0)
        for stage in range(wp.static(2)):
            if wp.static(idle):
                shares[stage] = idle_share(params, wanted, float(stage) * shares[0], stage == 1)
            share = float(shares[stage])
            above = wp.int32(0)
            below = wp.int32(0)
            for _round in range(2 * count):
                top = wp.int32(0)
                bottom = wp.int32(0)
                for i in range(count):
                    change = share * table[i, SLOPE + stage]
                    if table[i, CEILING] - change < table[top, CEILING] - share * table[top, SLOPE + stage]:
                        top = i
                    if table[i, FLOOR] - change > table[bottom, FLOOR] - share * table[bottom, SLOPE + stage]:
                        bottom = i
                upper = table[top, SLOPE + stage]
                lower = table[bottom, SLOPE + stage]
                need = upper - lower
                room = table[top, CEILING] - table[bottom, FLOOR]
                if share * need > room and need > NEGLIGIBLE * (wp.abs(upper) + wp.abs(lower)):  # else of one kind
                    share = wp.max(room / need, 0.0)
                    above = top
                    below = bottom
            if above != below:
                shares[stage] = wp.max(
                    (table[above, CEILING] - table[below, FLOOR])
                    / (table[above, SLOPE + stage] - table[below, SLOPE + stage]),
                    0.0,
                )
            if wp.static(stage == 0):
                for i in range(wp.static(num_rotors)):
                    table[i, FLOOR] = table[i, FLOOR] - shares[0] * table[i, SLOPE]
                    table[i, CEILING] = table[i, CEILING] - shares[0] * table[i, SLOPE]
        share = shares[0]
        collective = wanted[2]
        for side in range(wp.static(2)):
            sign = float(2 * side - 1)  # from below to the ceiling, then from above to the floor
            limit = CEILING - side
            left = wp.int32(0)
            right = wp.int32(0)
            for step in range(count + 2):
                between = step > 1 and sign * table[left, TWIST] > 0.0 and sign * table[right, TWIST] < 0.0
                at = wp.float32(0.0)
                if step == 1:
                    at = shares[1]
                if between:
                    at = (table[left, limit] - table[right, limit]) / (table[left, TWIST] - table[right, TWIST])
                first = wp.int32(0)
                for i in range(count):
                    if sign * (table[i, limit] - at * table[i, TWIST]) > sign * (
                        table[first, limit] - at * table[first, TWIST]
                    ):
                        first = i
                rises = sign * table[first, TWIST] > 0.0
                if step == 0 or (between and rises):
                    left = first
                if step == 1 or (between and not rises):
                    right = first
            edge = table[left, limit]
            if sign * (table[right, limit] - shares[1] * table[right, TWIST]) < sign * edge:
                edge = table[right, limit] - shares[1] * table[right, TWIST]
            if sign * table[left, TWIST] > 0.0 and sign * table[right, TWIST] < 0.0:
                at = (table[left, limit] - table[right, limit]) / (table[left, TWIST] - table[right, TWIST])
                edge = table[left, limit] - at * table[left, TWIST]
            if sign * edge > sign * collective:
                collective = edge
        thrust = vector()
        rest_share = wp.float32(1.0)
        for i in range(wp.static(num_rotors)):
            lift = params.allocation[i, 2]
            thrust[i] = share * turn_of(params.allocation[i], wanted) + collective * lift
            if wp.static(idle):  # noqa: SIM102
                if lift == 0.0:
                    thrust[i] = thrust[i] + wp.clamp(0.0, params.low[i], params.high[i])
            rest = rest_of(params.allocation[i], wanted)
            rest_share = fitting(
                rest_share, wp.where(rest > 0.0, params.high[i] - thrust[i], thrust[i] - params.low[i]), rest
            )
        for i in range(wp.static(num_rotors)):
            thrust[i] = thrust[i] + rest_share * rest_of(params.allocation[i], wanted)
        return thrust, share, rest_share

    return spread


def _make_unrolled(num_rotors: int, general: bool, idle: bool, lateral: bool) -> wp.Function:
    """Return the rare path as torch has it, pair by pair: the adjoint needs loops that are unrolled."""
    del idle, lateral
    types = rotor_types(num_rotors, general)
    command_type, vector = types.command, types.vector

    @wp.func
    def share_of(thrust: vector, change: vector, params: command_type) -> float:
        share = wp.float32(1.0)
        for i in range(wp.static(num_rotors)):
            room = wp.where(change[i] > 0.0, params.high[i] - thrust[i], thrust[i] - params.low[i])
            share = fitting(share, room, change[i])
        return share

    @wp.func
    def share_of_pairs(floor: vector, ceiling: vector, slope: vector) -> float:
        share = wp.float32(1.0)
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

    return spread


FLOOR, CEILING, SLOPE, TWIST = (wp.constant(column) for column in range(4))
"""Columns of the table of rotors that carry: limits of the force along body z, and what roll and pitch and the rest take of
it."""


def _make_parts(lateral: bool) -> tuple[wp.Function, wp.Function]:
    """Return functions to the thrust of a rotor for roll and pitch torque, and for the rest: yaw torque and lateral force."""

    @wp.func
    def turn_of(row: wp.spatial_vector, wanted: wp.spatial_vector) -> float:
        return row[3] * wanted[3] + row[4] * wanted[4]

    @wp.func
    def rest_of(row: wp.spatial_vector, wanted: wp.spatial_vector) -> float:
        rest = row[5] * wanted[5]
        if wp.static(lateral):
            rest += row[0] * wanted[0] + row[1] * wanted[1]
        return rest

    return turn_of, rest_of


@wp.func
def fitting(share: float, room: float, change: float) -> float:
    """Return a share, or less: that of a change for which there is room."""
    if share * wp.abs(change) > wp.max(room, 0.0):
        share = wp.max(room, 0.0) / wp.abs(change)
    return share
